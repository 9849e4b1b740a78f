"""The check: whether evidence proves its claim, in balls and by one large factorisation.

The check uses the numbers of the evidence and nothing else. There are two kinds of evidence:
`evidence` has the inequalities of the first, `split_inequalities` verifies them, and `stretches`
has those of the second.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from deadtime.base.wording import number_of
from deadtime.certificates.proof.evidence import Channels, Evidence
from deadtime.certificates.proof.split_inequalities import SplitInequalities
from deadtime.certificates.proof.stretches import StretchEvidence, StretchInequalities
from deadtime.certificates.proof.transitions import Transition
from deadtime.certificates.proof.validate import why_malformed
from deadtime.certificates.proof.work import (
    HALVINGS,
    TooMuchWork,
    Work,
    allowance,
    exhausted,
    least_limit,
    operations,
    refusal,
)
from deadtime.numerics.precision import precision

T = TypeVar("T")


@dataclass(frozen=True)
class Check:
    """The result of a check.

    Attributes
    ----------
    proven : bool
        Whether every inequality holds beyond doubt.
    reason : str
        Why not, naming the inequality; empty if proven.
    cells : int
        How many cells of steps were enclosed.
    failed : tuple or None
        (transition, u) of the step where a small inequality fails, u the instant of its switch
        as a fraction of the period.
    limit : int
        The least limit with which the proof succeeds.
    """

    proven: bool
    reason: str = ""
    cells: int = 0
    failed: tuple[Transition, float] | None = None
    limit: int = 1


def check(evidence: Evidence | StretchEvidence, limit: float = math.inf) -> Check:
    """Verify the evidence; False means that this evidence is no proof, not that none exists.

    `limit` is a multiple of the work that `work` allows for evidence of this size.
    """
    # Before any arithmetic: the estimate of the work relies on sound sizes, too.
    reason = why_malformed(evidence)
    if reason:
        return Check(False, reason)
    along = isinstance(evidence, StretchEvidence)
    allowed = allowance(evidence.numbers)
    asked = operations(evidence.setting, len(evidence.knots), along)
    if asked > limit * allowed:
        return Check(False, refusal(asked, allowed, limit))
    # Only now are matrices built: a short file must not cost more than the estimate above.
    work = Work(HALVINGS * limit * allowed)
    try:
        with precision():
            found = _check_stretches(evidence, work) if along else _check_split(evidence, work)
    except TooMuchWork:
        return Check(False, exhausted(allowed, limit))
    return replace(found, limit=least_limit(asked, work.done, allowed))


def _check_split(evidence: Evidence, work: Work) -> Check:
    channels = Channels.of(evidence.setting, evidence.centre)
    inequalities, count = SplitInequalities(evidence, channels, work), 0
    # The small inequalities first: they are cheap, they name the step that fails, and `large` needs
    # the forms that they leave in `inequalities.forms`.
    for transition in _spread(evidence.setting.transitions.all(evidence.knots)):
        cells, instant = inequalities.holds(transition)
        count += cells
        if instant is not None:
            return Check(False, _fails(transition), count, (transition, instant))
    if not inequalities.positive():
        return Check(False, "the Lyapunov function is not positive", count)
    if not inequalities.large():
        return Check(False, "the inequality K ≻ 0 fails", count)
    return Check(True, "", count)


def _check_stretches(evidence: StretchEvidence, work: Work) -> Check:
    inequalities, count = StretchInequalities(evidence, work), 0
    if not inequalities.positive():
        return Check(False, "the Lyapunov function is not positive", count)
    for stretch in _spread(evidence.setting.transitions.stretches(evidence.knots)):
        cells, instant = inequalities.holds(stretch)
        count += cells
        if instant is not None:
            return Check(False, _fails(stretch.step), count, (stretch.step, instant))
    return Check(True, "", count)


def _spread(items: Sequence[T]) -> Iterator[T]:
    """Every item once, distant ones first.

    Neighbours fail together, so a file that claims too long a sojourn is refused after a few steps.
    """
    yield from items[:1]
    stride = 1 << len(items).bit_length()
    while stride > 1:
        stride //= 2
        yield from items[stride :: 2 * stride]


def _fails(step: Transition) -> str:
    to = f" to mode {step.after}" if step.switches else ""
    lost = f" after {number_of(step.lost, 'lost sample')}" if step.lost else ""
    if step.next_lost:
        to += " without a sample"
    return f"the inequality of the step from mode {step.mode} at age {step.age}{lost}{to} fails"
