"""`design_experiment`: what to send to a plant so that its log tells the delays best."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, bound, count, instance, positive
from deadtime.base.errors import ArgumentError
from deadtime.identification.cells import cells_of
from deadtime.identification.excitation.experiment import Experiment
from deadtime.identification.excitation.information import SIGMAS, Prospect
from deadtime.identification.excitation.loop import chain_of, require_bounded
from deadtime.identification.excitation.search import (
    CLOCKS,
    best_sequence,
    binary_sequence,
    steps,
    within_limits,
)
from deadtime.identification.maximum import REACH
from deadtime.identification.parameters import Layout
from deadtime.numerics.covariance import noise_covariances
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal
from deadtime.switching.grid import modes_at

if TYPE_CHECKING:
    from deadtime.feedback import Feedback, Law

_MOST_SAMPLES = 20_000


def design_experiment(
    plant: SwitchedSystem,
    horizon: float,
    step: float,
    input_limit: ArrayLike,
    *,
    disturbance: ArrayLike,
    signal: SwitchingSignal | None = None,
    law: Law | None = None,
    state_limit: ArrayLike | None = None,
    criterion: str = "delay",
    hold: int = 1,
    switches: str = "samples",
    effort: int = 10,
    seed: int = 0,
) -> Experiment:
    """The inputs within limits whose log tells the plant's delays best, of all that a search found.

    They maximise Fisher's information: the least product of the delays' variances that any unbiased
    estimate from the log can have, with A, B and the noise unknown, too. It is exact for states
    that are measured without noise: docs/theory/identification.md.

    Parameters
    ----------
    plant : SwitchedSystem
        What is known of the plant so far, such as `fit.plant` of a first, short log.
    horizon : float
        Length of the experiment, seconds; at most 20,000 periods.
    step : float
        Sampling period, seconds.
    input_limit : float or (m,) array_like
        What |u| must not exceed.
    disturbance : array_like
        W, the intensity of the process noise, x² per second: a number for number·I, (n,) for a
        diagonal, (n, n), or (modes, n, n) for one per mode, such as `fit.disturbance`.
    signal : SwitchingSignal, optional
        The modes that the plant is put into; read at samples. Not needed for one mode.
    law : Law, optional
        To whose inputs those of the experiment are added; an unstable plant needs one.
    state_limit : float or (n,) array_like, optional
        What every |x| must not exceed at samples, by its mean and three standard deviations.
    criterion : "delay" or "all"
        Whether the delays alone are to be told well, or all unknowns (D-optimal).
    hold : int
        For how many periods each value is held at least.
    switches : "samples" or "anywhere"
        As `identify` will be told; with "anywhere" it leaves out periods in which the mode changes.
    effort : int
        How often the search starts anew from the best it found.
    seed : int
        Of the search.

    Returns
    -------
    Experiment

    Raises
    ------
    ArgumentError
        If an argument is malformed, a mode is hardly visited, an unstable plant has no law, or
        noise alone exceeds a limit.

    References
    ----------
    Goodwin and Payne, "Dynamic System Identification", Academic Press 1977, chapter 6.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[-1.0]]], [[[1.0]]], 0.27)
    >>> found = dt.design_experiment(plant, 10.0, 0.1, 1.0, disturbance=1e-3, effort=0)
    >>> round(1e3 * found.standard_error("delay"), 1), found.inputs.shape
    (0.7, (1, 100))
    >>> errors = found.delay_errors
    >>> bool(errors["experiment"] < errors["prbs"] < errors["step"])
    True
    """
    instance("plant", plant, SwitchedSystem)
    _require_words(criterion, switches)
    step, horizon = positive("step", step), positive("horizon", horizon)
    samples = round(horizon / step)
    if samples > _MOST_SAMPLES:
        raise ArgumentError(
            f"horizon must be at most {_MOST_SAMPLES:,} periods of {step:g} s, got {samples:,}: "
            "repeat a shorter experiment."
        )
    limit = bound("input_limit", input_limit, plant.inputs)
    if not ((limit > 0.0) & np.isfinite(limit)).all():
        raise ArgumentError(
            f"input_limit must be positive and finite, got {limit.tolist()}: the more an input "
            "moves the more a log tells."
        )
    mode = _modes(plant, signal, step, samples)
    per_mode = bool((plant.delays != plant.delays[0]).any())
    layout = Layout(plant.modes, plant.states, plant.inputs, per_mode)
    cells = cells_of(plant.delays.ravel(), step).reshape(plant.delays.shape)
    used = _used(plant, mode, step, layout, switches == "anywhere")
    S = _added_noise(plant, disturbance, step)
    if law is None:
        require_bounded(plant, horizon)
    chain = chain_of(plant, step, mode, S, cells, layout, _table(law, plant, step, mode))
    prospect = Prospect.of(chain, layout, used, criterion)
    room = _room(prospect, limit, state_limit)
    prospect = prospect.within(room)
    seed, effort = count("seed", seed, 0), count("effort", effort, 0)
    r = best_sequence(prospect, limit, count("hold", hold), effort, seed)
    usual = {
        clock: within_limits(prospect, binary_sequence(samples, limit, hold * clock))
        for clock in CLOCKS
    }
    clock = min(usual, key=lambda clock: prospect.errors(usual[clock])[layout.at_delays].prod())
    peers = {"prbs": usual[clock], "step": within_limits(prospect, steps(samples, limit))}
    return Experiment.of(plant, step, prospect, r, peers, hold * clock)


def _require_words(criterion: str, switches: str) -> None:
    if criterion not in ("delay", "all"):
        raise ArgumentError(f'criterion must be "delay" or "all", got {criterion!r}.')
    if switches not in ("anywhere", "samples"):
        raise ArgumentError(f'switches must be "anywhere" or "samples", got {switches!r}.')


def _modes(
    plant: SwitchedSystem, signal: SwitchingSignal | None, step: float, samples: int
) -> Int[np.ndarray, " sample"]:
    """The mode of every row."""
    if signal is None:
        if plant.modes > 1:
            raise ArgumentError(
                f"signal must be given for a plant of {plant.modes} modes: those that it is put "
                "into, such as SwitchingSignal.periodic([2.0, 2.0], [0, 1], horizon)."
            )
        return np.zeros(samples, np.int64)
    instance("signal", signal, SwitchingSignal)
    signal.require_modes(plant.modes)
    return np.asarray(modes_at(signal, step * np.arange(samples), step), np.int64)


def _used(
    plant: SwitchedSystem, mode: np.ndarray, step: float, layout: Layout, anywhere: bool
) -> Bool[np.ndarray, " sample"]:
    """The periods that an identification uses: those whose inputs it knows."""
    first = int(cells_of(plant.delays.max(keepdims=True).ravel() + REACH * step, step)[0])
    used = np.arange(mode.size) >= first
    used[-1] = False
    if anywhere:
        used[:-1] &= mode[1:] == mode[:-1]
    least = 2 * (layout.n + 2 * layout.m) + 1
    visits = np.bincount(mode[used], minlength=layout.modes)
    for i in np.flatnonzero(visits < least):
        what = f"signal must hold mode {i} for" if layout.modes > 1 else "horizon must have"
        raise ArgumentError(
            f"{what} at least {least} periods after the first "
            f"{first * step:g} s, got {visits[i]}: so short a log hardly tells it. "
            "Lengthen the horizon, or visit the mode for longer."
        )
    return used


def _added_noise(
    plant: SwitchedSystem, disturbance: ArrayLike, step: float
) -> Float[np.ndarray, "mode n n"]:
    """S of every mode: what noise adds in a period."""
    n, form = plant.states, "a number, (n,), (n, n) or (modes, n, n)"
    given = as_floats("disturbance", disturbance, form)
    each = {0: lambda W: W * np.eye(n), 1: np.diag}.get(given.ndim, lambda W: W)(given)
    if each.shape not in ((n, n), (plant.modes, n, n)) or not np.isfinite(each).all():
        raise ArgumentError(f"disturbance must be {form}, finite, got shape {given.shape}.")
    W = np.broadcast_to(each, (plant.modes, n, n))
    S = np.array(
        [noise_covariances(plant.A[i : i + 1], W[i], np.array([step]))[0] for i in range(len(W))]
    )
    try:
        np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        raise ArgumentError(
            "disturbance must move every state within a period, in every mode: without noise a log "
            "tells a delay exactly, whatever the inputs. Give a W that is positive definite."
        ) from None
    return S


def _table(
    law: Law | None, plant: SwitchedSystem, step: float, mode: np.ndarray
) -> Feedback | None:
    """The law's table."""
    if law is None:
        return None
    from deadtime.feedback import Law

    instance("law", law, Law)
    if law.outputs is not None:
        raise ArgumentError(
            "law must be one of the measured states here: an observer's error is not followed. "
            "Give the law that the observer feeds."
        )
    times = step * np.arange(mode.size)
    at = np.flatnonzero(np.diff(mode, prepend=-1))
    along = SwitchingSignal(times[at], mode[at])
    table = law.digital(step, along, mode.size)
    m, n = table.state_gain.shape[1:]
    if (n, m) != (plant.states, plant.inputs) or table.memory:
        raise ArgumentError(
            f"law must be a table of {plant.states} states and {plant.inputs} inputs without a "
            f"memory of its own, got {n} and {m}."
        )
    return table


def _room(
    prospect: Prospect, limit: Float[np.ndarray, " m"], state_limit: ArrayLike | None
) -> Float[np.ndarray, "sample y"]:
    """What means of states and inputs may reach: their limits less that of the noise."""
    n, m = prospect.layout.n, prospect.layout.m
    largest = np.full(n + m, np.inf)
    if state_limit is not None:
        largest[:n] = bound("state_limit", state_limit, n)
    if not prospect.chain.open:
        largest[n:] = limit
    room = largest - SIGMAS * prospect.deviation
    least = room.min(axis=0)
    for place in np.flatnonzero(~(least > 0.0)):
        what = f"state_limit[{place}]" if place < n else f"input_limit[{place - n}]"
        raise ArgumentError(
            f"{what} must be above {largest[place] - least[place]:.3g}, three standard deviations "
            "of what the noise does alone, got "
            f"{largest[place]:g}: widen it, or give a law that holds the plant tighter."
        )
    return room
