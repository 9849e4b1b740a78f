"""A bracket around the value at which a loop loses stability: few proofs, few searches.

Whether a constant mode grows is told in milliseconds, so bisection finds where that begins; a
proof is sought just below. Where a loop is lost to switching before, bisection with searches
for witnesses goes on from there. Proofs that fail are sought further down, in steps that
double, then by bisection. Stability need not be monotone in the value: constant modes are looked
at for a few values below the proved end too, and where one grows the bracket moves below it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from deadtime.base.errors import ArgumentError

FLOOR = 1e-6  # of the interval asked for: closer than this nothing is searched
CHECKS = 9  # values below the proved end at which constant modes are looked at
ROUNDS = 8  # how often the bracket may move below a witness found there


@dataclass(eq=False)
class Questions:
    """The questions about a value, and a log of the answers.

    Attributes
    ----------
    grows : callable
        From a value to whether some constant mode provably grows: the cheap question.
    certify : callable
        From a value to a certificate (`.stable`, `.message`, `.witness`).
    falsify : callable
        From a value to the worst case found (`.grows`).
    answers : dict
        From each value asked about to True, False or None.
    """

    grows: Callable[[float], bool]
    certify: Callable[[float], Any]
    falsify: Callable[[float], Any]
    answers: dict[float, bool | None] = field(default_factory=dict)

    def is_lost(self, value: float) -> bool:
        """Whether a constant mode grows."""
        grows = self.grows(value)
        self._note(value, False if grows else None)
        return grows

    def proof(self, value: float) -> Any:
        """The certificate at a value."""
        certificate = self.certify(value)
        self._note(value, certificate.stable)
        return certificate

    def witness(self, value: float) -> Any | None:
        """A worst case that provably grows, if one is found."""
        worst = self.falsify(value)
        found = worst if worst.grows else None
        self._note(value, None if found is None else False)
        return found

    def _note(self, value: float, stable: bool | None) -> None:
        known = self.answers.get(value)
        self.answers[value] = stable if known is None else known


@dataclass(frozen=True, eq=False)
class Bracket:
    """What the search found: `stability.StabilityMargin` says what the fields mean."""

    certified: float
    certificate: Any
    refuted: float | None = None
    witness: Any | None = None
    open: tuple[float, str] | None = None  # the lowest value without an answer, and why
    again: tuple[float, ...] = ()  # values above `refuted` that are proved stable


def bracket(ask: Questions, low: float, high: float, ratio: float) -> Bracket:
    """Search [low, high] until refuted / certified ≤ ratio, or until answers stay away.

    Raises
    ------
    ArgumentError
        If `low` is not certified.
    """
    start = ask.proof(low)
    if start.stable is not True:
        raise ArgumentError(
            f"low = {low:g} must be certified stable, and is not: {start.message} Begin closer "
            "to a loop that is known to be stable."
        )
    search = _BracketSearch(ask, low, start, ratio, FLOOR * (high - low))
    found = search.below(high)
    for _ in range(ROUNDS):
        lower = search.loss_below(found)
        if lower is None:
            break
        found = replace(search.down_to(lower), again=(*found.again, found.certified))
    if found.refuted is not None and found.witness is None:
        found = replace(found, witness=ask.witness(found.refuted))
    return found


@dataclass(frozen=True, eq=False)
class _BracketSearch:
    ask: Questions
    low: float
    start: Any
    ratio: float
    floor: float

    def width(self, value: float) -> float:
        """Half the gap that is good enough near a value: one half for each end."""
        return max(0.5 * (1.0 - 1.0 / self.ratio) * abs(value), self.floor)

    def below(self, high: float) -> Bracket:
        """The bracket when nothing is known about `high`."""
        if self.ask.is_lost(high):
            return self.down_to(high)
        witness = self.ask.witness(high)
        if witness is not None:
            return self.switching_bracket(high, witness)
        return self.proofs(high, self.ask.proof(high), None, None)

    def down_to(self, refuted: float) -> Bracket:
        """The bracket below a value at which a constant mode grows."""
        last, refuted, _ = self.bisect(refuted, None, lambda value: self.ask.is_lost(value) or None)
        if last == self.low:
            return Bracket(self.low, self.start, refuted)
        certificate = self.ask.proof(last)
        if certificate.stable is False:
            return self.switching_bracket(last, certificate.witness)
        return self.proofs(last, certificate, refuted, None)

    def switching_bracket(self, refuted: float, witness: Any) -> Bracket:
        """The bracket below a value at which some signal grows, though no constant one may."""
        last, refuted, witness = self.bisect(refuted, witness, self.ask.witness)
        if last == self.low:
            return Bracket(self.low, self.start, refuted, witness)
        return self.proofs(last, self.ask.proof(last), refuted, witness)

    def bisect(
        self, refuted: float, witness: Any, ask: Callable[[float], Any | None]
    ) -> tuple[float, float, Any]:
        """The last value without an answer and the first with one, close to each other."""
        last = self.low
        while refuted - last > self.width(refuted):
            middle = 0.5 * (last + refuted)
            found = ask(middle)
            if found is None:
                last = middle
            else:
                refuted, witness = middle, found
        return last, refuted, witness

    def proofs(
        self, value: float, certificate: Any, refuted: float | None, witness: Any
    ) -> Bracket:
        """Proofs from a value downwards, its own certificate known."""
        good, proof, bad, reason = self.low, self.start, None, ""
        gap = self.width(value)
        while True:
            if certificate.stable is True:
                good, proof = value, certificate
            elif certificate.stable is False:
                refuted, witness, bad = value, certificate.witness, None
            else:
                bad, reason = value, certificate.message
            ceiling = bad if bad is not None else refuted
            if ceiling is None or ceiling - good <= self.enough(ceiling, bad is not None):
                break
            if good > self.low or ceiling - gap <= self.low + self.floor:
                value = 0.5 * (good + ceiling)
            else:
                value, gap = ceiling - gap, 2.0 * gap
            certificate = self.ask.proof(value)
        return Bracket(good, proof, refuted, witness, None if bad is None else (bad, reason))

    def enough(self, ceiling: float, doubtful: bool) -> float:
        """The gap below a ceiling that ends the search: half of it where more lies above."""
        return (1.0 if doubtful else 2.0) * self.width(ceiling)

    def loss_below(self, found: Bracket) -> float | None:
        """The lowest of a few values below the proved end at which a constant mode grows."""
        if found.certified - self.low <= self.floor:
            return None
        values = np.linspace(self.low, found.certified, CHECKS + 2)[1:-1]
        return next((float(value) for value in values if self.ask.is_lost(float(value))), None)
