"""`design_experiment`: inputs whose log identifies a plant's delays best, as an `Experiment`.

They minimise the Cramér–Rao bound of the delays (`experiment_information`) by a search over inputs
within limits (`input_design`); the errors of a PRBS and a step are given for comparison.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from deadtime.base.checks import bound, brief, count, instance, positive, read_only
from deadtime.base.errors import ArgumentError
from deadtime.base.files import replacing
from deadtime.base.frozen import Frozen
from deadtime.identification.experiment_information import (
    ExactStates,
    NoiseTables,
    NoisyStates,
    chain_of,
    require_bounded,
)
from deadtime.identification.identify import require_switches
from deadtime.identification.input_design import (
    CLOCKS,
    SIGMAS,
    Prospect,
    best_sequence,
    binary_sequence,
    steps,
    within_limits,
)
from deadtime.identification.likelihoods.likelihood import REACH
from deadtime.identification.parameters import Layout, Square, Squares, Vector, cells_of
from deadtime.numerics.covariance import noise_covariances
from deadtime.plant import OperatingPoint, SwitchedSystem
from deadtime.plant.weight import intensities
from deadtime.switching import SwitchingSignal
from deadtime.switching.grid import modes_at

if TYPE_CHECKING:
    import pandas as pd

    from deadtime.feedback import Feedback, Law


@dataclass(frozen=True, eq=False, repr=False)
class Experiment(Frozen):
    """Inputs within limits that identify a plant's delays and matrices well (immutable).

    Attributes
    ----------
    plant : SwitchedSystem
        The plant that the inputs were designed for.
    time : (T,) array
        Seconds; an input is held from its row's time to the next one's.
    inputs : (m, T) array
        Deviations from rest; with a law, they are added to its commands.
    mode : (T,) array
        The mode from each row to the next.
    delay_errors : dict of (delays,) arrays
        Expected standard errors of the delays, seconds, of "experiment" and, for comparison, of
        "prbs", the best maximum-length binary sequence within the same limits, and "step".
    clock : int
        The number of rows for which each value of that sequence is held.
    errors : (size,) array
        Expected standard errors of all unknowns, in the order of `names`.
    largest : (n + m,) array
        Bounds of the magnitudes of every state and input, at three standard deviations of the
        noise.
    added : bool
        Whether the inputs are added to a law's.
    sentences : tuple of str
        The results in words.

    Examples
    --------
    See `design_experiment`.
    """

    plant: SwitchedSystem
    time: Float[np.ndarray, " T"]
    inputs: Float[np.ndarray, "m T"]
    mode: Int[np.ndarray, " T"]
    delay_errors: Mapping[str, Float[np.ndarray, " delay"]]
    clock: int
    errors: Vector
    largest: Float[np.ndarray, " y"]
    added: bool
    sentences: tuple[str, ...]
    _layout: Layout = field(repr=False)

    @classmethod
    def of(
        cls,
        plant: SwitchedSystem,
        step: float,
        prospect: Prospect,
        r: Float[np.ndarray, "T m"],
        peers: Mapping[str, Float[np.ndarray, "T m"]],
        clock: int,
        averaged: bool,
    ) -> Experiment:
        """The result of a search: inputs r, and other inputs for comparison.

        averaged : whether the noise of modes differs, so that its mean was used
        """
        layout, chain, errors = prospect.layout, prospect.chain, prospect.errors(r)
        deviations = {"experiment": read_only(errors[layout.at_delays])}
        for name, one in peers.items():
            deviations[name] = read_only(prospect.errors(one)[layout.at_delays])
        largest = prospect.reach(r).max(axis=0)
        sentences = _sentences(plant, step, layout, deviations, clock, largest)
        if chain.V.any():
            noise = ", ".join(f"{v:.3g}" for v in np.sqrt(chain.V))
            sentences += (f"Sensors are taken to be noisy, with deviations of {noise}.",)
        if averaged:
            sentences += (
                "Noise of the plant is taken to be the same in all modes, the mean of theirs over "
                "the rows, as identify finds one for all where sensors are noisy.",
            )
        time, added = step * np.arange(len(r)), not chain.open
        return cls(
            plant=plant,
            time=time,
            inputs=r.T,
            mode=chain.mode,
            delay_errors=deviations,
            clock=clock,
            errors=errors,
            largest=largest,
            added=added,
            sentences=sentences,
            _layout=layout,
        )

    @property
    def names(self) -> tuple[str, ...]:
        """The unknowns, named as in the `Identification` of the log."""
        return tuple(self._layout.names())

    def standard_error(self, name: str) -> float:
        """The expected standard error of an unknown, by its name in `names`."""
        if name not in self.names:
            known = ", ".join(self.names)
            raise ArgumentError(f"name must be one of {known}, got {brief(name)}.")
        return float(self.errors[self.names.index(name)])

    @property
    def message(self) -> str:
        """The sentences, as one text."""
        return " ".join(self.sentences)

    def sent(self, operating_point: OperatingPoint | None) -> Float[np.ndarray, "m T"]:
        """`inputs` as sent to actuators: with the operating point added."""
        if operating_point is None or self.added:
            return self.inputs
        return operating_point.u[:, None] + self.inputs

    def to_pandas(self, operating_point: OperatingPoint | None = None) -> pd.DataFrame:
        """A table with columns t, u1, … (add_u1, … where a law's are added to) and mode.

        With an operating point u1, … are :math:`u_0 + u`.
        """
        import pandas as pd

        head, sent = "add_u" if self.added else "u", self.sent(operating_point)
        columns = {"t": self.time} | {f"{head}{j + 1}": u for j, u in enumerate(sent)}
        return pd.DataFrame({**columns, "mode": self.mode})

    def to_csv(
        self, path: str | PathLike[str], operating_point: OperatingPoint | None = None
    ) -> None:
        """Write that table as CSV: a row per period, to be replayed.

        Raises
        ------
        ArgumentError
            If the file cannot be written.
        """
        table = self.to_pandas(operating_point)
        table["t"] = [f"{t:.12g}" for t in self.time]
        with replacing(path) as place:
            table.to_csv(place, index=False, float_format="%.12g")


def _sentences(
    plant: SwitchedSystem,
    step: float,
    layout: Layout,
    deviations: Mapping[str, np.ndarray],
    clock: int,
    largest: np.ndarray,
) -> tuple[str, ...]:
    """Expected errors, those of usual inputs for comparison, and warnings."""
    names = layout.names()[layout.at_delays]
    hold = "" if clock == 1 else f", each value held for {clock} periods"
    sentences = []
    for place, name in enumerate(names):
        own, prbs, edge = (
            f"{error:.3g} ms" if np.isfinite(error) else "infinite: it does not identify it"
            for error in (1e3 * deviations[key][place] for key in ("experiment", "prbs", "step"))
        )
        sentences.append(
            f"Expected standard error of {name}: {own}; of the best binary sequence (PRBS{hold}) "
            f"{prbs}, of a step {edge}."
        )
    D = plant.delays if layout.per_mode else plant.delays[0]
    off = np.abs(D - step * np.rint(D / step)).ravel()
    near = [n for n, o, e in zip(names, off, deviations["experiment"], strict=True) if o < 2.0 * e]
    if near:
        are, its = ("are", "their intervals") if len(near) > 1 else ("is", "its interval")
        sentences.append(
            f"{', '.join(near)} {are} within two standard errors of a whole number of periods, "
            f"where the likelihood has a kink: {its} may be longer or shorter than promised."
        )
    n = plant.states
    states, inputs = (", ".join(f"{v:.3g}" for v in part) for part in np.split(largest, [n]))
    sentences.append(
        f"At three standard deviations of the noise |x| stays below {states}, |u| below {inputs}."
    )
    return tuple(sentences)


# Relative to the trace of all noise: W has at least this in every direction, so its root has an
# inverse.
_FLOOR = 1e-9


def _modes_of_rows(
    plant: SwitchedSystem, signal: SwitchingSignal | None, step: float, samples: int
) -> Int[np.ndarray, " sample"]:
    if signal is None:
        if plant.modes > 1:
            raise ArgumentError(
                f"signal must be given for a plant of {plant.modes} modes: the modes that it is "
                "put into, such as SwitchingSignal.periodic([2.0, 2.0], [0, 1], horizon)."
            )
        return np.zeros(samples, np.int64)
    instance("signal", signal, SwitchingSignal)
    signal.require_modes(plant.modes)
    return np.asarray(modes_at(signal, step * np.arange(samples), step), np.int64)


def _used_periods(
    plant: SwitchedSystem, mode: np.ndarray, step: float, layout: Layout, anywhere: bool
) -> Bool[np.ndarray, " sample"]:
    """The periods that an identification uses: the inputs that act in them are known."""
    first = int(cells_of(plant.delays.max(keepdims=True).ravel() + REACH * step, step)[0])
    used = np.arange(mode.size) >= first
    used[-1:] = False
    if anywhere:
        used[:-1] &= mode[1:] == mode[:-1]
    least = layout.least_periods
    visits = np.bincount(mode[used], minlength=layout.modes)
    for i in np.flatnonzero(visits < least):
        what = f"signal must hold mode {i} for" if layout.modes > 1 else "horizon must have"
        raise ArgumentError(
            f"{what} at least {least} periods after the first "
            f"{first * step:g} s, got {visits[i]}: so short a log hardly identifies it. "
            "Lengthen the horizon, or visit the mode for longer."
        )
    return used


def _intensity_of(plant: SwitchedSystem, disturbance: ArrayLike) -> Squares:
    """W of every mode, checked: symmetric and positive semidefinite."""
    modes, n = plant.modes, plant.states
    return np.broadcast_to(intensities("disturbance", disturbance, modes, n), (modes, n, n))


def _deviations_of(plant: SwitchedSystem, noise: ArrayLike) -> Float[np.ndarray, " n"]:
    """The standard deviations of the sensors of the states, checked."""
    deviation = bound("noise", noise, plant.states)
    if not ((deviation >= 0.0) & np.isfinite(deviation)).all():
        raise ArgumentError(
            "noise must be the standard deviation of every state's sensor, finite and at least 0, "
            f"got {deviation.tolist()}."
        )
    return deviation


def _averaged(W: Squares, mode: Int[np.ndarray, " sample"]) -> tuple[Squares, bool]:
    """The mean of W over the rows in every mode, and whether W differed between modes."""
    share = np.bincount(mode, minlength=len(W)) / mode.size
    mean = np.broadcast_to(np.tensordot(share, W, 1), W.shape)
    own = np.abs(W - W[0]).max() > 1e-9 * np.abs(W).max()
    return (mean, True) if own else (W, False)


def _noise_of_period(
    plant: SwitchedSystem, W: Squares, step: float, deviation: Float[np.ndarray, " n"]
) -> Squares:
    """S of every mode: the covariance of the noise of a period."""
    S = noise_covariances(plant.A, W, np.full(len(W), step))
    try:
        np.linalg.cholesky(S + np.diag(deviation**2))
    except np.linalg.LinAlgError:
        raise ArgumentError(
            "disturbance must move every state within a period, in every mode, or its sensor be "
            "noisy: without noise a log identifies a delay exactly, whatever the inputs. Give a W "
            "that reaches all states, or their noise=."
        ) from None
    return S


def root_of(W: Square, deviation: Float[np.ndarray, " n"], step: float) -> Square:
    """L with L Lᵀ = W plus a little noise in every direction."""
    floor = _FLOOR * (float(np.trace(W)) + float((deviation**2).sum()) / step)
    return np.linalg.cholesky(W + floor * np.eye(len(W)))


def _table_of(
    law: Law | None, plant: SwitchedSystem, step: float, mode: np.ndarray
) -> Feedback | None:
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
            f"state of its own, got {n} and {m}."
        )
    return table


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
    hold: int = 1,
    switches: str = "samples",
    effort: int = 10,
    seed: int = 0,
) -> Experiment:
    """Inputs within limits whose log identifies the plant's delays best, found by a search.

    They minimise the Cramér–Rao bound of the delays: the least product of their variances that any
    unbiased estimate from the log can have, with A, B and the noise unknown, too. The bound is
    exact, for states measured with noise or without: docs/theory/identification.md.

    Parameters
    ----------
    plant : SwitchedSystem
        A first estimate, such as `fit.plant` of a short log.
    horizon : float
        Length of the experiment, seconds; at most 20,000 periods.
    step : float
        Sampling period, seconds.
    input_limit : float or (m,) array_like
        The bound of :math:`|u|`.
    disturbance : array_like
        :math:`W`, the intensity of the process noise, :math:`x^2` per second: a number for number
        times :math:`I`, (n,) for a diagonal, (n, n), or (modes, n, n) for one per mode, such as
        `fit.disturbance`.
    noise : float or (n,) array_like
        Standard deviation of every state's sensor, in its units, such as `fit.noise`. If not 0,
        every mode has the mean of W over the rows, as `identify` then finds one W for all modes.
    signal : SwitchingSignal, optional
        The modes that the plant is put into; read at samples. Not needed for one mode.
    law : Law, optional
        The experiment is added to the inputs of this law; an unstable plant needs one. A law that
        uses past inputs must be given the inputs sent (`applied` of `Controller.update`).
    state_limit : float or (n,) array_like, optional
        The bound of every :math:`|x_i|` at samples of a run from rest, by its mean and three
        standard deviations.
    hold : int
        The least number of periods for which each value is held.
    switches : "samples" or "anywhere"
        The `switches` of `identify`; with "anywhere" it leaves out periods in which the mode
        changes.
    effort : int
        The number of restarts of the search from its best result.
    seed : int
        The seed of the search.

    Returns
    -------
    Experiment

    Raises
    ------
    ArgumentError
        If an argument is malformed, a mode is hardly visited, the run is unstable, noise alone
        exceeds a limit, or no inputs identify all unknowns.

    References
    ----------
    Goodwin and Payne, "Dynamic System Identification", Academic Press 1977, chapter 6.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[-1.0]]], [[[1.0]]], 0.27)
    >>> experiment = dt.design_experiment(plant, 10.0, 0.1, 1.0, disturbance=1e-3, effort=0)
    >>> round(1e3 * experiment.standard_error("delay"), 1), experiment.inputs.shape
    (0.7, (1, 100))
    >>> errors = experiment.delay_errors
    >>> bool(errors["experiment"] < errors["prbs"] < errors["step"])
    True
    """
    instance("plant", plant, SwitchedSystem)
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
    mode = _modes_of_rows(plant, signal, step, samples)
    per_mode = bool((plant.delays != plant.delays[0]).any())
    layout = Layout(plant.modes, plant.states, plant.inputs, per_mode)
    cells = cells_of(plant.delays.ravel(), step).reshape(plant.delays.shape)
    used = _used_periods(plant, mode, step, layout, switches == "anywhere")
    W = _intensity_of(plant, disturbance)
    deviation, averaged = _deviations_of(plant, noise), False
    if deviation.any():
        W, averaged = _averaged(W, mode)
    S = _noise_of_period(plant, W, step, deviation)
    table = _table_of(law, plant, step, mode)
    chain = chain_of(plant, step, mode, S, cells, layout, table, deviation**2)
    require_bounded(chain)
    if deviation.any():
        tables = NoiseTables.of(layout, plant.A, root_of(W[0], deviation, step), step)
        measured = NoisyStates.of(chain, used, layout.size, tables)
    else:
        measured = ExactStates.of(chain, used, layout.size)
    prospect = Prospect.of(chain, layout, measured)
    prospect = replace(prospect, room=_room(prospect, limit, state_limit))
    seed, effort = count("seed", seed, 0), count("effort", effort, 0)
    r = best_sequence(prospect, limit, count("hold", hold), effort, seed)
    if not np.isfinite(prospect.errors(r)).all():
        raise ArgumentError(
            "horizon must leave inputs that identify all unknowns, got none such: lengthen it, "
            "hold values for fewer periods, or leave out an input that does nothing."
        )
    usual = {
        clock: within_limits(prospect, binary_sequence(samples, limit, hold * clock))
        for clock in CLOCKS
    }
    clock = min(usual, key=lambda clock: prospect.errors(usual[clock])[layout.at_delays].prod())
    peers = {"prbs": usual[clock], "step": within_limits(prospect, steps(samples, limit))}
    return Experiment.of(plant, step, prospect, r, peers, hold * clock, averaged)


def _room(
    prospect: Prospect, limit: Float[np.ndarray, " m"], state_limit: ArrayLike | None
) -> Float[np.ndarray, "sample y"]:
    """Limits of the means of states and inputs: the limits less three deviations of the noise."""
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
            f"of the noise alone, got {largest[place]:g}: widen it, or give a law that holds the "
            "plant tighter."
        )
    return room
