"""The switching signal: which mode is active when.

Signals are right-continuous: at a switching instant the new mode is already active. They live
on [0, end); past a finite end the last mode goes on. Two neighbouring entries with the same
mode are one sojourn, so a log sampled at regular times is a valid signal too.

Random ones have a minimum or an average dwell time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, brief, count, number, positive, real_array
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.switching.constraint import PerMode, SwitchingConstraint, least_slope
from deadtime.switching.models.jump_process import JumpProcess, Quantiles, Switches, require_few
from deadtime.switching.models.sojourns import Fixed, ShiftedExponential, truncate
from deadtime.switching.signal_class import SignalClass


@dataclass(frozen=True, eq=False, repr=False, init=False)
class SwitchingSignal(Frozen):
    """A piecewise constant, right-continuous switching signal σ (immutable).

    Parameters
    ----------
    times : array_like, shape (sojourns,)
        Start of each sojourn in seconds; times[0] = 0, strictly increasing.
    modes : array_like of int, shape (sojourns,)
        Mode of each sojourn, counted from 0.
    end : float
        Time up to which the signal is known, in seconds; infinite by default.
    initial_age : float
        How long the first mode has been active before time 0, seconds; laws that count a mode's
        age start from it.

    Raises
    ------
    ArgumentError
        If times are unsorted, repeated, do not start at 0 or reach `end`, or modes are not
        non-negative integers.

    Examples
    --------
    >>> signal = SwitchingSignal([0.0, 0.5, 0.75], [0, 1, 0], end=2.0)
    >>> signal([0.0, 0.4999, 0.5, 1.9])
    array([0, 0, 1, 0])
    >>> signal.dwell_time
    0.25
    """

    times: Float[np.ndarray, " sojourn"]
    modes: Int[np.ndarray, " sojourn"]
    end: float
    initial_age: float

    def __init__(
        self,
        times: ArrayLike,
        modes: ArrayLike,
        end: float = np.inf,
        *,
        initial_age: float = 0.0,
    ) -> None:
        times = real_array("times", times, "(sojourns,)", 1)
        modes = _mode_array(modes, times.size)
        if times[0] != 0.0:
            raise ArgumentError(
                f"times[0] must be 0, got {times[0]:g}: subtract it from times, or give the "
                "mode that is active from 0 on."
            )
        wrong = np.flatnonzero(np.diff(times) <= 0.0)
        if wrong.size:
            i = int(wrong[0]) + 1
            kind = "repeated" if times[i] == times[i - 1] else "unsorted"
            raise ArgumentError(
                f"times must be strictly increasing, but times[{i}] = {times[i]:g} after "
                f"{times[i - 1]:g} is {kind}: sort the switches and keep one mode per instant."
            )
        end = np.inf if end == np.inf else number("end", end)
        if not end > times[-1]:
            raise ArgumentError(
                f"end must be later than the last switch at {times[-1]:g} s, got {end:g}."
            )
        age = number("initial_age", initial_age)
        if age < 0.0:
            raise ArgumentError(f"initial_age must be ≥ 0, in s, got {age:g}.")
        new = np.concatenate(([True], np.diff(modes) != 0))
        times, modes = times[new], modes[new]
        times.flags.writeable = modes.flags.writeable = False
        vars(self).update(times=times, modes=modes, end=end, initial_age=age)

    # -- reading ---------------------------------------------------------------------------

    def __call__(self, t: ArrayLike) -> Int[np.ndarray, ...]:
        """σ(t) at times t ≥ 0 of any shape; past the end the last mode goes on."""
        t = as_floats("t", t, "seconds")
        if not (t >= 0.0).all():
            raise ArgumentError("t must be ≥ 0: a switching signal starts at time 0.")
        return self.modes[np.searchsorted(self.times, t, side="right") - 1]

    @property
    def switches(self) -> int:
        """Number of switches."""
        return self.times.size - 1

    @property
    def sojourns(self) -> Float[np.ndarray, " switch"]:
        """Length of every sojourn that ends in a switch, seconds.

        The first one began `initial_age` before 0.
        """
        lengths = np.diff(self.times)
        lengths[:1] += self.initial_age
        return lengths

    @property
    def dwell_time(self) -> float:
        """The shortest sojourn that ends in a switch, in seconds.

        Infinite when the signal never switches.
        """
        return float(self.sojourns.min()) if self.switches else np.inf

    def last_switch(self, t: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
        r"""When the mode active at each time :math:`t \ge 0` began; before 0 for the first."""
        began = self.times.copy()
        began[0] = -self.initial_age
        return began[np.searchsorted(self.times, t, side="right") - 1]

    def average_dwell_time(self, chatter: float = 1.0) -> float:
        r"""The largest average dwell time that the signal keeps, seconds.

        The largest :math:`\tau_a` with at most chatter + :math:`(t - s)/\tau_a` switches in every
        :math:`[s, t]`.

        Takes a time and a memory proportional to the switches.

        References
        ----------
        Hespanha and Morse, "Stability of switched systems with average dwell-time", CDC 1999.

        Examples
        --------
        >>> SwitchingSignal([0, 1.0, 1.1, 3.0], [0, 1, 0, 1]).average_dwell_time(chatter=2)
        2.0
        """
        if (allowed := number("chatter", chatter)) < 0.0:
            raise ArgumentError(f"chatter must be ≥ 0, a number of switches, got {allowed:g}.")
        return float(least_slope(self.times[1:], allowed))

    def require_dwell_time(self, dwell_time: float) -> SwitchingSignal:
        """The signal itself, when it keeps the declared dwell time; an error otherwise."""
        if self.dwell_time < positive("dwell_time", dwell_time) * (1.0 - 1e-9):
            i = int(np.argmin(self.sojourns))
            raise ArgumentError(
                f"dwell_time is declared as {dwell_time:g} s, but the signal stays in mode "
                f"{self.modes[i]} only from {self.times[i]:g} to {self.times[i + 1]:g} s: "
                f"declare at most {self.dwell_time:g} s."
            )
        return self

    def require_admissible(
        self,
        dwell_time: PerMode | None = None,
        maximum_dwell: PerMode | None = None,
        transitions: ArrayLike | None = None,
        *,
        modes: int | None = None,
    ) -> SwitchingSignal:
        """The signal itself, when all that it does is allowed; an error names what first is not.

        Parameters
        ----------
        dwell_time, maximum_dwell : float, or one per mode, optional
            The shortest and the longest sojourn, seconds.
        transitions : (modes, modes) of bool, optional
            Whether it may switch from mode i (row) to mode j (column).
        modes : int, optional
            Number of modes; by default that of `transitions`, or of the largest mode plus one.

        Raises
        ------
        ArgumentError
            If a sojourn is too short or too long, or a switch is not allowed, with its time.

        Examples
        --------
        >>> signal = SwitchingSignal([0.0, 0.5, 0.75], [0, 1, 0])
        >>> signal.require_admissible(dwell_time=[0.4, 0.2]) is signal
        True
        """
        if modes is None:
            modes = len(transitions) if np.ndim(transitions) == 2 else int(self.modes.max()) + 1  # pyright: ignore
        SignalClass(dwell_time, maximum_dwell, transitions).limits(modes).require(self)
        return self

    def require_modes(self, modes: int) -> SwitchingSignal:
        """The signal itself, when all its modes are in 0, …, modes − 1; an error otherwise."""
        if self.modes.max() >= modes:
            i = int(np.argmax(self.modes))
            raise ArgumentError(
                f"signal enters mode {self.modes[i]} at {self.times[i]:g} s, but the plant's "
                f"modes are 0..{modes - 1}: modes count from 0."
            )
        return self

    def after(self, time: float) -> SwitchingSignal:
        """The signal from `time` on, with that instant as its new 0; its mode keeps its age.

        That age counts from the true last switch, which a law that sees the mode at samples only
        may have missed: after two switches within one step it starts younger than in a whole run.
        """
        if not 0.0 <= number("time", time) < self.end:
            raise ArgumentError(f"time must be in [0, end) = [0, {self.end:g}), got {time:g}.")
        later = self.times > time
        times = np.concatenate(([0.0], self.times[later] - time))
        modes = np.concatenate((self([time]), self.modes[later]))
        age = time - float(self.last_switch(np.array([time]))[0])
        return SwitchingSignal(times, modes, self.end - time, initial_age=age)

    # -- making ----------------------------------------------------------------------------

    @classmethod
    def constant(cls, mode: int) -> SwitchingSignal:
        """A constant switching signal: one mode held."""
        return cls(np.zeros(1), np.array([mode]))

    @classmethod
    def periodic(cls, sojourns: ArrayLike, modes: Sequence[int], horizon: float) -> SwitchingSignal:
        """The modes in turn, each for its sojourn in seconds, over and over up to `horizon`.

        Examples
        --------
        >>> SwitchingSignal.periodic([0.2, 0.3], [0, 1], horizon=1.0).times
        array([0. , 0.2, 0.5, 0.7])
        """
        length = real_array("sojourns", sojourns, "(modes in a period,)", 1)
        cycle = _mode_array(modes, length.size)
        if length.min() <= 0.0:
            raise ArgumentError(f"sojourns must be positive, in s, got {length.min():g}.")
        horizon = positive("horizon", horizon)
        require_few(horizon, float(length.mean()))
        rounds = int(np.ceil(horizon / length.sum()))
        starts = np.concatenate(([0.0], np.cumsum(length)[:-1]))
        times = (np.arange(rounds)[:, None] * length.sum() + starts).ravel()
        keep = times < horizon
        return cls(times[keep], np.tile(cycle, rounds)[keep], horizon)

    @classmethod
    def random(
        cls,
        modes: int,
        horizon: float,
        *,
        dwell_time: PerMode | None = None,
        maximum_dwell: PerMode | None = None,
        transitions: ArrayLike | None = None,
        average_dwell_time: float | None = None,
        mean_sojourn: float | None = None,
        chatter: int = 2,
        seed: int = 0,
    ) -> SwitchingSignal:
        r"""A random signal with a minimum or an average dwell time.

        With `dwell_time` :math:`\tau_d`, sojourns are :math:`\tau_d` plus an exponential time of
        mean mean_sojourn − :math:`\tau_d`; `mean_sojourn` is :math:`2 \tau_d` unless given. With
        `average_dwell_time` :math:`\tau_a`, switches arrive as a Poisson process with mean spacing
        `mean_sojourn` (:math:`\tau_a` unless given) and pass a leaky bucket: it fills at the rate
        :math:`1/\tau_a` up to `chatter`, and each switch takes 1 from it, so every interval
        :math:`[s, t]` holds at most chatter + :math:`(t - s)/\tau_a` switches. The first mode is
        uniform, each next one uniform over the others. With a minimum dwell time it is the signal
        of a `SemiMarkov` model: ``SemiMarkov(expon(loc=τ_d, scale=mean_sojourn − τ_d),
        modes=modes).sample(horizon, seed)``.

        Parameters
        ----------
        modes : int
            Number of modes, at least 1.
        horizon : float
            The signal ends here, in seconds.
        dwell_time : float, or one per mode
        average_dwell_time : float
            Give exactly one of the two, in seconds.
        maximum_dwell : float, or one per mode, optional
            The longest sojourn, with a dwell time, s: sojourns are drawn as without it, given that
            they are no longer.
        transitions : (modes, modes) of bool, optional
            Whether it may switch from mode i (row) to mode j (column); all by default.
        mean_sojourn : float, optional
            Mean time between switches (between proposed switches for an average dwell time), s.
        chatter : int
            :math:`N_0 \ge 1`, how many switches an average dwell time allows at once.
        seed : int
            The same seed gives the same signal; a longer horizon continues it.

        Raises
        ------
        ArgumentError
            If not exactly one dwell time is given, or the mean sojourn is below the dwell time.

        Examples
        --------
        >>> signal = SwitchingSignal.random(3, 20.0, dwell_time=0.3, seed=1)
        >>> signal.dwell_time >= 0.3
        True
        >>> signal = SwitchingSignal.random(2, 50.0, average_dwell_time=0.5, seed=1)
        >>> signal.average_dwell_time(chatter=2) >= 0.5
        True
        """
        _, times, visited = random_switches(
            modes,
            horizon,
            dwell_time=dwell_time,
            maximum_dwell=maximum_dwell,
            transitions=transitions,
            average_dwell_time=average_dwell_time,
            mean_sojourn=mean_sojourn,
            chatter=chatter,
            seed=seed,
        )
        return cls(times, visited, horizon)

    @classmethod
    def from_csv(
        cls,
        path: str | PathLike[str],
        *,
        modes: int | None = None,
        labels: Mapping[str, int] | None = None,
        end: float | None = None,
        dwell_time: float | None = None,
        unit: str | None = None,
    ) -> SwitchingSignal:
        """A signal from a log with columns `t` (or `time`) and `mode`: `deadtime.switching.log`."""
        from deadtime.switching.log import read_log

        log = read_log(path, modes=modes, labels=labels, end=end, unit=unit)
        signal = cls(log.times, log.modes, log.end, initial_age=log.initial_age)
        return signal if dwell_time is None else signal.require_dwell_time(dwell_time)

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write the log that `from_csv` reads back exactly."""
        from deadtime.switching.log import SwitchingLog, write_log

        write_log(SwitchingLog(self.times, self.modes, self.end, self.initial_age), path)

    def __repr__(self) -> str:
        return (
            f"SwitchingSignal(switches={self.switches}, end={self.end:g}, "
            f"dwell_time={self.dwell_time:g})"
        )


def _mode_array(modes: ArrayLike, count: int) -> np.ndarray:
    """`modes` as `count` non-negative integers."""
    values = real_array("modes", modes, "(sojourns,)", 1)
    if values.size != count:
        raise ArgumentError(f"modes must have one entry per time, {count}, got {values.size}.")
    if (values != np.rint(values)).any() or values.min() < 0 or values.max() > 2**31:
        raise ArgumentError(f"modes must be integers counted from 0, got {brief(values.tolist())}.")
    return values.astype(np.int64)


def random_switches(
    modes: int,
    horizon: float,
    *,
    dwell_time: PerMode | None,
    maximum_dwell: PerMode | None = None,
    transitions: ArrayLike | None = None,
    average_dwell_time: float | None,
    mean_sojourn: float | None,
    chatter: int,
    seed: int,
) -> Switches:
    """The one signal of `SwitchingSignal.random`, whose arguments these are."""
    if (dwell_time is None) == (average_dwell_time is None):
        raise ArgumentError("dwell_time or average_dwell_time: give exactly one of the two.")
    signals = SignalClass(dwell_time, maximum_dwell, transitions)
    allowed = signals.limits(count("modes", modes))
    ways = allowed.transitions.astype(float)
    if dwell_time is not None:
        means = []
        for dwell in allowed.dwell_time:
            mean = positive("mean_sojourn", mean_or_twice(dwell, mean_sojourn))
            if mean < dwell:
                raise ArgumentError(
                    f"mean_sojourn must be at least dwell_time = {dwell:g} s, got {mean:g}."
                )
            means.append(mean)
        return _process(allowed, np.array(means), ways).draw(horizon, seed)
    if maximum_dwell is not None:
        raise ArgumentError(
            "maximum_dwell goes with dwell_time, not with average_dwell_time: leave it out."
        )
    average = positive("average_dwell_time", average_dwell_time)
    mean = average if mean_sojourn is None else positive("mean_sojourn", mean_sojourn)
    most = count("chatter", chatter)
    process = _process(allowed, np.full(allowed.modes, mean), ways)
    _, times, visited = process.draw(horizon, seed)
    kept = times[_passes(times, average, most)]
    # Modes in the order drawn, whichever instants pass: each may follow the one before.
    return Switches(np.array([0, kept.size]), kept, visited[: kept.size])


def mean_or_twice(dwell_time: float, mean_sojourn: float | None = None) -> float:
    """The mean of whole sojourns, seconds: twice the dwell time where none is stated."""
    return 2.0 * dwell_time if mean_sojourn is None else mean_sojourn


def _process(allowed: SwitchingConstraint, mean: np.ndarray, ways: np.ndarray) -> JumpProcess:
    """Sojourns of the dwell time and an exponential time; each next mode uniform over the others.

    Where there is a longest sojourn, given that they are no longer.
    """
    shift, most = np.array(allowed.dwell_time), np.array(allowed.maximum_dwell)
    drawn = [
        Fixed(low) if wide == 0.0 or high == low else ShiftedExponential(low, wide)
        for low, wide, high in zip(
            shift.tolist(), (mean - shift).tolist(), most.tolist(), strict=True
        )
    ]
    ends = zip(drawn, allowed.dwell_time, allowed.maximum_dwell, strict=True)
    sojourn = [truncate("dwell_time", *each) for each in ends]
    return JumpProcess(Quantiles.of(sojourn), ways, min(float(mean.max()), float(most.max())))


def _passes(
    times: Float[np.ndarray, " sojourn"], average: float, chatter: int
) -> Bool[np.ndarray, " sojourn"]:
    """Which instants the leaky bucket lets through; the one at 0 is no switch and costs nothing."""
    passed, level, last = np.ones(times.size, dtype=bool), float(chatter), 0.0
    for i, time in enumerate(times[1:].tolist(), start=1):
        level = min(float(chatter), level + (time - last) / average)
        last = time
        passed[i] = level >= 1.0
        level -= passed[i]
    return passed
