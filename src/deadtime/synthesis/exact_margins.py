"""The last word on what a search found: exact margins, the choice, and the trade-off."""

from __future__ import annotations

import numpy as np

from deadtime.margins.delay import DelayMargin, constant_delay_margin
from deadtime.plant import SwitchedSystem
from deadtime.synthesis.design_search import DesignSearch, Tried
from deadtime.synthesis.input_peak import largest_inputs
from deadtime.synthesis.result import TradeOff

_CHECKED = 10  # designs looked at exactly for the one that comes nearest
_ERRS = 3e-3  # of a shortfall: what its estimate may err by
_NEAR = 0.01  # of a shortfall: so much farther is as near
_POINTS = 10  # of the trade-off
_WIDE = 2.0  # relative: margins beyond are not told apart in the trade-off


class Exact:
    """Exact margins of what a search tried, each computed once."""

    def __init__(self, plant: SwitchedSystem, search: DesignSearch) -> None:
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

    def shortfall(self, tried: Tried) -> float:
        """By how much it falls short of what is asked, 0 where it does not."""
        found = self.relative(tried), self.decay_rate(tried)
        return self.search.floors.shortfall(*found, load=tried.load)

    def choose(self) -> Tried | None:
        """The cheapest that meets the request; else the one nearest to it.

        Of those as near as the nearest, about, the cheapest.
        """
        stable = self.search.stable
        short = {one: self.search.shortfall(one) for one in stable}
        for one in sorted(stable, key=_price):
            if short[one] <= _ERRS and self.shortfall(one) == 0.0:
                return one
        few = [*sorted(stable, key=short.__getitem__)[:_CHECKED], *self._front()]
        far = {one: self.shortfall(one) for one in few if self.relative(one) > 0.0}
        least = min(far.values(), default=0.0)
        near = [one for one in far if far[one] <= least + _NEAR]
        return min(near, key=_price, default=None)

    def trade_off(self, chosen: TradeOff | None) -> tuple[TradeOff, ...]:
        """Designs of which none is both wider and cheaper, few enough to draw; and the chosen.

        Of those with the decay rate that is asked for, and inputs within their limits, where there
        are any.
        """
        points = [self._point(one) for one in self._front()]
        if chosen is not None:
            points = [chosen, *(point for point in points if point.law is not chosen.law)]
        floors = self.search.floors
        fast = [
            point
            for point in points
            if point.decay_rate >= floors.decay_rate and floors.load(point.input_peak) <= 1.0
        ] or points
        kept, widest = [], 0.0
        for point in sorted(points, key=lambda point: (point.cost, -point.margin)):
            wider = point in fast and point.margin > widest
            if wider or point is chosen:
                kept.append(point)
            if wider:
                widest = point.margin
        return tuple(sorted(kept, key=lambda point: point.margin))

    def _point(self, one: Tried) -> TradeOff:
        peak = largest_inputs(self.plant, one.law, one.step, self.search.floors.initial)
        return TradeOff(one.law, one.step, self.relative(one), one.cost, self.decay_rate(one), peak)

    def _front(self) -> list[Tried]:
        """Of the front by estimated margins, a few with margins evenly apart."""
        floor = self.search.floors.decay_rate
        stable = sorted(self.search.stable, key=_price)
        kept = [one for one in stable if (-one.growth >= floor or not floor) and one.load <= 1.0]
        best: list[Tried] = []
        for one in kept or stable:
            if not best or one.margin > best[-1].margin:
                best.append(one)
        if not best:
            return []
        margins = np.array([one.margin for one in best])
        wanted = np.linspace(margins[0], min(margins[-1], max(_WIDE, 2.0 * margins[0])), _POINTS)
        at = np.searchsorted(margins, wanted - 1e-12)
        return [best[i] for i in sorted({int(i) for i in at})]


def _price(one: Tried) -> float:
    """The cost to six digits: of equals the one tried first, such as the plain one."""
    return float(f"{one.cost:.6g}")
