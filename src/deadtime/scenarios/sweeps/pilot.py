"""How long cells take on this machine: some of them run, on a few signals, and scaled up."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from deadtime.scenarios.sweeps.cell import run_cell
from deadtime.scenarios.sweeps.study import Cell, Study

_FEWEST, _MOST = 12, 64  # cells to time
_ENOUGH, _AT_MOST = 2.0, 10.0  # seconds of runs after which the fewest, or fewer, will do
_FIRST, _MORE = 32, 8  # signals of a first run, and times as many in the next one
_SEEN, _SHARE = 0.1, 0.3  # seconds by which a longer run must differ, and share of the first one's


class Timed(NamedTuple):
    """The time that cells were found to take.

    seconds : of one core of this machine, for all that were asked about
    cells : how many of them were run
    """

    seconds: float
    cells: int


def time_cells(
    study: Study, costs: Float[np.ndarray, ...], missing: Bool[np.ndarray, ...]
) -> Timed:
    """How long the missing cells take, from runs of some of them.

    Cells are drawn with probabilities in proportion to `costs`, one from each of `_MOST` equal
    shares of their sum. The mean of seconds over cost, times that sum, is then without bias
    whatever the costs are, and varies the less the better they are.
    """
    places, rng = np.argwhere(missing), np.random.default_rng(0)
    if not missing.any():
        return Timed(0.0, 0)
    said = costs[missing]
    shares = (rng.permutation(_MOST) + rng.random(_MOST)) / _MOST
    drawn = np.searchsorted(np.cumsum(said), shares * said.sum()).clip(max=said.size - 1)
    found, ratios, spent = dict[int, float](), list[float](), 0.0
    for cell in drawn.tolist():
        if cell not in found:
            if spent > (_ENOUGH if len(found) >= _FEWEST else _AT_MOST):
                break
            found[cell], runs = _seconds(study, study.cell(tuple(places[cell].tolist())))
            spent += runs
        ratios.append(found[cell] / float(said[cell]))
    return Timed(float(np.mean(ratios) * said.sum()), len(found))


def _seconds(study: Study, cell: Cell) -> tuple[float, float]:
    """Seconds of a cell, from runs on ever more signals, and seconds of these runs.

    The time of this process counts, so that others on the machine do not. A run before compiles.
    """

    def run(signals: int) -> float:
        began = time.process_time()
        run_cell(replace(study, scenarios=signals), cell)
        return time.process_time() - began

    whole = study.scenarios
    signals = first = whole if whole <= 4 * _FIRST else _FIRST
    run(first)
    least = took = spent = run(first)
    while signals < whole and took - least < max(_SEEN, _SHARE * least):
        signals = min(_MORE * signals, whole)
        took = run(signals)
        spent += took
    if signals == whole:
        return took, spent
    return took + (took - least) / (signals - first) * (whole - signals), spent
