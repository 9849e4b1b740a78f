"""`design_experiment`: what to send to a plant so that its log tells the delays best."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import bound, count, instance, positive
from deadtime.base.errors import ArgumentError
from deadtime.identification.excitation.excited_loop import chain_of, require_bounded
from deadtime.identification.excitation.experiment import Experiment
from deadtime.identification.excitation.given import (
    added_noise,
    deviations_of,
    intensity_of,
    modes_of_rows,
    one_for_all,
    root_of,
    table_of,
    used_periods,
)
from deadtime.identification.excitation.input_information import SIGMAS, Prospect
from deadtime.identification.excitation.input_search import (
    CLOCKS,
    best_sequence,
    binary_sequence,
    steps,
    within_limits,
)
from deadtime.identification.excitation.state_information import (
    ExactStates,
    NoiseTables,
    NoisyStates,
)
from deadtime.identification.identify import require_switches
from deadtime.identification.parameters import Layout, cells_of
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal

if TYPE_CHECKING:
    from deadtime.feedback import Law

_MOST_SAMPLES = 20_000


def design_experiment(
    plant: SwitchedSystem,
    horizon: float,
    step: float,
    input_limit: ArrayLike,
    *,
    disturbance: ArrayLike,
    noise: ArrayLike = 0.0,
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
    estimate from the log can have, with A, B and the noise unknown, too. It is exact, for states
    that are measured with noise or without: docs/theory/identification.md.

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
    noise : float or (n,) array_like
        Standard deviation of every state's sensor, in its units, such as `fit.noise`; then the mean
        of W over the rows is counted with in every mode, as `identify` will find one for all.
    signal : SwitchingSignal, optional
        The modes that the plant is put into; read at samples. Not needed for one mode.
    law : Law, optional
        To whose inputs those of the experiment are added; an unstable plant needs one. It must be
        told what was sent (`applied` of `Controller.update`), where it remembers inputs.
    state_limit : float or (n,) array_like, optional
        What every |x| must not exceed at samples of a run from rest, by its mean and three standard
        deviations.
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
        If an argument is malformed, a mode is hardly visited, the run is unstable, noise alone
        exceeds a limit, or no inputs tell all unknowns apart.

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
    if criterion not in ("delay", "all"):
        raise ArgumentError(f'criterion must be "delay" or "all", got {criterion!r}.')
    require_switches(switches)
    step, horizon = positive("step", step), positive("horizon", horizon)
    if horizon / step > _MOST_SAMPLES + 0.5:
        raise ArgumentError(
            f"horizon must be at most {_MOST_SAMPLES:,} periods of {step:g} s, got "
            f"{horizon / step:,.6g}: repeat a shorter experiment."
        )
    samples = round(horizon / step)
    limit = bound("input_limit", input_limit, plant.inputs)
    if not ((limit > 0.0) & np.isfinite(limit)).all():
        raise ArgumentError(
            f"input_limit must be positive and finite, got {limit.tolist()}: the more an input "
            "moves the more a log tells."
        )
    mode = modes_of_rows(plant, signal, step, samples)
    per_mode = bool((plant.delays != plant.delays[0]).any())
    layout = Layout(plant.modes, plant.states, plant.inputs, per_mode)
    cells = cells_of(plant.delays.ravel(), step).reshape(plant.delays.shape)
    used = used_periods(plant, mode, step, layout, switches == "anywhere")
    W = intensity_of(plant, disturbance)
    deviation, averaged = deviations_of(plant, noise), False
    if deviation.any():
        W, averaged = one_for_all(W, mode)
    S = added_noise(plant, W, step, deviation)
    table = table_of(law, plant, step, mode)
    chain = chain_of(plant, step, mode, S, cells, layout, table, deviation**2)
    require_bounded(chain)
    if deviation.any():
        tables = NoiseTables.of(layout, plant.A, root_of(W[0], deviation, step), step)
        measured = NoisyStates.of(chain, used, layout.size, tables)
    else:
        measured = ExactStates.of(chain, used, layout.size)
    prospect = Prospect.of(chain, layout, measured, criterion)
    room = _room(prospect, limit, state_limit)
    prospect = prospect.within(room)
    seed, effort = count("seed", seed, 0), count("effort", effort, 0)
    r = best_sequence(prospect, limit, count("hold", hold), effort, seed)
    _require_told(prospect, r)
    usual = {
        clock: within_limits(prospect, binary_sequence(samples, limit, hold * clock))
        for clock in CLOCKS
    }
    clock = min(usual, key=lambda clock: prospect.errors(usual[clock])[layout.at_delays].prod())
    peers = {"prbs": usual[clock], "step": within_limits(prospect, steps(samples, limit))}
    return Experiment.of(plant, step, prospect, r, peers, hold * clock, averaged)


def _require_told(prospect: Prospect, r: Float[np.ndarray, "sample m"]) -> None:
    """Refuse a plant that no inputs tell."""
    if np.isfinite(prospect.errors(r)).all():
        return
    raise ArgumentError(
        "horizon must leave inputs that tell all unknowns apart, got none such: lengthen it, hold "
        "values for fewer periods, or leave out an input that does nothing."
    )


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
