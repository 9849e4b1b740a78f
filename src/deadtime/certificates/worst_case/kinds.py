"""The kinds of sojourn on the grid: of which mode, and whether the law saw the switch in time.

A switch that falls on its sample is seen at it. One that falls just after its sample is seen a
period late: at that sample the law still acts for the mode before. Every switch of a cycle may do
either. A sojourn is cut from sample to sample, so a late one has, at its first sample, the row
of the mode before, which is taken to have lasted for the shortest sojourn (exact where rows do not
depend on the age by then; what is found is evaluated on the loop itself).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from deadtime.feedback import Feedback


@dataclass(frozen=True, eq=False)
class Kinds:
    """What sojourns there are (immutable).

    Attributes
    ----------
    mode : (kinds,)
        The mode.
    before : (kinds,)
        The mode before where the switch is seen late, else −1.
    follows : (kinds, kinds)
        Whether the second may follow the first.
    """

    mode: Int[np.ndarray, " kind"]
    before: Int[np.ndarray, " kind"]
    follows: Bool[np.ndarray, "kind kind"]

    @classmethod
    def of(cls, feedback: Feedback, modes: int, mixed: bool) -> Kinds:
        """For a law's table; `mixed` where late switches and others may alternate."""
        pairs = [(i, -1) for i in range(modes)]
        if feedback.context != "none":
            pairs += [(i, p) for i in range(modes) for p in range(modes) if p != i]
        mode, before = np.array(pairs).T
        follows = mode[:, None] != mode
        follows &= (before == -1) | (before == mode[:, None])
        if not mixed:
            follows &= (before[:, None] == -1) == (before == -1)
        return cls(mode, before, follows)

    @property
    def late(self) -> Bool[np.ndarray, " kind"]:
        """Whether the switch is seen late."""
        return self.before >= 0
