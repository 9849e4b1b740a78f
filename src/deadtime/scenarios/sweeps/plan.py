"""What a sweep would do, or has done so far, without computing anything."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike

import numpy as np

from deadtime.scenarios.sweeps.blocks import costs_of, layout_of
from deadtime.scenarios.sweeps.pilot import Timed, time_cells
from deadtime.scenarios.sweeps.store import exists, open_store, place_of
from deadtime.scenarios.sweeps.study import Study

_FLAGS = 3  # objects of a block beside one per metric: diverged, reason, done


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
    """What `sweep` would do: its cells, and which of them the store holds already.

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
