"""The last word on what a search found: exact margins, the choice, and the trade-off."""

from __future__ import annotations

import numpy as np

from deadtime.design.result import TradeOff
from deadtime.design.search import Search, Tried
from deadtime.plant import SwitchedSystem
from deadtime.spectrum.margin import DelayMargin, constant_delay_margin

_CHECKED = 10  # exact margins computed in search of one that reaches
_POINTS = 10  # of the trade-off
_WIDE = 2.0  # relative: margins beyond are not told apart in the trade-off


class Exact:
    """Exact margins of what a search tried, each computed once."""

    def __init__(self, plant: SwitchedSystem, search: Search) -> None:
        self.plant = plant
        self.search = search
        self.known: dict[int, DelayMargin] = {}

    def margin(self, tried: Tried) -> DelayMargin:
        """As by `constant_delay_margin`."""
        key = id(tried)
        if key not in self.known:
            self.known[key] = constant_delay_margin(self.plant, tried.law, tried.step)
        return self.known[key]

    def relative(self, tried: Tried) -> float:
        """0 where a mode is unstable."""
        return self.margin(tried).relative or 0.0

    def decay_rate(self, tried: Tried) -> float:
        """Of the slowest constant mode, 1/s."""
        return -float(self.margin(tried).growth.max())

    def decays(self, tried: Tried) -> bool:
        """Whether it does as fast as is asked."""
        return self.decay_rate(tried) >= self.search.slowest

    def choose(self, asked: float) -> Tried | None:
        """The cheapest with the margin and the decay asked for; else the widest that is left.

        Of those with the decay, where there are any, the one with the largest margin.
        """
        stable = self.search.stable
        able = sorted((one for one in stable if one.margin >= asked), key=lambda one: one.cost)
        for one in able[:: max(1, len(able) // 200)][:_CHECKED]:
            if self.relative(one) >= asked and self.decays(one):
                return one
        widest = sorted(stable, key=lambda one: -one.margin)[:_CHECKED]
        few = [*widest, *self._front()]
        best = max(few, key=lambda one: (self.decays(one), self.relative(one)), default=None)
        return best if best is not None and self.relative(best) > 0.0 else None

    def trade_off(self, chosen: Tried | None) -> tuple[TradeOff, ...]:
        """Designs of which none is both wider and cheaper, few enough to draw."""
        few = self._front() if chosen is None else [*self._front(), chosen]
        kept: list[TradeOff] = []
        for one in sorted(few, key=lambda one: (one.cost, -self.relative(one))):
            margin = self.relative(one)
            if margin > 0.0 and (not kept or margin > kept[-1].margin):
                kept.append(TradeOff(one.law, one.step, margin, one.cost, self.decay_rate(one)))
        return tuple(kept)

    def _front(self) -> list[Tried]:
        """Of the front by estimated margins, a few with margins evenly apart."""
        best: list[Tried] = []
        for one in sorted(self.search.stable, key=lambda one: one.cost):
            if not best or one.margin > best[-1].margin:
                best.append(one)
        if not best:
            return []
        margins = np.array([one.margin for one in best])
        wanted = np.linspace(margins[0], min(margins[-1], max(_WIDE, 2.0 * margins[0])), _POINTS)
        at = np.searchsorted(margins, wanted - 1e-12)
        return [best[i] for i in sorted({int(i) for i in at})]
