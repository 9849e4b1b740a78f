"""The plan of a sweep: its cells, those that are done, and the time that the others take.

No result is computed; some cells run on a few signals, and their times are scaled up.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from os import PathLike
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from deadtime.scenarios.sweeps.blocks import costs_of, layout_of
from deadtime.scenarios.sweeps.cell import run_cell
from deadtime.scenarios.sweeps.store import exists, open_store, place_of
from deadtime.scenarios.sweeps.study import Cell, Study

_FEWEST, _MOST = 12, 64  # cells to time
_ENOUGH, _AT_MOST = 2.0, 10.0  # seconds of runs after which `_FEWEST` cells, or fewer, suffice
_FIRST, _MORE = 32, 8  # signals of a first run, and the factor to the next
_SEEN, _SHARE = 0.1, 0.3  # difference to the first run that suffices: seconds, and share of it
_FLAGS = 3  # objects of a block beside one per metric: diverged, reason, done


class Timed(NamedTuple):
    """Measured time of cells.

    seconds : of one core of this machine, for all missing cells
    cells : how many of them were run
    """

    seconds: float
    cells: int


def time_cells(
    study: Study, costs: Float[np.ndarray, ...], missing: Bool[np.ndarray, ...]
) -> Timed:
    """The time of the missing cells, estimated from runs of some of them.

    Cells are drawn with probabilities in proportion to `costs`, one from each of `_MOST` equal
    shares of their sum (importance sampling, stratified). The mean of seconds over cost, times that
    sum, is without bias for any costs, and varies less the better the costs are.
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
    """Seconds of a cell, from runs on more and more signals, and seconds of these runs.

    Processor time, so that other processes do not count. A first run compiles and is not counted.
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


@dataclass(frozen=True)
class Plan:
    """The size of a sweep.

    Attributes
    ----------
    store : str
        Where it is, or would be.
    exists : bool
        Whether it is there.
    cells, done : int
        Of the grid, and how many of them are whole.
    blocks, missing : int
        Pieces of work, and how many of them are not whole.
    runs : int
        Of one law on one signal, in the cells that are missing.
    seconds : float
        That the missing cells take one core, estimated; without a trial the machine of
        benchmarks/README.md, from a table of costs.
    timed : int
        Cells that were run on a few signals to estimate it.
    size : int
        Bytes of the whole store before compression.
    objects : int
        Files or objects of the whole store, at most.
    """

    store: str
    exists: bool
    cells: int
    done: int
    blocks: int
    missing: int
    runs: int
    seconds: float
    timed: int
    size: int
    objects: int


def plan_of(study: Study, store: str | PathLike[str], *, trial: bool = False) -> Plan:
    """The plan of `sweep`: its cells, and which of them the store holds already.

    Parameters
    ----------
    study : Study
    store : path
        As `sweep` takes them.
    trial : bool
        Run some of the missing cells on a few signals, for some seconds, to say how long all of
        them take one core of this machine. What has to be compiled is compiled then, and does not
        count.

    Raises
    ------
    ArgumentError
        If the store holds another study.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> def loop(horizon):
    ...     laws, model = [problem.laws["averaged"]], dt.Markov([[0, 2], [2, 0]])
    ...     return dict(plant=problem.plant, laws=laws, model=model, x0=[1, 0], horizon=horizon,
    ...                 step=0.01)
    >>> plan = plan_of(dt.function_study(loop, {"horizon": [5.0, 50.0]}, scenarios=1000), "no.zarr")
    >>> plan.exists, plan.cells, plan.runs, plan.size
    (False, 2, 2000, 114000)
    """
    url, costs = place_of(store), costs_of(study)
    there = exists(url)
    if there:
        target = open_store(url)
        target.require(study)
        layout, done = target.layout, target.whole_cells()
    else:
        layout, done = layout_of(study, costs), np.zeros(study.shape, dtype=bool)
    runs = len(study.laws) * study.scenarios
    seconds = time_cells(study, costs, ~done) if trial else Timed(float(costs[~done].sum()), 0)
    return Plan(
        store=url,
        exists=there,
        cells=study.size,
        done=int(done.sum()),
        blocks=layout.size,
        missing=sum(not done[layout.slices(number)].all() for number in range(layout.size)),
        runs=int((~done).sum()) * runs,
        seconds=seconds.seconds,
        timed=seconds.cells,
        size=study.size * runs * (8 * len(study.metrics) + 1),
        objects=layout.size * (len(study.metrics) + _FLAGS),
    )
