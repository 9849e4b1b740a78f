"""`monte_carlo`: several laws over many switching signals, as a labelled dataset.

Scenarios run in blocks on threads, with progress; Ctrl-C ends the run. Memory for all results is
checked before the run.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import count, instance, positive, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.base.threads import processors
from deadtime.feedback import Law
from deadtime.feedback.law import require_match
from deadtime.imperfections import Disturbance, Imperfection, Relaying, TimingImperfection, streams
from deadtime.plant import SwitchedSystem
from deadtime.plant.weight import Weight, weight_of
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.block import Block
from deadtime.scenarios.dataset import METRICS, Results, dataset_of, named_laws
from deadtime.scenarios.source import SignalSampler, source_of
from deadtime.simulation.outcome import is_pushed
from deadtime.simulation.simulate import require_steps
from deadtime.simulation.tracking import TRACKING, Followed
from deadtime.switching import SignalBatch, SwitchingModel, SwitchingSignal

if TYPE_CHECKING:
    import xarray as xr

    Laws = Sequence[Law] | Mapping[str, Law]
    Model = SignalSampler | Sequence[SwitchingSignal] | SignalBatch
else:
    Laws = Model = object  # `named_laws` and `source_of` check them, with better messages

_SHARE = 0.8  # of the memory that is free


def free_memory() -> float:
    """Bytes of free memory; of all memory, or ∞, where the system reports no more."""
    for name in ("SC_AVPHYS_PAGES", "SC_PHYS_PAGES"):
        if name in getattr(os, "sysconf_names", {}):
            return float(os.sysconf(name)) * float(os.sysconf("SC_PAGE_SIZE"))
    return float("inf")


def require_memory(what: str, needed: float, advice: str) -> None:
    """Refuse what would take more than four fifths of the free memory."""
    free = free_memory()
    if needed > _SHARE * free:
        raise ArgumentError(
            f"{what} would take {needed / 2**30:,.1f} GiB, and {free / 2**30:,.1f} GiB of memory "
            f"are free: {advice}."
        )


Progress = Callable[[int, int], None]
RunBlock = Callable[[int, int, Callable[[], bool]], int]

_CHECK = 0.2  # seconds between looks at the keyboard


def run_blocks(
    run: RunBlock, scenarios: int, size: int, threads: int, progress: Progress
) -> tuple[int, bool]:
    """Run all scenarios in blocks of `size`; the sum of the blocks' results, and if interrupted.

    Ctrl-C ends the run within a block's time: running blocks are dropped, finished ones are kept.
    An error in a block ends the run, too.
    """
    starts = iter(range(0, scenarios, size))
    stop = threading.Event()
    total, done, running = 0, 0, {}
    pool = ThreadPoolExecutor(threads, thread_name_prefix="deadtime")
    try:
        while True:
            # One more than there are threads keeps all of them busy, and leaves little to cancel.
            while len(running) < threads + 1 and (start := next(starts, None)) is not None:
                few = min(size, scenarios - start)
                running[pool.submit(run, start, few, stop.is_set)] = few
            if not running:
                return total, False
            finished, _ = wait(running, _CHECK, FIRST_COMPLETED)
            for future in finished:
                done += running.pop(future)
                total += future.result()
                progress(done, scenarios)
    except KeyboardInterrupt:
        stop.set()
        for future in running:
            future.cancel()
        ended, _ = wait(running)
        whole = [one for one in ended if not one.cancelled() and not one.exception()]
        return total + sum(one.result() for one in whole), True
    finally:
        stop.set()
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def show_progress(progress: Progress | bool | None, scenarios: int) -> Iterator[Progress]:
    """The function that receives progress: the user's, that of a bar on the terminal, or none."""
    if progress is None or progress is False:
        yield lambda done, total: None
    elif progress is True:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

        console = Console(stderr=True)
        columns = (BarColumn(), MofNCompleteColumn(), "scenarios", TimeRemainingColumn())
        with Progress(*columns, console=console, transient=True) as bar:
            task = bar.add_task("", total=scenarios)
            yield lambda done, total: bar.update(task, completed=done)
    elif callable(progress):
        yield progress
    else:
        raise ArgumentError(
            f"progress must be True, False or a function (done, total), got {progress!r}."
        )


_BLOCK_STEPS, _BLOCK = 4e6, 2048  # periods in a block, and scenarios: a tenth of a second of work
_NAMED = 10  # scenarios that a message names


def monte_carlo(
    plant: SwitchedSystem,
    laws: Laws,
    model: Model,
    x0: ArrayLike,
    horizon: float,
    step: float = 0.01,
    scenarios: int = 1000,
    seed: int = 0,
    backend: str = "numba",
    progress: Progress | bool | None = None,
    imperfections: Sequence[Imperfection] = (),
    trajectories: bool = False,
    threads: int | None = None,
    weight: Weight | None = None,
) -> xr.Dataset:
    """Run several laws over many switching signals, every law on the same ones.

    The signal of scenario i depends on the model, on `seed` and on i only: not on the number
    of scenarios or of laws, or on how many threads there are; `draw_signals`
    gives it. Inputs before time 0 are 0. The loops are those of `simulate`: switches anywhere,
    any delay, a law whose model is not the plant.

    Laws that are tables run many scenarios at once, at a cost that does not depend on the delay
    where their rows are factorised; so do laws on observers (`OutputFeedback`) and on a mode belief
    (`BeliefPredictor`). Other laws run one by one, by `simulate`, and ``attrs["one_by_one"]`` names
    them, ``attrs["one_by_one_because"]`` the reasons: laws that are no table; laws that draw their
    first estimate or reference, in scenario i by the seed ``scenario_seed(seed, i)``; servos over
    less than a period; and all laws where the plant is disturbed and its delays differ between
    modes, where a constant force differs between modes, where an imperfection is a function of the
    user, or where the plant has more than some 30 states (11 for a law that knows the signal) or is
    a thousand times faster than the period. Scenarios that diverge or vanish run again by
    `simulate`, too.

    Parameters
    ----------
    plant : SwitchedSystem
        The true plant, as in `simulate`.
    laws : list of Law, or mapping of names to laws
        A list is named by the laws' labels, which must differ.
    model : switching model, list of SwitchingSignal, or SignalBatch
        A `deadtime.switching.SwitchingModel`, which draws whole batches, or any object with a
        method ``sample(horizon, seed)``, called for signals up to the horizon plus the longest
        delay. Or the signals themselves, one per scenario: a signal that ends before the horizon is
        continued in its last mode, as in `simulate`, and ``attrs["message"]`` counts these.
    x0 : array_like, shape (n,)
        State at time 0.
    horizon : float
        Length of every run, in seconds.
    step : float
        Sampling period h, in seconds.
    scenarios : int
        Number of signals to draw, ≥ 1; with a list of signals its length counts instead.
    seed : int
        At least 0. The same seed gives the same signals.
    backend : "numba"
        The compiled loop, the only engine.
    progress : bool or callable, optional
        True for a bar on the terminal; or called as ``progress(done, total)`` after each block
        of scenarios.
    imperfections : sequence of Imperfection
        As in `simulate`. Scenario i draws the same for every law, whatever the number of scenarios:
        the numbers of `simulate` with the seed ``scenario_seed(seed, i)`` of `deadtime.scenarios`.
    trajectories : bool
        Keep states and inputs at the samples, and the modes.
    threads : int, optional
        Number of threads; by default one for each processor.
    weight : Weight, optional
        Weight of the cost, the identity by default; with another one every scenario runs twice.

    Returns
    -------
    xarray.Dataset
        Dimensions (law, scenario); one variable per metric of `Trajectory.metrics`, with its
        unit, and `diverged`. A run that diverges leaves its metrics up to its end, and the
        other runs untouched; ``attrs["message"]`` counts and names such scenarios. Where a law
        has a servo also the figures of `Trajectory.step_info` (law, scenario, output), of the
        last step of its reference, NaN for laws without. With trajectories also x (law, scenario,
        state, time), u and mode, NaN past a run's end. After Ctrl-C the scenarios that are done,
        with ``attrs["interrupted"]`` = 1.

    Raises
    ------
    ArgumentError
        If an argument is malformed, laws, plant and signals do not belong together, the results
        would not fit into memory, or there is no such backend.

    Examples
    --------
    >>> import deadtime as dt
    >>> from deadtime.scenarios import monte_carlo
    >>> problem = dt.problems.paper()
    >>> laws = [problem.laws["averaged"], problem.laws["mean"]]
    >>> signals = [dt.SwitchingSignal.random(2, 16, dwell_time=0.2, seed=i) for i in range(20)]
    >>> data = monte_carlo(problem.plant, laws, signals, problem.x0, horizon=15)
    >>> dict(data.sizes), int(data.diverged.sum())
    ({'law': 2, 'scenario': 20}, 0)
    >>> data.ise.median("scenario").sel(law="mean").item() < 1000
    True
    """
    loop = plant, laws, model, x0, horizon, step, scenarios, seed, backend, progress
    return compare(*loop, imperfections, trajectories, threads, weight)


def compare(
    plant: SwitchedSystem,
    laws: Laws,
    model: Model,
    x0: ArrayLike,
    horizon: float,
    step: float = 0.01,
    scenarios: int = 1000,
    seed: int = 0,
    backend: str = "numba",
    progress: Progress | bool | None = None,
    imperfections: Sequence[Imperfection] = (),
    trajectories: bool = False,
    threads: int | None = None,
    weight: Weight | None = None,
    share_compiling: bool = False,
) -> xr.Dataset:
    """`monte_carlo`; where `share_compiling`, a second process compiles for some of the laws."""
    from deadtime.scenarios.engine import Engine
    from deadtime.scenarios.helper import Helper
    from deadtime.scenarios.prepare import BatchRequest, prepare

    horizon, step = positive("horizon", horizon), positive("step", step)
    instance("plant", plant, SwitchedSystem)
    named = named_laws(laws)
    for law in named.values():
        require_match(plant, law)
    scenarios, seed = count("scenarios", scenarios), count("seed", seed, 0)
    threads = processors() if threads is None else count("threads", threads)
    if backend != "numba":
        raise ArgumentError(f"backend must be 'numba', the only engine there is, got {backend!r}.")
    x0 = require_shape("x0", real_array("x0", x0, "(n,)", 1), (plant.states,), "(n,)")
    delay = max(plant.longest_delay, *(law.plant.longest_delay for law in named.values()))
    require_steps(horizon, delay, step)
    source, scenarios = source_of(model, scenarios, seed, horizon + delay, plant.modes)
    streams(imperfections, seed)
    request = BatchRequest(plant, named, x0, horizon, step, imperfections)
    loop, engine, tables, one_by_one = prepare(request)
    follow = [Followed.of(law) for law in named.values()]
    tracked = max((one.rows.shape[1] for one in follow if one is not None), default=0)
    results = _room(loop, len(named), scenarios, trajectories, tracked)
    weight, weighed = weight_of(weight, plant), None
    if weight is not None:
        other = replace(loop, weight=weight)
        weighed = other, Engine(other)
    helper = Helper(request, tables if share_compiling else {})
    given = loop, source, named, tables, engine, imperfections, seed, results, helper, weighed
    # `simulate` runs Python: blocks of one, and threads would only wait for each other.
    size = _block(loop, imperfections) if tables else 1
    workers = min(threads, -(-scenarios // size)) if tables else 1
    with show_progress(progress, scenarios) as report, helper.at_hand():
        run = Block(*given).run
        continued, interrupted = run_blocks(run, scenarios, size, workers, report)
    notes = []
    if isinstance(model, SwitchingModel) and model.modes != plant.modes:
        notes.append(
            f"the model has {model.modes} modes, the plant {plant.modes}: the others never occur."
        )
    notes += _notes(results, list(named), continued, interrupted)
    # |x(T)| above which a run that does not decay has grown: ∞ where x is pushed, or starts at 0.
    pushed = any(is_pushed(law, imperfections) for law in named.values())
    grows_above = math.inf if pushed or not x0.any() else float(np.linalg.norm(x0))
    attributes = {
        "seed": seed,
        "step": step,
        "horizon": horizon,
        "modes": plant.modes,
        "states": plant.states,
        "inputs": plant.inputs,
        "delay": plant.delay_data if plant.has_one_delay else plant.delays.ravel().tolist(),
        "backend": backend,
        "imperfections": [repr(one) for one in imperfections],
        "grows_above": grows_above,
        "one_by_one": list(one_by_one),
        "one_by_one_because": list(one_by_one.values()),
        "interrupted": int(interrupted),
        "message": " ".join(notes),
    }
    return dataset_of(list(named), results, attributes, weight)


def _block(loop: Loop, imperfections: Sequence[Imperfection]) -> int:
    """Scenarios in a block, in whole vectors of eight; fewer where received data are stored."""
    steps = _BLOCK_STEPS
    if any(isinstance(one, Relaying | TimingImperfection | Disturbance) for one in imperfections):
        steps /= 4
    return 8 * int(np.clip(steps / 8 / (loop.whole + 1), 1, _BLOCK / 8))


def _room(loop: Loop, laws: int, scenarios: int, trajectories: bool, tracked: int) -> Results:
    """Arrays for the results, where there is memory for them."""
    plant, samples = loop.plant, loop.whole + 1
    needed = scenarios * laws * (8.0 * (len(METRICS) + tracked * len(TRACKING)) + 1.0)
    require_memory(f"metrics of {scenarios:,} scenarios", needed, "run fewer at a time")
    if not trajectories:
        return Results.empty(laws, scenarios, tracked=tracked)
    needed += scenarios * samples * (8.0 * laws * (plant.states + plant.inputs) + 4.0)
    require_memory(
        f"trajectories of {scenarios:,} scenarios of {samples:,} samples under {laws} laws",
        needed,
        "leave trajectories out and run the scenarios of interest alone, with draw_signals and "
        "simulate",
    )
    return Results.empty(laws, scenarios, (plant.states, plant.inputs, samples), tracked)


def _notes(results: Results, names: Sequence[str], continued: int, interrupted: bool) -> list[str]:
    """Sentences on the whole run: interruption, continued signals, divergence."""
    done, scenarios = int(results.done.sum()), results.done.size
    notes = []
    if interrupted:
        notes.append(f"interrupted after {done:,} of {scenarios:,} scenarios.")
    if continued:
        notes.append(
            f"{continued} of {done} signals end before the horizon and were continued in their "
            "last mode."
        )
    for name, diverged in zip(names, results.diverged, strict=True):
        which = np.flatnonzero(diverged & results.done)
        if which.size:
            listed = ", ".join(map(str, which[:_NAMED])) + ", …" * (which.size > _NAMED)
            notes.append(f"{name} diverged on {which.size:,} of {done:,} scenarios: {listed}.")
    return notes
