"""The kinds of sojourn on the grid: of which mode, and whether the law saw the switch in time.

A switch that falls on its sample is seen at it. One that falls just after its sample is seen a
period late: at that sample the law still acts for the mode before. Every switch of a cycle may do
either. A sojourn is cut from sample to sample, so a late one has, at its first sample, the row
of the mode before, which is taken to have lasted for the shortest sojourn (exact where rows do not
depend on the age by then; what is found is evaluated on the loop itself).

A law that is told the mode L samples late acts for the mode before at the first L samples of every
sojourn, and at one more of a late one. For a lag longer than sojourns last that is a guess; it
ranks cycles, and is not trusted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from deadtime.certificates.worst_case.admissible import Admissible
from deadtime.feedback import Feedback


@dataclass(frozen=True, eq=False)
class Kinds:
    """What sojourns there are (immutable).

    Attributes
    ----------
    mode : (kinds,)
        The mode.
    before : (kinds,)
        The mode before where the law acts for it at first, else −1.
    wait : (kinds,)
        At how many samples it does.
    late : (kinds,)
        Whether the switch falls just after its sample.
    follows : (kinds, kinds)
        Whether the second may follow the first.
    """

    mode: Int[np.ndarray, " kind"]
    before: Int[np.ndarray, " kind"]
    wait: Int[np.ndarray, " kind"]
    late: Bool[np.ndarray, " kind"]
    follows: Bool[np.ndarray, "kind kind"]

    @classmethod
    def of(cls, feedback: Feedback, signals: Admissible, lag: int = 0) -> Kinds:
        """For a law's table and the cycles that are admissible."""
        mixed, recurring = signals.late[1], signals.recurring
        each = [(i, p) for i in recurring for p in recurring if i in signals.following[p]]
        found = [(i, -1, 0, 0) for i in recurring]
        if feedback.context != "none" and lag:
            found = [(i, p, lag, 0) for i, p in each]
        if feedback.context != "none" and not signals.at_samples:
            found += [(i, p, lag + 1, 1) for i, p in each]
        mode, before, wait, late = np.array(found).T
        allowed = np.zeros((signals.modes, signals.modes), dtype=bool)
        for i in recurring:
            allowed[i, list(signals.following[i])] = True
        follows = allowed[mode[:, None], mode]
        follows &= (before == -1) | (before == mode[:, None])
        if not mixed:
            follows &= late[:, None] == late
        return cls(mode, before, wait, late > 0, follows)
