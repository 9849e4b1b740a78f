"""References, the outputs that follow them, and figures of their steps.

The figures are those of python-control's `step_info`, and integrals of the error. For a step from
the output y₀ to r they use f = (y − y₀)/(r − y₀) at the samples, without interpolation, so that
times may be late by less than a period, as in python-control. Only the integral of the error takes
y as straight between samples; r is held.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import number
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.estimation.servo import Reference
from deadtime.feedback import Law
from deadtime.numerics.kernels import kernel
from deadtime.plant.discretisation import TOLERANCE

SETTLED, RISE = 0.02, (0.1, 0.9)  # of a step, as in python-control
_STEP = 1e-9  # of the output: a smaller change of the reference is no step

OF_STEPS = ("RiseTime", "SettlingTime", "Overshoot", "Undershoot")  # NaN without a step
TRACKING_ERROR = "∫|r − y|"  # over a whole run, of all tracked outputs together: the metric iae

# Figure: (unit, long name).
TRACKING = {
    "RiseTime": ("s", "time from 10 % to 90 % of a step of the reference, inf if never"),
    "SettlingTime": ("s", "time from which the output stays within 2 % of the step, inf if never"),
    "Overshoot": ("%", "how far the output goes past the reference, of the step"),
    "Undershoot": ("%", "how far the output goes the other way, of the step"),
    "Peak": ("y", "maximum of |y| after the step"),
    "PeakTime": ("s", "when that is, after the step"),
    "SteadyStateValue": ("y", "the output at the end"),
    "SteadyStateError": ("y", "reference minus output at the end"),
    "IAE": ("y s", "integral of |reference − output| after the step"),
}


def step_info(
    time: Float[np.ndarray, " T"],
    y: Float[np.ndarray, "*runs T"],
    r: Float[np.ndarray, " T"],
    settling: float = SETTLED,
    rise: tuple[float, float] = RISE,
) -> dict[str, Float[np.ndarray, "*runs"]]:
    """The figures of `TRACKING` for outputs that start at y₀ = y[…, 0], with the target r[−1].

    Those of `OF_STEPS` are NaN where y₀ is the target; times count from time[0].

    Examples
    --------
    >>> time = np.linspace(0.0, 10.0, 1001)
    >>> found = step_info(time, 1.0 - np.exp(-time), np.ones(1001))
    >>> round(found["RiseTime"].item(), 3), found["Overshoot"].item()      # log 9, in samples
    (2.2, 0.0)
    """
    shape, y = y.shape[:-1], y.reshape(-1, time.size)
    side_by_side = np.ascontiguousarray(y.T[None, :, None])
    found = step_info_of(side_by_side, 0, len(y), np.ones(1), time, r, settling, rise)
    return {name: value.reshape(shape) for name, value in found.items()}


def step_info_of(
    states: Float[np.ndarray, "group T n lane"],
    first: int,
    runs: int,
    row: Float[np.ndarray, " some"],
    time: Float[np.ndarray, " T"],
    r: Float[np.ndarray, " T"],
    settling: float = SETTLED,
    rise: tuple[float, float] = RISE,
) -> dict[str, Float[np.ndarray, " run"]]:
    """The figures of `step_info` for y = row · x from sample `first` on, in runs side by side.

    x lies at the begin of the n numbers of a sample; `row` has as many entries as x.
    """
    found, given = np.empty((len(TRACKING), runs)), map(np.array, (row, time, r))  # one type
    with np.errstate(all="ignore"):  # of runs that are lost
        fill_step_info(states, first, *given, *map(float, (settling, *rise)), found)
    return dict(zip(TRACKING, found, strict=True))


@kernel(nogil=True)
def fill_step_info(states, first, row, time, r, settling, low, high, found):
    """Fill the figures (figure, run), in the order of `TRACKING`, of y = row · x.

    states : (group, sample, n, lane), x and whatever else lies behind it, run by run in the last
        axis
    """
    T, lanes = time.size, states.shape[3]
    target = r[T - 1]
    for run in range(found.shape[1]):
        x, lane = states[run // lanes], run % lanes
        y = row[0] * x[first, 0, lane]
        for i in range(1, row.size):
            y += row[i] * x[first, i, lane]
        start = y
        size = target - start
        if not abs(size) > _STEP * max(abs(target), abs(start)):
            size = np.nan
        begin, end, outside, peak = -1, -1, -1, 0
        highest, lowest, magnitude, total = -np.inf, np.inf, -1.0, 0.0
        for k in range(T):
            if k > 0:
                error = r[k - 1] - y
                y = row[0] * x[first + k, 0, lane]
                for i in range(1, row.size):
                    y += row[i] * x[first + k, i, lane]
                # r steps at samples: up to this one the error is against the value before.
                behind = r[k - 1] - y
                a, b = abs(error), abs(behind)
                area = a + b
                # It crosses 0 in between: two triangles in place of a trapezium.
                if error * behind < 0.0:
                    area = (a * a + b * b) / area
                total += 0.5 * (time[k] - time[k - 1]) * area
            share = (y - start) / size
            if begin < 0 and share >= low:
                begin = k
            if end < 0 and share >= high:
                end = k
            if abs(share - 1.0) >= settling:
                outside = k
            # A NaN is kept.
            if share > highest or share != share:
                highest = share
            if share < lowest or share != share:
                lowest = share
            if (abs(y) > magnitude or y != y) and magnitude == magnitude:
                magnitude, peak = abs(y), k
        some = abs(size) < np.inf
        rise = time[end] - time[0] if end >= 0 else np.inf
        rise -= time[begin] - time[0] if begin >= 0 else 0.0
        settled = time[outside + 1] - time[0] if outside + 1 < T else np.inf
        over, under = 100.0 * (highest - 1.0), 100.0 * -lowest
        found[0, run] = rise if some else np.nan
        found[1, run] = settled if some else np.nan
        found[2, run] = (0.0 if over < 0.0 else over) if some else np.nan
        found[3, run] = (0.0 if under < 0.0 else under) if some else np.nan
        found[4, run], found[5, run] = magnitude, time[peak] - time[0]
        found[6, run], found[7, run], found[8, run] = y, target - y, total


@dataclass(frozen=True, eq=False)
class Followed(Frozen):
    """The tracked outputs H C_σ x, and the reference (immutable).

    Attributes
    ----------
    rows : (modes, tracked, n)
        H C_σ.
    reference : Reference
    """

    rows: Float[np.ndarray, "modes tracked n"]
    reference: Reference

    @classmethod
    def of(cls, law: Law) -> Followed | None:
        """The tracked outputs of a law, None without a servo."""
        if law.servo is None or law.reference is None:
            return None
        C = law.observer.C[:, :, : law.servo.base.states]
        return cls(law.servo.tracked @ C, law.reference)

    @property
    def is_same_in_modes(self) -> bool:
        """Whether the tracked outputs are the same in all modes."""
        return bool((self.rows == self.rows[0]).all())

    @property
    def states(self) -> list[int | None]:
        """The state that each output is, in every mode; None of one that is no state.

        Examples
        --------
        >>> rows = np.array([[[0.0, 1.0], [0.0, 2.0]]] * 2)
        >>> Followed(rows, Reference.of(0.0, 2)).states
        [1, None]
        """
        count = self.rows.shape[2]
        alone = [np.flatnonzero(row) for row in self.rows[0]]
        return [
            int(one[0]) if one.size == 1 and (of == np.eye(count)[one[0]]).all() else None
            for one, of in zip(alone, self.rows.swapaxes(0, 1), strict=True)
        ]

    def outputs(
        self, states: Float[np.ndarray, "n T"], mode: Int[np.ndarray, " T"]
    ) -> Float[np.ndarray, "tracked T"]:
        """H C_σ x along a run."""
        if self.is_same_in_modes:
            return self.rows[0] @ states
        return np.einsum("tri,it->rt", self.rows[mode], states)

    def changes(self, end: float, output: int = 0) -> list[float]:
        """Times of the steps of an output's reference before an end: 0, and its schedule's."""
        schedule, found = self.reference.schedule, [0.0]
        if schedule is None:
            return found
        times = schedule.times[1:][np.diff(schedule.values[:, output]) != 0.0]
        return found + times[(times > 0.0) & (times < end)].tolist()

    def steps_at(self, since: float, end: float, output: int = 0) -> bool:
        """Whether an output's reference may step at a time; a reference function always may."""
        if self.reference.schedule is None:
            return True
        slack = TOLERANCE * max(1.0, end)
        return any(abs(change - since) <= slack for change in self.changes(end, output))

    def window(
        self,
        time: Float[np.ndarray, " T"],
        output: int = 0,
        since: float | None = None,
        until: float | None = None,
    ) -> tuple[slice, Float[np.ndarray, " W"]]:
        """The samples from a step of an output's reference (None: its last) to the next; and r.

        The last sample, at the next step or at `until`, still belongs to this step and has its r.
        """
        changes = self.changes(float(time[-1]), output)
        begin = changes[-1] if since is None else since
        until = math.inf if until is None else number("until", until)
        if until <= begin:
            raise ArgumentError(f"until must be after the step, at {begin:g} s, got {until:g}.")
        slack = TOLERANCE * max(1.0, float(time[-1]))
        first, *stops = (
            int(np.searchsorted(time, t - slack))
            for t in (begin, *(t for t in (*changes, until) if begin < t < math.inf))
        )
        where = slice(first, min([stop + 1 for stop in stops], default=time.size))
        r = self.reference.along(time[where])[:, output]
        if stops and r.size > 1:
            r[-1] = r[-2]
        return where, r

    def absolute_error(
        self, time: Float[np.ndarray, " T"], y: Float[np.ndarray, "*runs tracked T"]
    ) -> Float[np.ndarray, "*runs"]:
        """∫|r − y| over the whole time, summed over the tracked outputs."""
        along = self.reference.along(time).T
        errors = [step_info(time, y[..., i, :], r)["IAE"] for i, r in enumerate(along)]
        return np.asarray(np.sum(errors, axis=0))


def measure_of(followed: Iterable[Followed | None]) -> str:
    """The metric that ranks runs: iae if all follow a reference, else the cost.

    At rest on a reference other than 0 the cost ∫|x|² + |u|² grows without end, under any law.

    Examples
    --------
    >>> measure_of([None, None])
    'cost'
    """
    each = list(followed)
    return "cost" if not each or any(one is None for one in each) else "iae"
