"""How much work a certificate asks for, counted before a matrix is built, and while it is done.

verifier/FORMAT.md states the count, which both verifiers make: a short file must not ask for long
work.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from deadtime.certificates.proof.evidence import Setting

FREE, PER_NUMBER = 3 * 10**7, 10**5  # operations: of every file, and for each number that it holds
HALVINGS = 100  # how many times as many the halving of cells may take
OVERHEAD = 12  # what a matrix costs besides its arithmetic, in rows


@dataclass
class Work:
    """How many operations may be done, and how many were."""

    most: float = math.inf
    done: int = 0

    def do(self, operations: int) -> None:
        """Count some, before they are done."""
        self.done += operations
        if self.done > self.most:
            raise TooMuchWork


class TooMuchWork(Exception):
    """More work is asked for than is allowed; `check` makes an answer of it."""


def allowance(numbers: int) -> int:
    """How many operations a certificate of so many numbers may ask for."""
    return FREE + PER_NUMBER * numbers


def cost(order: int) -> int:
    """Of a product of two matrices of an order."""
    return (order + OVERHEAD) ** 3


def operations(setting: Setting, knots: int, along: bool) -> int:
    """How many the inequalities take if no cell has to be halved; `along` stretches."""
    n, d = setting.states, setting.order
    k = n + len(setting.family.reads)
    cells, corners = _cells(setting)
    cell = corners * cost(d if along else k) + setting.plants.products * cost(n * k)
    return _steps(setting, knots, along) * (cost(d) + cells * cell)


def _cells(setting: Setting) -> tuple[int, int]:
    """Cells of a step, the parts of a period; and corners of each, both ends of all that varies."""
    ends, moving = np.array(setting.delays), 0
    if not setting.inputs:
        return 1, 2 * len(setting.plants.A)
    if isinstance(setting.delays, tuple):
        moving = int(ends[0] < ends[1])
    elif ends.ndim == 3:
        moving = sum(sorted((ends[0] < ends[1]).sum(axis=1).tolist())[-2:])
    return 1 + len(np.unique(ends)), len(setting.plants.A) << (1 + moving)


def _steps(setting: Setting, knots: int, along: bool) -> int:
    """Steps of the graph, or stretches, that are asked about, or a few more."""
    graph, total = setting.transitions, 0
    most = 4 + 2 * knots + setting.ages + setting.signals.lost_samples
    most += min(setting.signals.mode_lag, graph.modes * (setting.ages + 1))
    for clock, after in zip(graph.clocks, graph.following, strict=True):
        ages = 1 if along and graph.bucket is not None else clock.last + 1
        total += _reported(setting, ages if along else min(ages, 2 * most)) * (1 + len(after))
    return total


def _reported(setting: Setting, ages: int) -> int:
    """Rows that may act at so many ages of a mode, with what was lost before and is lost next."""
    graph, lag, lost = setting.transitions, setting.signals.mode_lag, setting.signals.lost_samples
    free, rows, own = graph.bucket is not None, graph.measured, 1
    if setting.context == "mode_age" and (free or lost):
        own = setting.ages if free or lost > graph.first else min(setting.ages, lost + 1)
    if lag:
        return ages * rows if free else ages + min(ages, lag) * (rows - 1)
    if free:
        return ages * ((lost + 1) * own + lost * rows)
    return ages * (2 * lost + 1) * own + lost * lost * rows


def least_limit(asked: int, done: int, allowed: int) -> int:
    """How many times what is allowed a check takes that asked for some work and did some."""
    return max(1, -(-asked // allowed), -(-done // (HALVINGS * allowed)))


def refusal(asked: int, allowed: int, limit: float) -> str:
    """Why a certificate that asks for more operations than it may is not looked at."""
    return (
        f"its inequalities take {min(asked, 10**30):.2g} operations, and {limit * allowed:.2g} are "
        f"the limit for a file of its size: where that is worth the time, allow "
        f"{min(-(-asked // allowed), 10**30):,} times the usual (limit=, --limit)"
    )


def exhausted(allowed: int, limit: float) -> str:
    """Why one is given up that takes more than it seemed to."""
    return (
        f"it is not proved within {HALVINGS * limit * allowed:.2g} operations: where more are "
        f"worth the time, allow more than {limit:g} times the usual (limit=, --limit)"
    )
