"""Prepare a batch run: the loop, the engine, and the tables of the laws that it can run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Feedback, Law
from deadtime.feedback.memory import Tables
from deadtime.imperfections import Disturbance, Imperfection, Limiting, TimingImperfection
from deadtime.imperfections.received import is_batched
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.engine import Engine, EngineTable, ModelAhead
from deadtime.switching import SwitchingSignal

_MOST_TERMS = 1500  # of straight-line code for a period of the plant: more compiles for a minute

Runnable = EngineTable | ModelAhead  # the latter is a table along signals


class BatchRequest(NamedTuple):
    """A run without its signals; each field as in `batch_run.compare`."""

    plant: SwitchedSystem
    laws: Mapping[str, Law]
    x0: np.ndarray
    horizon: float
    step: float
    imperfections: Sequence[Imperfection]


class Prepared(NamedTuple):
    """The loop, its engine, the laws that this can run, and why it cannot run the others."""

    loop: Loop
    engine: Engine
    tables: dict[str, Runnable]
    one_by_one: dict[str, str]


def prepare(request: BatchRequest) -> Prepared:
    """Prepare a batch run."""
    plant, laws, x0, horizon, step, imperfections = request
    forced = any(isinstance(one, Disturbance) for one in imperfections)
    limits = [one for one in imperfections if isinstance(one, Limiting)]
    loop = Loop(SampledPlant.of(plant, step), x0, horizon, limits, forced=forced)
    found = Prepared(loop, Engine(loop), {}, {})
    reason = _why_no_batch(loop, imperfections)
    timed = any(isinstance(one, TimingImperfection) for one in imperfections)
    for name, law in laws.items():
        table = reason or _table(found.engine, loop, law, timed)
        if isinstance(table, str):
            found.one_by_one[name] = table
        else:
            found.tables[name] = table
    return found


def _why_no_batch(loop: Loop, imperfections: Sequence[Imperfection]) -> str:
    """Why the engine can run no law on this loop; empty where it can."""
    n, wide = loop.plant.states, loop.acting.wide
    if loop.tables is None:
        return "the plant is a thousand times faster than the period"
    if any(isinstance(one, Disturbance) and one.depends_on_mode for one in imperfections):
        return "the batch engine takes no force that depends on the mode, such as an [[offset]]"
    if not all(map(is_batched, imperfections)):
        return "an imperfection is written in Python by the user"
    if loop.forced and not loop.plant.modes_share_delays:
        return "the plant is disturbed and its delays differ between modes"
    if n * wide + wide * (wide + 1) // 2 > _MOST_TERMS:
        return "the plant has too many states and inputs in flight"
    return ""


def _table(engine: Engine, loop: Loop, law: Law, timed: bool) -> Runnable | str:
    """A law as the engine takes it; or why it cannot run it."""
    if law.draws:  # the engine keeps one first estimate and one reference for all scenarios
        return "it draws its first estimate or its reference"
    C = law.outputs
    if C is not None and law.needs_preview:
        return "it measures outputs and knows the signal"
    steps = 1 if C is None else loop.whole + 1
    tables = law.tables_along(loop.step, SwitchingSignal.constant(0), steps)
    if tables is None:
        return "it is no table of gains"
    if tables.preview is not None:
        ahead = ModelAhead(law, law.sampled_plant(loop.step), loop.whole + 1)
        fits = ahead.loop.tables is not None and loop.plant.states**3 <= _MOST_TERMS
        return ahead if fits else "its prediction has too many states, or is too fast"
    feedback = tables.feedback
    if feedback is None or feedback.context == "step":
        return "its gains change from sample to sample"
    if C is not None:
        return _on_outputs(engine, loop, tables, feedback, C, timed)
    if tables.belief is not None:
        return engine.on_belief(feedback, tables.belief)
    return engine.table(feedback)


def _on_outputs(
    engine: Engine,
    loop: Loop,
    tables: Tables,
    feedback: Feedback,
    C: Float[np.ndarray, "mode p n"],
    timed: bool,
) -> EngineTable | str:
    """The table of a law on outputs; or why the engine cannot run it."""
    memory = tables.memory
    if timed and (C[0] != C).any():
        return "outputs that depend on the mode are measured within periods"
    if tables.bank is not None:
        return engine.on_bank(feedback, tables.bank, C)
    if memory is None:
        return "it has no observer"
    if memory.tracked.size and loop.whole == 0:  # sums of errors go to the end
        return "it follows a reference for less than a period"
    wide = max(part.shape[-1] for part in (memory.Phi, memory.Gamma))
    if wide**2 * 4 > _MOST_TERMS:
        return "its observer has too many states"
    return engine.on_observer(feedback, memory, C)
