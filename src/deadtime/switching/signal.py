"""Switching signals: the active mode as a function of time.

Signals are right-continuous: at a switching instant the new mode is already active. They are
defined on [0, end); after a finite end the last mode continues. Neighbouring entries with the same
mode are one sojourn, so the samples of a log are a valid signal, too.
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
from deadtime.switching.log import SwitchingLog, read_log, write_log
from deadtime.switching.models.jump_process import JumpProcess, Quantiles, require_few
from deadtime.switching.models.sojourns import Fixed, ShiftedExponential, truncate
from deadtime.switching.signal_class import SignalClass

ROUND_OFF = 1e-9  # relative error of a sojourn that is a difference of times


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
        self, times: ArrayLike, modes: ArrayLike, end: float = np.inf, *, initial_age: float = 0.0
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
        new = np.concatenate(([True], np.diff(modes) != 0))  # a repeated mode is no switch
        times, modes = times[new], modes[new]
        times.flags.writeable = modes.flags.writeable = False
        vars(self).update(times=times, modes=modes, end=end, initial_age=age)

    def __call__(self, t: ArrayLike) -> Int[np.ndarray, ...]:
        """σ(t) at times t ≥ 0 of any shape; after the end the last mode continues."""
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
        """Length of every sojourn that ends in a switch, seconds; the first with `initial_age`."""
        lengths = np.diff(self.times)
        lengths[:1] += self.initial_age
        return lengths

    @property
    def dwell_time(self) -> float:
        """The shortest sojourn that ends in a switch, seconds; infinite without a switch."""
        return float(self.sojourns.min()) if self.switches else np.inf

    def last_switch(self, t: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
        r"""The start of the sojourn at each time :math:`t \ge 0`; before 0 for the first one."""
        began = self.times.copy()
        began[0] = -self.initial_age
        return began[np.searchsorted(self.times, t, side="right") - 1]

    def average_dwell_time(self, chatter: float = 1.0) -> float:
        r"""The average dwell time of the signal, seconds.

        It is the largest :math:`\tau_a` with at most chatter + :math:`(t - s)/\tau_a` switches in
        every :math:`[s, t]`. Time and memory grow in proportion to the number of switches.

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
        """The signal itself, if its dwell time is at least the declared one; an error otherwise."""
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
        """The signal itself, if it is admissible; else an error with the first violation.

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
        return self.require_within(
            SignalClass(dwell_time, maximum_dwell, transitions).limits(modes)
        )

    def require_within(
        self, limits: SwitchingConstraint, tolerance: float = ROUND_OFF
    ) -> SwitchingSignal:
        """The signal itself, if it keeps these limits; else an error with the first violation.

        Sojourns may be shorter or longer by a relative `tolerance`, as a clock measures them.
        """
        self.require_modes(limits.modes)
        starts = self.times.copy()
        starts[0] -= self.initial_age
        ends = np.append(self.times[1:], self.end)
        for k, mode in enumerate(self.modes.tolist()):
            lasts, last = float(ends[k] - starts[k]), k == self.times.size - 1
            least, most = limits.dwell_time[mode], limits.maximum_dwell[mode]
            where = f"stays in mode {mode} from {starts[k]:g} s"
            if lasts > most * (1.0 + tolerance):
                until = f"to {ends[k]:g} s" if ends[k] < np.inf else "on without end"
                raise ArgumentError(
                    f"signal {where} {until}, longer than its maximum_dwell of {most:g} s: raise "
                    "maximum_dwell, or end the sojourn earlier."
                )
            if last:
                break
            if lasts < least * (1.0 - tolerance):
                raise ArgumentError(
                    f"signal {where} to {ends[k]:g} s, shorter than its dwell_time of {least:g} s: "
                    "lower dwell_time, or let the sojourn last."
                )
            after, allowed = int(self.modes[k + 1]), limits.following[mode]
            if after not in allowed:
                others = (" and " if len(allowed) < 3 else ", ").join(map(str, allowed))
                only = f"only mode{'s' * (len(allowed) > 1)} {others}" if allowed else "none"
                raise ArgumentError(
                    f"signal switches from mode {mode} to mode {after} at {ends[k]:g} s, which "
                    f"transitions does not allow: from mode {mode} {only} may follow."
                )
        return self

    def require_modes(self, modes: int) -> SwitchingSignal:
        """The signal itself, if all its modes are in 0, …, modes − 1; an error otherwise."""
        if self.modes.max() >= modes:
            i = int(np.argmax(self.modes))
            raise ArgumentError(
                f"signal enters mode {self.modes[i]} at {self.times[i]:g} s, but the plant's "
                f"modes are 0..{modes - 1}: modes count from 0."
            )
        return self

    def after(self, time: float) -> SwitchingSignal:
        """The signal from `time` on, which becomes 0; the active mode keeps its age.

        The age counts from the true last switch. A law that receives the mode at samples misses one
        of two switches within a step, and then starts with a smaller age than in the whole run.
        """
        if not 0.0 <= number("time", time) < self.end:
            raise ArgumentError(f"time must be in [0, end) = [0, {self.end:g}), got {time:g}.")
        later = self.times > time
        times = np.concatenate(([0.0], self.times[later] - time))
        modes = np.concatenate((self([time]), self.modes[later]))
        age = time - float(self.last_switch(np.array([time]))[0])
        return SwitchingSignal(times, modes, self.end - time, initial_age=age)

    @classmethod
    def constant(cls, mode: int) -> SwitchingSignal:
        """A constant switching signal: one mode held."""
        return cls(np.zeros(1), np.array([mode]))

    @classmethod
    def periodic(cls, sojourns: ArrayLike, modes: Sequence[int], horizon: float) -> SwitchingSignal:
        """A periodic signal: the modes in turn, each for its sojourn in seconds, up to `horizon`.

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
        drawn uniformly, each next one uniformly from the others. With a minimum dwell time it is
        the signal of a `SemiMarkov` model: ``SemiMarkov(expon(loc=τ_d, scale=mean_sojourn − τ_d),
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
            The longest sojourn, with a dwell time, s; it truncates the distribution of sojourns.
        transitions : (modes, modes) of bool, optional
            Whether it may switch from mode i (row) to mode j (column); all by default.
        mean_sojourn : float, optional
            Mean time between switches (between proposed switches for an average dwell time), s.
        chatter : int
            :math:`N_0 \ge 1`, the number of switches that an average dwell time allows at once.
        seed : int
            Seed; with it a longer horizon continues the same signal.

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
        if (dwell_time is None) == (average_dwell_time is None):
            raise ArgumentError("dwell_time or average_dwell_time: give exactly one of the two.")
        limits = SignalClass(dwell_time, maximum_dwell, transitions).limits(count("modes", modes))
        if dwell_time is not None:
            means = []
            for dwell in limits.dwell_time:
                mean = positive("mean_sojourn", mean_or_twice(dwell, mean_sojourn))
                if mean < dwell:
                    raise ArgumentError(
                        f"mean_sojourn must be at least dwell_time = {dwell:g} s, got {mean:g}."
                    )
                means.append(mean)
            _, times, visited = _process(limits, np.array(means)).draw(horizon, seed)
            return cls(times, visited, horizon)
        if maximum_dwell is not None:
            raise ArgumentError(
                "maximum_dwell goes with dwell_time, not with average_dwell_time: leave it out."
            )
        average = positive("average_dwell_time", average_dwell_time)
        mean = average if mean_sojourn is None else positive("mean_sojourn", mean_sojourn)
        most = count("chatter", chatter)
        _, times, visited = _process(limits, np.full(limits.modes, mean)).draw(horizon, seed)
        kept = times[_passes(times, average, most)]
        # The modes stay in the order in which they were drawn, so that each may follow the one
        # before, whichever switches are removed.
        return cls(kept, visited[: kept.size], horizon)

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
        time: str | None = None,
        mode: str = "mode",
        sep: str | None = None,
        decimal: str | None = None,
    ) -> SwitchingSignal:
        """A signal from a log with columns `t` (or `time`) and `mode`: see `switching.log`."""
        how = {"unit": unit, "time": time, "mode": mode, "sep": sep, "decimal": decimal}
        signal = cls.of_log(read_log(path, modes=modes, labels=labels, end=end, **how))
        return signal if dwell_time is None else signal.require_dwell_time(dwell_time)

    @classmethod
    def of_log(cls, log: SwitchingLog) -> SwitchingSignal:
        """The signal of a log that was read."""
        return cls(log.times, log.modes, log.end, initial_age=log.initial_age)

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write a log that `from_csv` reads without loss."""
        write_log(SwitchingLog(self.times, self.modes, self.end, self.initial_age), path)

    def __repr__(self) -> str:
        return (
            f"SwitchingSignal(switches={self.switches}, end={self.end:g}, "
            f"dwell_time={self.dwell_time:g})"
        )


def _mode_array(modes: ArrayLike, count: int) -> np.ndarray:
    values = real_array("modes", modes, "(sojourns,)", 1)
    if values.size != count:
        raise ArgumentError(f"modes must have one entry per time, {count}, got {values.size}.")
    if (values != np.rint(values)).any() or values.min() < 0 or values.max() > 2**31:
        raise ArgumentError(f"modes must be integers counted from 0, got {brief(values.tolist())}.")
    return values.astype(np.int64)


def mean_or_twice(dwell_time: float, mean_sojourn: float | None = None) -> float:
    """The mean sojourn, seconds: twice the dwell time unless it is given."""
    return 2.0 * dwell_time if mean_sojourn is None else mean_sojourn


def _process(limits: SwitchingConstraint, mean: np.ndarray) -> JumpProcess:
    """Sojourns of the dwell time plus an exponential time, truncated at the longest sojourn."""
    ends = zip(limits.dwell_time, limits.maximum_dwell, strict=True)
    sojourn = []
    for (low, high), wide in zip(ends, (mean - np.array(limits.dwell_time)).tolist(), strict=True):
        dist = Fixed(low) if wide == 0.0 or high == low else ShiftedExponential(low, wide)
        sojourn.append(truncate("dwell_time", dist, low, high))
    longest = min(float(mean.max()), max(limits.maximum_dwell))
    return JumpProcess(Quantiles.of(sojourn), limits.transitions.astype(float), longest)


def _passes(
    times: Float[np.ndarray, " sojourn"], average: float, chatter: int
) -> Bool[np.ndarray, " sojourn"]:
    """Whether the leaky bucket passes each switch; the instant 0 is none and always passes."""
    passed, level, last = np.ones(times.size, dtype=bool), float(chatter), 0.0
    for i, time in enumerate(times[1:].tolist(), start=1):
        level = min(float(chatter), level + (time - last) / average)
        last = time
        passed[i] = level >= 1.0
        level -= passed[i]
    return passed
