"""How well a run follows its reference: the figures of python-control's `step_info`, and errors.

Of a step of the reference from what the output is, y₀, to r they go by the share of the way,
f = (y − y₀)/(r − y₀), at the samples: nothing is interpolated, so that times may be late by less
than a period, as in python-control. The integral of the error alone takes y as straight between
samples, and r as held.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.frozen import Frozen
from deadtime.estimation import OutputFeedback
from deadtime.estimation.reference import Reference
from deadtime.feedback import Law
from deadtime.plant.steps import TOLERANCE

SETTLED, RISE = 0.02, (0.1, 0.9)  # of a step, as in python-control
_STEP = 1e-9  # of the output: what is less is no step

OF_STEPS = ("RiseTime", "SettlingTime", "Overshoot", "Undershoot")  # NaN where there is none

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
TRACKING_ERROR = "∫|r − y|"  # over a whole run, of all tracked outputs together: the metric iae


@dataclass(frozen=True, eq=False)
class Followed(Frozen):
    """What is to follow, H C_σ x, and the reference (immutable).

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
        """That of a law, where it tracks anything."""
        if not isinstance(law, OutputFeedback) or law.servo is None or law.reference is None:
            return None
        C = law.observer.C[:, :, : law.servo.base.states]
        return cls(law.servo.tracked @ C, law.reference)

    @property
    def is_same_in_modes(self) -> bool:
        """Whether the mode does not matter to what follows."""
        return bool((self.rows == self.rows[0]).all())

    def outputs(
        self, states: Float[np.ndarray, "n T"], mode: Int[np.ndarray, " T"]
    ) -> Float[np.ndarray, "tracked T"]:
        """H C_σ x along a run."""
        if self.is_same_in_modes:
            return self.rows[0] @ states
        return np.einsum("tri,it->rt", self.rows[mode], states)

    def changes(self, end: float, output: int = 0) -> list[float]:
        """When an output's reference steps before an end: at 0, and where its schedule changes."""
        schedule, found = self.reference.schedule, [0.0]
        if schedule is None:
            return found
        times = schedule.times[1:][np.diff(schedule.values[:, output]) != 0.0]
        return found + times[(times > 0.0) & (times < end)].tolist()

    def steps_at(self, since: float, end: float, output: int = 0) -> bool:
        """Whether an output's reference may step at a time; one that is a function always may."""
        if self.reference.schedule is None:
            return True
        slack = TOLERANCE * max(1.0, end)
        return any(abs(change - since) <= slack for change in self.changes(end, output))

    def window(
        self, time: Float[np.ndarray, " T"], output: int = 0, since: float | None = None
    ) -> tuple[slice, Float[np.ndarray, " W"]]:
        """The samples from a step of an output's reference, its last, to its next; and r there.

        The sample at the next step still answers to this one, and has its r.
        """
        changes = self.changes(float(time[-1]), output)
        begin = changes[-1] if since is None else since
        slack = TOLERANCE * max(1.0, float(time[-1]))
        first, *stops = (
            int(np.searchsorted(time, t - slack))
            for t in (begin, *(change for change in changes if change > begin))
        )
        where = slice(first, min([stop + 1 for stop in stops], default=time.size))
        r = self.reference.along(time[where])[:, output]
        if stops and r.size > 1:
            r[-1] = r[-2]
        return where, r

    def absolute_error(
        self, time: Float[np.ndarray, " T"], y: Float[np.ndarray, "*runs tracked T"]
    ) -> Float[np.ndarray, "*runs"]:
        """∫|r − y| over all of the time, summed over the tracked outputs."""
        r = self.reference.along(time[:-1]).T
        with np.errstate(all="ignore"):  # of runs that are lost
            return np.asarray(_absolute(time, r - y[..., :-1], r - y[..., 1:]).sum(axis=-1))


def measure_of(followed: Iterable[Followed | None]) -> str:
    """The metric that ranks runs, by what each follows: iae where all do, and else the cost.

    At rest on its reference a run goes on costing ∫|x|² + |u|², which says nothing of the law.

    Examples
    --------
    >>> measure_of([None, None])
    'cost'
    """
    each = list(followed)
    return "cost" if not each or any(one is None for one in each) else "iae"


def step_info(
    time: Float[np.ndarray, " T"],
    y: Float[np.ndarray, "*runs T"],
    r: Float[np.ndarray, " T"],
    settling: float = SETTLED,
    rise: tuple[float, float] = RISE,
) -> dict[str, Float[np.ndarray, "*runs"]]:
    """The figures of `TRACKING`, of outputs that start at y₀ = y[…, 0] and are to be at r[−1].

    NaN for those of a step that is none; times count from time[0].

    Examples
    --------
    >>> time = np.linspace(0.0, 10.0, 1001)
    >>> found = step_info(time, 1.0 - np.exp(-time), np.ones(1001))
    >>> round(found["RiseTime"].item(), 3), found["Overshoot"].item()      # log 9, in samples
    (2.2, 0.0)
    """
    start, target, after = y[..., 0], r[-1], time - time[0]
    with np.errstate(all="ignore"):  # of runs that are lost
        size = target - start
        size = np.where(np.abs(size) > _STEP * np.maximum(abs(target), np.abs(start)), size, np.nan)
        share = (y - start[..., None]) / size[..., None]
        begin, end = (_first(share >= part, after) for part in rise)
        outside = np.abs(share - 1.0) >= settling
        last = time.size - np.argmax(outside[..., ::-1], axis=-1)
        last = np.where(outside.any(axis=-1), last, 0)
        settled = np.append(after, np.inf)[last]
        magnitude = np.abs(y)
        peak = magnitude.argmax(axis=-1)
        some = np.isfinite(size)
        found = {
            "RiseTime": np.where(some, end - np.where(np.isfinite(begin), begin, 0.0), np.nan),
            "SettlingTime": np.where(some, settled, np.nan),
            "Overshoot": np.where(some, 100.0 * np.maximum(share.max(axis=-1) - 1.0, 0.0), np.nan),
            "Undershoot": np.where(some, 100.0 * np.maximum(-share.min(axis=-1), 0.0), np.nan),
            "Peak": magnitude.max(axis=-1),
            "PeakTime": after[peak],
            "SteadyStateValue": y[..., -1],
            "SteadyStateError": target - y[..., -1],
            "IAE": _absolute(time, r[:-1] - y[..., :-1], r[:-1] - y[..., 1:]),
        }
    return {name: np.asarray(value) for name, value in found.items()}


def _first(there: np.ndarray, time: np.ndarray) -> np.ndarray:
    """The first time at which something is so, ∞ if never."""
    return np.where(there.any(axis=-1), time[np.argmax(there, axis=-1)], np.inf)


def _absolute(time: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """∫|e| of errors that are straight from `before` to `after` in every interval."""
    a, b = np.abs(before), np.abs(after)
    total = a + b
    crossed = np.divide(a * a + b * b, total, out=np.zeros(total.shape), where=total > 0.0)
    area = 0.5 * np.diff(time) * np.where(before * after < 0.0, crossed, total)
    return np.asarray(area.sum(axis=-1))
