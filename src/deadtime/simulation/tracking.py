"""What a run is to follow, and its outputs beside it."""

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
from deadtime.plant.discretisation import TOLERANCE
from deadtime.simulation.step_figures import step_info

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
        if law.servo is None or law.reference is None:
            return None
        C = law.observer.C[:, :, : law.servo.base.states]
        return cls(law.servo.tracked @ C, law.reference)

    @property
    def is_same_in_modes(self) -> bool:
        """Whether the mode does not matter to what follows."""
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
        self,
        time: Float[np.ndarray, " T"],
        output: int = 0,
        since: float | None = None,
        until: float | None = None,
    ) -> tuple[slice, Float[np.ndarray, " W"]]:
        """The samples from a step of an output's reference, its last, to its next; and r there.

        The sample at the next step still answers to this one, and has its r; so does that at
        `until`, where it ends earlier.
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
        """∫|r − y| over all of the time, summed over the tracked outputs."""
        along = self.reference.along(time).T
        errors = [step_info(time, y[..., i, :], r)["IAE"] for i, r in enumerate(along)]
        return np.asarray(np.sum(errors, axis=0))


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
