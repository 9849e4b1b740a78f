"""The sojourns that a class of switching signals allows, which mode may follow, and how often.

A signal is admissible if every sojourn in mode i that ends in a switch lasts at least
`dwell_time[i]` and none lasts longer than `maximum_dwell[i]`, and if it switches from i to j only
where `transitions[i, j]` allows it. It may begin in any mode.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from deadtime.base.checks import positive, real_array
from deadtime.base.errors import ArgumentError
from deadtime.numerics.kernels import kernel

if TYPE_CHECKING:
    PerMode = float | Sequence[float] | np.ndarray
else:
    PerMode = object  # checked inside, with better messages


@kernel
def least_slope(t, chatter):
    """min (t_j − t_i)/(j + 1 − chatter − i) over i ≤ j where positive; infinite for no pair.

    That is the average dwell time of a signal with N₀ = chatter, in one pass over its switches.
    Between switch i and switch j ≥ i, at t_i and t_j, there are j − i + 1 of them: at most
    N₀ + (t_j − t_i)/τ for all i, j means

        τ ≤ (t_j − t_i)/(j + 1 − N₀ − i)   wherever the denominator is positive,

    the slope from the point (i, t_i) to the point (j + 1 − N₀, t_j). The least slope to a point
    comes from the upper hull of the points to its left, and the hull's first points, once steeper
    than those that follow, never matter again.

    References ---------- K.-M. Chung and H.-I. Lu, "An optimal algorithm for the maximum-density
    segment problem", SIAM J. Comput. 34(2), 2004.
    """
    hull = np.empty(t.size, np.int64)
    first, stop, new = 0, 0, 0
    least = np.inf
    for j in range(t.size):
        while new <= j and j + 1 - new > chatter:
            while stop - first >= 2:
                a, b = hull[stop - 2], hull[stop - 1]
                if (t[b] - t[a]) * (new - b) > (t[new] - t[b]) * (b - a):
                    break
                stop -= 1
            hull[stop] = new
            stop += 1
            new += 1
        if stop == first:
            continue
        while True:
            a = hull[first]
            slope = (t[j] - t[a]) / (j - a + 1 - chatter)
            if stop - first < 2:
                break
            b = hull[first + 1]
            if (t[j] - t[b]) / (j - b + 1 - chatter) > slope:
                break
            first += 1
        least = min(least, slope)
    return least


T = TypeVar("T")
ROUND_OFF = 1e-9  # of a dwell time, which a sum of times may miss


@runtime_checkable
class TimedModes(Protocol):
    """A signal as a constraint reads it: times and modes of its sojourns, see `SwitchingSignal`."""

    @property
    def times(self) -> Float[np.ndarray, " sojourn"]: ...

    @property
    def modes(self) -> Int[np.ndarray, " sojourn"]: ...

    @property
    def end(self) -> float: ...

    @property
    def initial_age(self) -> float: ...

    def require_modes(self, modes: int) -> Any:
        """Refuse modes beyond so many."""


@dataclass(frozen=True)
class SwitchingConstraint:
    """The limits that a `SignalClass` sets to the signals of so many modes (immutable).

    The class knows no number of modes, and says what somebody asked for; here every mode has its
    times and its successors, which is what is computed with and compared.

    Attributes
    ----------
    dwell_time, maximum_dwell : tuple of float, one per mode
        The shortest and the longest sojourn, seconds; 0 and inf for none.
    following : tuple of tuples of int, one per mode
        The modes that each may switch to, ascending.

    Examples
    --------
    >>> from deadtime.switching import SignalClass
    >>> ring = SignalClass(0.2, transitions=[[0, 1, 0], [0, 0, 1], [1, 0, 0]]).limits(3)
    >>> ring.following, ring.is_free
    (((1,), (2,), (0,)), False)
    """

    dwell_time: tuple[float, ...]
    maximum_dwell: tuple[float, ...]
    following: tuple[tuple[int, ...], ...]

    @property
    def modes(self) -> int:
        """Number of modes."""
        return len(self.following)

    @property
    def is_free(self) -> bool:
        """Whether every mode may follow every other one."""
        return all(len(after) == self.modes - 1 for after in self.following)

    @property
    def is_plain(self) -> bool:
        """Whether a dwell time that all modes share is all that limits them."""
        return (
            self.is_free and len(set(self.dwell_time)) == 1 and math.isinf(min(self.maximum_dwell))
        )

    @property
    def lasting(self) -> tuple[int, ...]:
        """The modes that may last without end; the one mode of a plant that has no other does."""
        if self.modes == 1:
            return (0,)
        return tuple(i for i, most in enumerate(self.maximum_dwell) if math.isinf(most))

    @property
    def transitions(self) -> Bool[np.ndarray, "mode mode"]:
        """Whether a signal may switch from mode i (row) to mode j (column)."""
        result = np.zeros((self.modes, self.modes), dtype=bool)
        for i, after in enumerate(self.following):
            result[i, list(after)] = True
        return result

    @cached_property
    def recurring(self) -> tuple[tuple[int, ...], ...]:
        """As `following`, but only switches from which a signal can come back."""
        reach = self.transitions
        for _ in range(self.modes.bit_length()):
            reach = reach | (reach.astype(int) @ reach.astype(int) > 0)
        return tuple(
            tuple(j for j in after if reach[j, i]) for i, after in enumerate(self.following)
        )

    def in_words(self, when: str = "at any time") -> tuple[str, str]:
        """A clause about its signals, to follow "that": how long they stay, and how they switch.

        Examples
        --------
        >>> from deadtime.switching import SignalClass
        >>> SignalClass(0.3).limits(2).in_words()
        ('stays in each mode for at least 0.3 s', 'switches at any time')
        >>> limits = SignalClass([0.3, 0.5], [0.9, math.inf], [[0, 1], [0, 0]]).limits(2)
        >>> limits.in_words()[0]
        'stays for 0.3 to 0.9 s in mode 0, at least 0.5 s in mode 1'
        >>> limits.in_words()[1]
        'switches at any time, but only so: from mode 0 to 1, from mode 1 never'
        """
        times = list(zip(self.dwell_time, self.maximum_dwell, strict=True))
        each = [
            f"at least {least:.4g} s" if math.isinf(most) else f"{least:.4g} to {most:.4g} s"
            for least, most in times
        ]
        stays = f"stays in each mode for {each[0]}"
        if len(set(times)) > 1:
            stays = "stays for " + ", ".join(f"{one} in mode {i}" for i, one in enumerate(each))
        if self.is_free:
            return stays, f"switches {when}"
        return stays, f"switches {when}, but only so: {self.ways_in_words}"

    @property
    def ways_in_words(self) -> str:
        """Which mode each may switch to."""
        return ", ".join(
            f"from mode {i} {'to ' + ' or '.join(map(str, after)) if after else 'never'}"
            for i, after in enumerate(self.following)
        )

    def require(self, signal: TimedModes, tolerance: float = ROUND_OFF) -> None:
        """Refuse a signal that is not admissible, by the first switch or sojourn that is not.

        Sojourns may be shorter and longer by the part `tolerance`, as a clock counts them.
        """
        signal.require_modes(self.modes)
        starts = signal.times.copy()
        starts[0] -= signal.initial_age
        ends = np.append(signal.times[1:], signal.end)
        for k, mode in enumerate(signal.modes.tolist()):
            lasts, last = float(ends[k] - starts[k]), k == signal.times.size - 1
            least, most = self.dwell_time[mode], self.maximum_dwell[mode]
            where = f"stays in mode {mode} from {starts[k]:g} s"
            if lasts > most * (1.0 + tolerance):
                until = f"to {ends[k]:g} s" if ends[k] < np.inf else "on without end"
                raise ArgumentError(
                    f"signal {where} {until}, longer than its maximum_dwell of {most:g} s: raise "
                    "maximum_dwell, or end the sojourn earlier."
                )
            if last:
                return
            if lasts < least * (1.0 - tolerance):
                raise ArgumentError(
                    f"signal {where} to {ends[k]:g} s, shorter than its dwell_time of {least:g} s: "
                    "lower dwell_time, or let the sojourn last."
                )
            after = int(signal.modes[k + 1])
            if after not in self.following[mode]:
                may = _may_follow(self.following[mode])
                raise ArgumentError(
                    f"signal switches from mode {mode} to mode {after} at {ends[k]:g} s, which "
                    f"transitions does not allow: from mode {mode} {may}."
                )


def time_or_each(name: str, value: object, unbounded: bool = False) -> float | tuple[float, ...]:
    """A positive time, or several; infinite where that has a meaning."""
    if not np.iterable(value) or isinstance(value, (str, bytes)):
        return _time(name, value, unbounded)
    given = list(value)  # pyright: ignore[reportCallIssue, reportArgumentType]
    return tuple(_time(f"{name}[{i}]", time, unbounded) for i, time in enumerate(given))


def _time(name: str, value: object, unbounded: bool) -> float:
    endless = unbounded and isinstance(value, (float, np.floating)) and value == np.inf
    return math.inf if endless else positive(name, value)


def switch_table(
    transitions: ArrayLike | tuple[tuple[bool, ...], ...],
) -> Bool[np.ndarray, "mode after"]:
    """A matrix of True and False, or of 1 and 0."""
    table = real_array("transitions", transitions, "(modes, modes)", 2)
    wrong = np.argwhere((table != 0) & (table != 1))
    if wrong.size:
        i, j = wrong[0].tolist()
        raise ArgumentError(
            f"transitions[{i}, {j}] must be True or False (1 or 0), got {float(table[i, j]):g}: of "
            "rates or probabilities give those that are above 0, as in rates > 0."
        )
    return table != 0


def require_ways(allowed: Bool[np.ndarray, "mode mode"], most: tuple[float, ...]) -> None:
    """Refuse modes that must be left and lead nowhere, and modes on their own."""
    for i in np.flatnonzero(~allowed.any(axis=1)).tolist():
        if most[i] < np.inf:
            raise ArgumentError(
                f"transitions[{i}] allows no switch, but maximum_dwell says that mode {i} is left "
                f"after {most[i]:g} s at most: allow a switch from it, or give it a maximum_dwell "
                "of inf."
            )
        if not allowed[:, i].any():
            raise ArgumentError(
                f"transitions allows no switch to mode {i} and none from it: allow one, or leave "
                "the mode out of the plant."
            )


def _may_follow(modes: tuple[int, ...]) -> str:
    """Which modes may follow, in words.

    Examples
    --------
    >>> _may_follow(()), _may_follow((2,)), _may_follow((0, 2))
    ('none may follow', 'only mode 2 may follow', 'only modes 0 and 2 may follow')
    """
    if not modes:
        return "none may follow"
    names = " and ".join(map(str, modes)) if len(modes) < 3 else ", ".join(map(str, modes))
    return f"only mode{'s' if len(modes) > 1 else ''} {names} may follow"


def one_or_each(values: tuple[T, ...]) -> T | tuple[T, ...]:
    """A time that all modes share as one number.

    Examples
    --------
    >>> one_or_each((0.2, 0.2)), one_or_each((0.2, 0.5))
    (0.2, (0.2, 0.5))
    """
    return values[0] if len(set(values)) == 1 else values
