"""The check: whether evidence proves what it claims, in balls and one large factorisation.

Nothing is taken from whoever made the evidence but its numbers. `evidence` has the inequalities,
`small` and `large` how each of the two kinds is verified.
"""

from __future__ import annotations

from dataclasses import dataclass

from deadtime.certificates.proof import balls
from deadtime.certificates.proof.channels import Channels
from deadtime.certificates.proof.evidence import Evidence
from deadtime.certificates.proof.large import LargeInequalities
from deadtime.certificates.proof.small import SmallInequalities
from deadtime.certificates.proof.transitions import Transition
from deadtime.certificates.proof.validate import malformed


@dataclass(frozen=True)
class Check:
    """What came of a check.

    Attributes
    ----------
    proven : bool
        Whether every inequality holds beyond doubt.
    reason : str
        Why not, naming the inequality; empty if proven.
    cells : int
        How many pieces of steps were enclosed.
    failed : tuple or None
        (transition, u) of the step where a small inequality fails, u the instant of its switch
        as a fraction of the period.
    """

    proven: bool
    reason: str = ""
    cells: int = 0
    failed: tuple[Transition, float] | None = None


def check(evidence: Evidence) -> Check:
    """Verify the evidence; False means that this evidence is no proof, not that none exists."""
    reason = malformed(evidence)
    if reason:
        return Check(False, reason)
    with balls.precision():
        channels = Channels.of(evidence.setting, evidence.centre)
        small, count = SmallInequalities(evidence, channels), 0
        for transition in evidence.setting.transitions.all(evidence.knots):
            cells, instant = small.holds(transition)
            count += cells
            if instant is not None:
                at = f"mode {transition.mode} at age {transition.age}"
                to = f" to mode {transition.after}" if transition.switches else ""
                reason = f"the inequality of the step from {at}{to} fails"
                return Check(False, reason, count, (transition, instant))
        large = LargeInequalities(evidence, channels, small)
        if not large.positive():
            return Check(False, "the Lyapunov function is not positive", count)
        if not large.large():
            return Check(False, "the inequality K ≻ 0 fails", count)
    return Check(True, "", count)
