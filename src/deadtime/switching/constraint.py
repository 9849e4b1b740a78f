"""Limits of switching signals: the dwell times of each mode, and the allowed transitions.

A signal is admissible if every sojourn in mode i that ends in a switch lasts at least
`dwell_time[i]` and none lasts longer than `maximum_dwell[i]`, and if it switches from i to j only
where `transitions[i, j]` allows it. It may begin in any mode.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from jaxtyping import Bool
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
    """min (t_j − t_i)/(j + 1 − chatter − i) over i ≤ j with a positive denominator, else infinite.

    That is the average dwell time τ of a signal with N₀ = chatter and switches at t: from switch i
    to switch j there are j − i + 1 ≤ N₀ + (t_j − t_i)/τ of them. It is the least slope from a point
    (i, t_i) to a point (j + 1 − N₀, t_j), in one pass: the least slope to a point comes from the
    upper hull of the points to its left, and the first points of the hull, once steeper than the
    following ones, never attain the minimum again.

    References
    ----------
    K.-M. Chung and H.-I. Lu, "An optimal algorithm for the maximum-density segment problem", SIAM
    J. Comput. 34(2), 2004.
    """
    hull = np.empty(t.size, np.int64)
    first, stop, new = 0, 0, 0
    least = np.inf
    for j in range(t.size):
        # Points (i, t_i) with a positive denominator enter the hull, from the left.
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
        # Along the hull the slope to the point of j decreases and then increases.
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


@dataclass(frozen=True)
class SwitchingConstraint:
    """The limits of a `SignalClass` for a number of modes (immutable).

    A class may have one dwell time for all modes and no transitions; here every mode has its own
    times and successors, to compute with and to compare.

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
        """Whether there is no limit but a dwell time that all modes share."""
        return (
            self.is_free and len(set(self.dwell_time)) == 1 and math.isinf(min(self.maximum_dwell))
        )

    @property
    def lasting(self) -> tuple[int, ...]:
        """The modes with no longest dwell time; a single mode has none."""
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
        """`following` without the switches from which no signal returns."""
        reach = self.transitions
        # Squaring doubles the length of paths, so that modes.bit_length() rounds cover all.
        for _ in range(self.modes.bit_length()):
            reach = reach | (reach.astype(int) @ reach.astype(int) > 0)
        return tuple(
            tuple(j for j in after if reach[j, i]) for i, after in enumerate(self.following)
        )

    def in_words(self, when: str = "at any time") -> tuple[str, str]:
        """Two clauses about its signals, to follow "that": their sojourns, and their switches.

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
        """The allowed switches as text."""
        return ", ".join(
            f"from mode {i} {'to ' + ' or '.join(map(str, after)) if after else 'never'}"
            for i, after in enumerate(self.following)
        )


def time_or_each(name: str, value: object, unbounded: bool = False) -> float | tuple[float, ...]:
    """A positive time or a tuple of them, which may be infinite if `unbounded`."""
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
    """A matrix of True and False, also given as 1 and 0."""
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
    """Refuse modes that must be left without a successor, and modes without any switch."""
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


def one_or_each(values: tuple[T, ...]) -> T | tuple[T, ...]:
    """The common value of all modes, or the values if they differ.

    Examples
    --------
    >>> one_or_each((0.2, 0.2)), one_or_each((0.2, 0.5))
    (0.2, (0.2, 0.5))
    """
    return values[0] if len(set(values)) == 1 else values
