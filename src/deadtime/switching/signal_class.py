"""`SignalClass`: the admissible switching signals of a certificate or a search."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import brief, count, number, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.plant.discretisation import snap
from deadtime.switching.constraint import (
    PerMode,
    SwitchingConstraint,
    one_or_each,
    require_ways,
    switch_table,
    time_or_each,
)

CLOCK_TOLERANCE = 1e-5  # of a quartz, and far above the round-off of the simulator
LEAST_TOLERANCE, MOST_TOLERANCE = 1e-8, 0.1  # switches within 1e-9 periods of a sample are at it
MOST_PERIODS = 100_000  # of a dwell time: more is a mistake of units
MOST_LOST = 100
INSTANTS = ("anywhere", "samples")

Instants = Literal["anywhere", "samples"]


class SignalOptions(TypedDict, total=False):
    """The keywords of `SignalClass` beside the dwell time."""

    maximum_dwell: PerMode | None
    transitions: ArrayLike | None
    at: Instants
    clock_tolerance: float
    mode_lag: int
    lost_samples: int
    chatter: int


@dataclass(frozen=True, init=False)
class SignalClass:
    r"""The admissible switching signals, and how the controller receives the mode (immutable).

    `certify`, `falsify` and the margins take one in place of a dwell time.

    Parameters
    ----------
    dwell_time : float, or one per mode, optional
        Shortest sojourn :math:`\tau_d`, seconds. Certificates and searches need one; a problem
        file may have none.
    maximum_dwell : float, or one per mode, optional
        Longest sojourn, seconds, inf for none; by default a mode may last without end.
    transitions : (modes, modes) of bool, optional
        Whether the signal may switch from mode i (row) to mode j (column); all by default.
    at : "anywhere" or "samples"
        When the mode may change: at any instant, or only where the law samples, as a computer
        would switch it. Then every sojourn is a whole number of periods, one at least.
    clock_tolerance : float
        Relative error of the controller's clock: a sojourn may be shorter than `dwell_time` or
        longer than `maximum_dwell` by this part; from 1e-8 to 0.1, for searches from 0. So a mode
        that begins just after a sample may end at the sample a dwell time later.
    mode_lag : int
        L, in periods: the reported mode is that of L samples ago, as in a run with
        `imperfections.ModeDelay(L)`. It has no effect on a law that does not read the mode.
    lost_samples : int
        Largest number of consecutive lost samples: neither x or y nor the mode is received, as in a
        run with `imperfections.Dropout`. A law of the state holds its input, an observer predicts.
    chatter : int
        :math:`N_0`: above 1, `dwell_time` is an average dwell time :math:`\tau_a`, and any window
        of T s may hold :math:`N_0 + T/\tau_a` switches, at most one per period.

    Raises
    ------
    ArgumentError
        If an argument is malformed. `limits` checks times and transitions against a number of
        modes.

    Examples
    --------
    >>> ring = SignalClass(0.2, transitions=[[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    >>> ring.limits(3).following
    ((1,), (2,), (0,))
    >>> SignalClass(0.5, maximum_dwell=2.0, lost_samples=1).sentence(2)  # doctest: +ELLIPSIS
    'for every switching signal whose sojourns last between 0.5 s and 2.0 s, and every loss of ...'
    """

    dwell_time: float | tuple[float, ...] | None
    maximum_dwell: float | tuple[float, ...]
    transitions: tuple[tuple[bool, ...], ...] | None
    at: Instants
    clock_tolerance: float
    mode_lag: int
    lost_samples: int
    chatter: int

    def __init__(
        self,
        dwell_time: PerMode | None = None,
        maximum_dwell: PerMode | None = None,
        transitions: ArrayLike | tuple[tuple[bool, ...], ...] | None = None,
        at: Instants = "anywhere",
        clock_tolerance: float = CLOCK_TOLERANCE,
        mode_lag: int = 0,
        lost_samples: int = 0,
        chatter: int = 1,
    ) -> None:
        least = None if dwell_time is None else time_or_each("dwell_time", dwell_time)
        most = math.inf
        if maximum_dwell is not None:
            most = time_or_each("maximum_dwell", maximum_dwell, unbounded=True)
        table = None
        if transitions is not None:
            table = tuple(map(tuple, switch_table(transitions).tolist()))
        if not isinstance(at, str) or at not in INSTANTS:
            raise ArgumentError(
                f'at must be "anywhere" or "samples", got {brief(at)}: whether the mode may change '
                "at any instant, or only where the law samples."
            )
        if not 0.0 <= number("clock_tolerance", clock_tolerance) <= MOST_TOLERANCE:
            raise ArgumentError(_clock_off(clock_tolerance, 0.0))
        mode_lag = count("mode_lag", mode_lag, 0)
        lost_samples = count("lost_samples", lost_samples, 0)
        if mode_lag and lost_samples:
            raise ArgumentError(
                "lost_samples and mode_lag exclude each other: a lost sample delays the mode, too; "
                "give one of them."
            )
        chatter = count("chatter", chatter)
        if chatter > 1 and isinstance(least, tuple) and len(set(least)) > 1:
            raise ArgumentError(
                "dwell_time must be one number with chatter > 1, for an average dwell time is that "
                f"of all modes together, got {list(least)}."
            )
        if chatter > 1 and np.isfinite(most).any():
            raise ArgumentError(
                "chatter > 1 and maximum_dwell exclude each other: give one of them."
            )
        given = least, most, table, at, float(clock_tolerance), mode_lag, lost_samples, chatter
        vars(self).update(zip(type(self).__dataclass_fields__, given, strict=True))

    @classmethod
    def of(cls, dwell_time: PerMode | SignalClass, **signals: Unpack[SignalOptions]) -> SignalClass:
        """The class that is given directly, or as a dwell time with keywords."""
        if isinstance(dwell_time, SignalClass) and signals:
            name = next(iter(signals))
            raise ArgumentError(
                f"{name} must not be given beside a SignalClass, which says it: make it "
                f"SignalClass(…, {name}=…)."
            )
        given = dwell_time if isinstance(dwell_time, SignalClass) else cls(dwell_time, **signals)
        if given.dwell_time is None:
            raise ArgumentError(
                "dwell_time must be a number of seconds, or one for each mode, got none: give the "
                "shortest time that a mode lasts."
            )
        return given

    def limits(self, modes: int) -> SwitchingConstraint:
        """The limits for so many modes, with a dwell time of 0 s if the class has none.

        Raises
        ------
        ArgumentError
            If times or transitions are of another number of modes, a maximum is below its minimum,
            a mode that has to be left leads nowhere, or one is neither entered nor left.
        """
        least, most = 0.0 if self.dwell_time is None else self.dwell_time, self.maximum_dwell
        of = "[{}]" if isinstance(least, tuple) or isinstance(most, tuple) else ""
        least, most = _each("dwell_time", least, modes), _each("maximum_dwell", most, modes)
        for i, (low, high) in enumerate(zip(least, most, strict=True)):
            if high < low:
                raise ArgumentError(
                    f"maximum_dwell{of.format(i)} must be at least dwell_time{of.format(i)} = "
                    f"{low:g} s, got {high:g}."
                )
        allowed = ~np.eye(modes, dtype=bool)
        if self.transitions is not None:
            table = np.array(self.transitions)
            allowed &= require_shape("transitions", table, (modes, modes), "(modes, modes)")
        if modes > 1:
            require_ways(allowed, most)
        following = tuple(tuple(np.flatnonzero(row).tolist()) for row in allowed)
        return SwitchingConstraint(least, most, following)

    def at_period(self, modes: int, step: float, with_longest: bool = True) -> SwitchingConstraint:
        """`limits`, after a check that proofs and searches can represent them in periods.

        `with_longest`: whether the maximum dwell times are represented, too.
        """
        limits = self.limits(modes)
        longest = [time for time in limits.maximum_dwell if with_longest and math.isfinite(time)]
        least, most = max(limits.dwell_time), max(longest, default=0.0)
        if least / step > MOST_PERIODS:
            raise ArgumentError(
                f"dwell_time / step = {least / step:.3g} periods, at most {MOST_PERIODS:.0e} are "
                "possible: are both in seconds? Lengthen the step; what a shorter dwell time "
                "proves holds for a longer one too."
            )
        if most / step > MOST_PERIODS:
            raise ArgumentError(
                f"maximum_dwell / step = {most / step:.3g} periods, at most {MOST_PERIODS:.0e} "
                "are possible: are both in seconds? Lengthen the step, or leave maximum_dwell "
                "out, for sojourns of any length."
            )
        if self.chatter > MOST_PERIODS or self.chatter * least > MOST_PERIODS * step:
            raise ArgumentError(
                f"chatter · dwell_time / step must be at most {MOST_PERIODS:.0e} periods, got a "
                f"chatter of {min(self.chatter, MOST_PERIODS):.0e}"
                f"{' or more' if self.chatter > MOST_PERIODS else ''}: allow fewer switches at "
                "once, or lengthen the step."
            )
        if self.mode_lag > MOST_PERIODS:
            raise ArgumentError(
                f"mode_lag must be at most {MOST_PERIODS:,} periods, got {self.mode_lag:,}: is it "
                "in periods, not in milliseconds?"
            )
        if self.lost_samples > MOST_LOST:
            raise ArgumentError(
                f"lost_samples must be at most {MOST_LOST} in a row, got {self.lost_samples:,}: "
                "the Lyapunov function is another one after every number of them."
            )
        # With switches at samples a sojourn is a whole number of periods, if there is one between.
        for low, high in zip(limits.dwell_time, limits.maximum_dwell, strict=True):
            least = max(1.0, math.ceil(snap(low / step) * (1.0 - self.clock_tolerance)))
            most = high if math.isinf(high) else snap(high / step) * (1.0 + self.clock_tolerance)
            if self.at == "samples" and modes > 1 and most < least:
                raise ArgumentError(
                    f"maximum_dwell must leave a sojourn of whole periods of {step:g} s with at = "
                    f'"samples", got {high:g} s with a dwell time of {low:g} s: raise it, or '
                    "shorten the step."
                )
        return limits

    def require_clock(self) -> None:
        """Refuse a clock tolerance below the least that a proof can cover."""
        if self.clock_tolerance < LEAST_TOLERANCE:
            raise ArgumentError(_clock_off(self.clock_tolerance, LEAST_TOLERANCE))

    def is_plain(self, modes: int) -> bool:
        """Whether there is no limit but a dwell time that all modes share."""
        plain = self.at == "anywhere" and self.chatter == 1
        return plain and self.limits(modes).is_plain

    def sentence(self, modes: int) -> str:
        """The signals of a plant with so many modes in full precision, to follow "stable"."""
        limits = self.limits(modes)
        only = [] if self.at == "anywhere" else ["at samples only"]
        only += [] if limits.is_free else [f"only so: {limits.ways_in_words}"]
        switches = f", and that switches {', and '.join(only)}" if only and modes > 1 else ""
        lost = f", and every loss of samples with at most {self.lost_samples} in a row"
        return self._sojourns(limits) + switches + lost * (self.lost_samples > 0)

    def _sojourns(self, limits: SwitchingConstraint) -> str:
        if limits.modes == 1:
            return "with the plant's one mode"
        least, most = one_or_each(limits.dwell_time), one_or_each(limits.maximum_dwell)
        every = "for every switching signal"
        if self.chatter > 1:
            return (
                f"{every} with an average dwell time of {least!r} s (at most "
                f"{self.chatter} + T/{least!r} s switches in any T, at most one per period)"
            )
        if isinstance(least, tuple) or isinstance(most, tuple):
            times = enumerate(zip(limits.dwell_time, limits.maximum_dwell, strict=True))
            each = (
                f"at least {x!r} s in mode {i}"
                if math.isinf(y)
                else f"between {x!r} and {y!r} s in mode {i}"
                for i, (x, y) in times
            )
            return f"{every} whose sojourns last {', '.join(each)}"
        if math.isfinite(most):
            return f"{every} whose sojourns last between {least!r} s and {most!r} s"
        return f"{every} with a dwell time of {least!r} s"

    def in_words(self, modes: int) -> tuple[str, str]:
        """Clauses to follow "signals that": their sojourns or rate of switches, and the switches.

        Examples
        --------
        >>> SignalClass(2.5, chatter=3).in_words(2)[0]
        'switches at most 3 + T/(2.5 s) times in any T seconds'
        """
        when = "at any time" if self.at == "anywhere" else "at samples only"
        stays, switches = self.limits(modes).in_words(when)
        if self.chatter == 1:
            return stays, switches
        least = min(self.limits(modes).dwell_time)
        often = f"switches at most {self.chatter} + T/({least:.4g} s) times in any T seconds"
        return often, f"{switches}, once in a period at most"


def _each(name: str, times: float | tuple[float, ...], modes: int) -> tuple[float, ...]:
    each = times if isinstance(times, tuple) else (times,) * modes
    if len(each) != modes:
        raise ArgumentError(
            f"{name} must be a number of seconds, or one for each of the {modes} modes, got "
            f"{len(each)} of them."
        )
    return each


def _clock_off(tolerance: float, least: float) -> str:
    return (
        f"clock_tolerance must be a part from {least:g} to {MOST_TOLERANCE:g}, got {tolerance:g}: "
        "the relative difference of the clock that measures the dwell time from the "
        "controller's."
    )
