"""What a search knows of a design: its margin, cost and growth, found fast."""

from __future__ import annotations

import math

from deadtime.feedback import Law
from deadtime.plant import SwitchedSystem, Weight
from deadtime.spectrum import LiftedLoop, aged_row
from deadtime.synthesis.margin_estimate import estimated_margin
from deadtime.synthesis.price import BLOCKS, cost_and_growth

_DENSE = 150  # order: up to there all eigenvalues of a loop are as fast as the largest
WIDEST = 9.0  # relative: beyond, margins are not told apart


def assess(
    plant: SwitchedSystem,
    law: Law,
    step: float,
    worst: bool,
    blocks: int = BLOCKS,
    exact: bool = False,
    weight: Weight | None = None,
) -> tuple[float, float, float]:
    """Estimated relative margin, cost, and growth of the fastest mode, 1/s.

    The growth is what the run of the cost shows, about, where it is not wanted exactly: of two
    poles that turn, or of a slow one behind fast ones, a run of finite length shows little.
    """
    from deadtime.switching import SwitchingSignal

    costs, margin, growth = [], math.inf, -math.inf
    for mode in range(plant.modes):
        table = law.digital(step, SwitchingSignal.constant(mode), 1)
        cost, grows = cost_and_growth(plant, table, mode, blocks, weight)
        if exact and math.isfinite(cost):
            row = aged_row(table, mode)
            grows = LiftedLoop.of(plant, table, mode, row).growth_rate(step, _DENSE)
        costs.append(cost)
        growth = max(growth, grows)
        if math.isinf(cost):
            margin = 0.0
        elif margin > 0.0:
            margin = min(margin, WIDEST, estimated_margin(plant, table, mode))
    return margin, max(costs) if worst else sum(costs) / len(costs), growth
