"""`monte_carlo`: several laws over many switching signals, as a labelled dataset.

Scenarios are run in blocks on threads, with progress, and with an end when the user asks for one;
the memory that the whole needs is asked for before it starts.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import instance, positive, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.base.threads import processors
from deadtime.feedback import Law
from deadtime.feedback.law import require_match
from deadtime.imperfections import (
    Disturbance,
    Imperfection,
    Relaying,
    TimingImperfection,
    streams,
)
from deadtime.imperfections.disturbances import in_words
from deadtime.plant import SwitchedSystem
from deadtime.plant.weight import Weight, weight_of
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.block import Block
from deadtime.scenarios.dataset import METRICS, Comparison, Results, dataset_of, named_laws
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
    """Bytes of memory that are free, or all there are where the system does not tell."""
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
    """Run all scenarios in blocks of `size`; the sum of what blocks return, and if cut short.

    Ctrl-C ends the run within a block's time: blocks in hand are left, those done are kept. An
    error in a block ends the run, too.
    """
    starts = iter(range(0, scenarios, size))
    stop = threading.Event()
    total, done, running = 0, 0, {}
    pool = ThreadPoolExecutor(threads, thread_name_prefix="deadtime")
    try:
        while True:
            # No more are handed over than are needed to keep all threads busy.
            while len(running) < threads + 1 and (start := next(starts, None)) is not None:
                count = min(size, scenarios - start)
                running[pool.submit(run, start, count, stop.is_set)] = count
            if not running:
                return total, False
            finished, _ = wait(running, _CHECK, FIRST_COMPLETED)
            for future in finished:
                done += running.pop(future)
                total += future.result()
                progress(done, scenarios)
    except KeyboardInterrupt:
        stop.set()
        return total + _rest(running), True
    finally:
        stop.set()
        pool.shutdown(wait=True, cancel_futures=True)


def _rest(running: dict[Future[int], int]) -> int:
    """Collect the blocks in hand at the end, cancel the others, and sum the results."""
    for future in running:
        future.cancel()
    finished, _ = wait(running)
    return sum(
        future.result() for future in finished if not future.cancelled() and not future.exception()
    )


@contextmanager
def show_progress(progress: Progress | bool | None, scenarios: int) -> Iterator[Progress]:
    """The function to report progress to: the user's, a bar on the terminal, or none."""
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


_BLOCK_STEPS, _BLOCK = 4e6, 2048  # periods in a block, and scenarios
_MOST_TERMS = 1500  # of straight-line code for a period of the plant
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
    where their rows are factorised; so do those of their observers (`OutputFeedback`) and those
    that weigh rows by a belief (`BeliefPredictor`). One by one, by `simulate`, run: laws that are
    no table, laws that draw their first estimate or reference (`OutputFeedback`), in scenario i
    by the seed ``scenario_seed(seed, i)`` alone, all laws where the plant is disturbed and its
    delays differ between modes, or an imperfection is a function of the user's own, plants beyond
    some 30 states (11 for a law that knows the signal) or a thousand times faster than the period,
    and servos over less than a period; `attrs["one_by_one"]` names the laws. So do scenarios that
    diverge or vanish.

    Parameters
    ----------
    plant : SwitchedSystem
        The truth, as in `simulate`.
    laws : list of Law, or mapping of names to laws
        A list is named by the laws' labels, which must differ.
    model : switching model, list of SwitchingSignal, or SignalBatch
        A `deadtime.switching.SwitchingModel`, which draws whole batches, or anything with a method
        ``sample(horizon, seed)``; it is asked for signals that reach the horizon plus the longest
        delay. Or the signals themselves, one per scenario. One that ends before the horizon goes
        on in its last mode, as in `simulate`, and ``attrs["message"]`` counts these.
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
        The compiled loop for processors, the only engine that there is.
    progress : bool or callable, optional
        True for a bar on the terminal; or called as ``progress(done, total)`` after each block
        of scenarios.
    imperfections : sequence of Imperfection
        What sensors and actuators do, as in `simulate`; scenario i draws the same for every law,
        whatever the number of scenarios: what `simulate` draws with the seed
        ``scenario_seed(seed, i)`` of `deadtime.scenarios`.
    trajectories : bool
        Keep states and inputs at the samples, and the modes.
    threads : int, optional
        How many to use; by default one for each processor.
    weight : Weight, optional
        Of the cost, the identity by default; with another one every scenario runs twice.

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
    found = compare(
        plant,
        laws,
        model,
        x0,
        horizon,
        step,
        scenarios,
        seed,
        backend,
        progress,
        imperfections,
        trajectories,
        threads,
        weight,
    )
    return dataset_of(found)


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
) -> Comparison:
    """`monte_carlo` before its results are labelled: xarray takes as long as the run to load.

    Where `share_compiling`, a second process compiles for some of the laws.
    """
    from deadtime.scenarios.engine import Engine
    from deadtime.scenarios.helper import Helper
    from deadtime.scenarios.prepare import BatchRequest, prepare

    horizon, step = positive("horizon", horizon), positive("step", step)
    instance("plant", plant, SwitchedSystem)
    named = named_laws(laws)
    for law in named.values():
        require_match(plant, law)
    scenarios, seed = _whole("scenarios", scenarios, 1), _whole("seed", seed, 0)
    threads = processors() if threads is None else _whole("threads", threads, 1)
    if backend != "numba":
        raise ArgumentError(f"backend must be 'numba', the only engine there is, got {backend!r}.")
    x0 = require_shape("x0", real_array("x0", x0, "(n,)", 1), (plant.states,), "(n,)")
    delay = max(plant.longest_delay, *(law.plant.longest_delay for law in named.values()))
    require_steps(horizon, delay, step)
    source, scenarios = source_of(model, scenarios, seed, horizon + delay, plant.modes)
    streams(imperfections, seed)
    request = BatchRequest(plant, named, x0, horizon, step, imperfections)
    loop, engine, tables = prepare(request)
    follow = [Followed.of(law) for law in named.values()]
    tracked = max((one.rows.shape[1] for one in follow if one is not None), default=0)
    results = _room(loop, len(named), scenarios, trajectories, tracked)
    weight, weighed = weight_of(weight, plant), None
    if weight is not None:
        other = replace(loop, weight=weight)
        weighed = other, Engine(other)
    helper = Helper(request, tables if share_compiling else {})
    block = Block(
        loop, source, named, tables, engine, imperfections, seed, results, helper, weighed
    )
    size = _block(loop, imperfections) if tables else 1
    with show_progress(progress, scenarios) as report, helper.at_hand():
        workers = min(threads, -(-scenarios // size)) if tables else 1
        continued, interrupted = run_blocks(block.run, scenarios, size, workers, report)
    attributes = {
        "seed": seed,
        "step": step,
        "horizon": horizon,
        "modes": plant.modes,
        "states": plant.states,
        "inputs": plant.inputs,
        "delay": plant.delay_data if plant.has_one_delay else plant.delays.ravel().tolist(),
        "backend": backend,
        "imperfections": [in_words(one) for one in imperfections],
        "grows_above": _grows_above(x0, named.values(), imperfections),
        "one_by_one": [name for name in named if name not in tables],
        "interrupted": int(interrupted),
        "message": _message(results, list(named), continued, interrupted, _unseen(model, plant)),
    }
    return Comparison(list(named), results, step, attributes, weight)


def _grows_above(
    x0: np.ndarray, laws: Iterable[Law], imperfections: Sequence[Imperfection]
) -> float:
    """|x(T)| above which a run that does not decay has grown; ∞ where x is pushed, or at rest."""
    pushed = any(is_pushed(law, imperfections) for law in laws)
    return math.inf if pushed or not x0.any() else float(np.linalg.norm(x0))


def _block(loop: Loop, imperfections: Sequence[Imperfection]) -> int:
    """Scenarios in a block, in whole vectors of eight; fewer where all received data are kept."""
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


def _whole(name: str, value: object, least: int) -> int:
    """An integer ≥ `least`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ArgumentError(f"{name} must be an integer ≥ {least}, got {value!r}.")
    return int(value)


def _unseen(model: object, plant: SwitchedSystem) -> str:
    """That a model knows of fewer modes than the plant has: they are left out at times."""
    if not isinstance(model, SwitchingModel) or model.modes == plant.modes:
        return ""
    return f"the model has {model.modes} modes, the plant {plant.modes}: the others never occur."


def _message(
    results: Results, names: Sequence[str], continued: int, interrupted: bool, unseen: str
) -> str:
    """The notes on the run as a whole: interruptions, continued signals, divergence."""
    done, scenarios = int(results.done.sum()), results.done.size
    notes = [unseen] if unseen else []
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
    return " ".join(notes)
