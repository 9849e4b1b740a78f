"""The work of checking a certificate, counted before a matrix is built and during the check.

verifier/FORMAT.md defines the count, and both verifiers use it: a short file must not cause long
work.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from deadtime.certificates.proof.evidence import Setting

FREE, PER_NUMBER = 3 * 10**7, 10**5  # operations allowed to every file, and per number in it
HALVINGS = 100  # further factor for the bisection of cells
OVERHEAD = 12  # cost of a matrix besides its arithmetic, as additional rows


@dataclass
class Work:
    """A budget of operations, and the operations done."""

    most: float = math.inf
    done: int = 0

    def do(self, operations: int) -> None:
        """Count operations, before they are done."""
        self.done += operations
        if self.done > self.most:
            raise TooMuchWork


class TooMuchWork(Exception):
    """The budget is exhausted; `check` turns this into a result."""


def allowance(numbers: int) -> int:
    """The operations allowed to a certificate with this many numbers."""
    return FREE + PER_NUMBER * numbers


def cost(order: int) -> int:
    """Operations of a product of two matrices of an order."""
    return (order + OVERHEAD) ** 3


def operations(setting: Setting, knots: int, along: bool) -> int:
    """Operations of the inequalities if no cell is bisected; `along`: of stretches."""
    n, d = setting.states, setting.order
    k = n + len(setting.family.reads)
    cells, corners = _cells(setting)
    cell = corners * cost(d if along else k) + setting.plants.products * cost(n * k)
    return _steps(setting, knots, along) * (cost(d) + cells * cell)


def _cells(setting: Setting) -> tuple[int, int]:
    """Cells of a step, one per part of a period, and corners of each, both ends of a parameter."""
    delays = setting.delays
    if not setting.inputs:
        return 1, 2 * len(setting.plants.A)
    return 1 + len(np.unique(delays.ends)), len(setting.plants.A) << (1 + delays.moving)


def _steps(setting: Setting, knots: int, along: bool) -> int:
    """An upper bound of the number of steps of the graph, or of stretches, to check."""
    graph, total = setting.transitions, 0
    most = 4 + 2 * knots + setting.ages + setting.signals.lost_samples
    most += min(setting.signals.mode_lag, graph.modes * (setting.ages + 1))
    for clock, after in zip(graph.clocks, graph.following, strict=True):
        ages = 1 if along and graph.bucket is not None else clock.last + 1
        total += _reported(setting, ages if along else min(ages, 2 * most)) * (1 + len(after))
    return total


def _reported(setting: Setting, ages: int) -> int:
    """Number of triples of an age of a mode, a row that may act, and a count of lost samples."""
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
    """The least whole limit for a check with this estimated and this actual work."""
    return max(1, -(-asked // allowed), -(-done // (HALVINGS * allowed)))


def refusal(asked: int, allowed: int, limit: float) -> str:
    """The reason to refuse a certificate before any work."""
    return (
        f"its inequalities take {min(asked, 10**30):.2g} operations, and {limit * allowed:.2g} are "
        f"the limit for a file of its size: where that is worth the time, allow "
        f"{min(-(-asked // allowed), 10**30):,} times the usual (limit=, --limit)"
    )


def exhausted(allowed: int, limit: float) -> str:
    """The reason to give up a check that takes more than estimated."""
    return (
        f"it is not proved within {HALVINGS * limit * allowed:.2g} operations: where more are "
        f"worth the time, allow more than {limit:g} times the usual (limit=, --limit)"
    )
