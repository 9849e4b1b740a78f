"""What the batch engine is given: the loop, and the laws that it can run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from deadtime.feedback import Law
from deadtime.feedback.law import TableLaw
from deadtime.feedback.memory import WithMemory, tables_of
from deadtime.imperfections import Disturbance, Imperfection, Limiting, TimingImperfection
from deadtime.imperfections.array_kinds import is_batched
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.engine import Engine, EngineTable, ModelAhead
from deadtime.switching import SwitchingSignal

_MOST_TERMS = 1500  # of straight-line code for a period of the plant

Runnable = EngineTable | ModelAhead  # the latter is a table along signals


class BatchRequest(NamedTuple):
    """What is to be run, apart from signals; each as in `run.compare`."""

    plant: SwitchedSystem
    laws: Mapping[str, Law]
    x0: np.ndarray
    horizon: float
    step: float
    imperfections: Sequence[Imperfection]


def prepare(request: BatchRequest) -> tuple[Loop, Engine, dict[str, Runnable]]:
    """The loop, its engine, and the laws that this can run."""
    plant, laws, x0, horizon, step, imperfections = request
    forced = any(isinstance(one, Disturbance) for one in imperfections)
    loop = Loop(SampledPlant.of(plant, step), x0, horizon, _actuators(imperfections), forced=forced)
    engine = Engine(loop)
    return loop, engine, _tables(engine, loop, laws, imperfections)


def _actuators(imperfections: Sequence[Imperfection]) -> Sequence[Limiting]:
    """What engines know of imperfections: limits of the inputs."""
    return [one for one in imperfections if isinstance(one, Limiting)]


def _tables(
    engine: Engine,
    loop: Loop,
    laws: Mapping[str, Law],
    imperfections: Sequence[Imperfection],
) -> dict[str, Runnable]:
    """The laws that the engine can run."""
    n, wide = loop.plant.states, loop.acting.wide
    if loop.tables is None or not all(map(is_batched, imperfections)):
        return {}
    if loop.forced and not (loop.plant.delays == loop.plant.delays[0]).all():
        return {}
    if n * wide + wide * (wide + 1) // 2 > _MOST_TERMS:
        return {}
    timed = any(isinstance(one, TimingImperfection) for one in imperfections)
    tables = {name: _table(engine, loop, law, timed) for name, law in laws.items()}
    return {name: table for name, table in tables.items() if table is not None}


def _table(engine: Engine, loop: Loop, law: Law, timed: bool) -> Runnable | None:
    """A law as the engine takes it; None for one that it cannot run."""
    step, samples, anything = loop.step, loop.whole + 1, SwitchingSignal.constant(0)
    if law.draws:  # the engine keeps one beginning and one reference for all scenarios
        return None
    if isinstance(law, WithMemory) and law.outputs is not None and not law.foresees:
        return _with_memory(engine, loop, law, timed)
    if isinstance(law, WithMemory) and not law.foresees:
        return _with_belief(engine, loop, law)
    if not isinstance(law, TableLaw):
        return None
    if law.foresight(step, anything, samples) is not None:
        ahead = ModelAhead(law, law.sampled_plant(step), samples)
        if ahead.loop.tables is None or loop.plant.states**3 > _MOST_TERMS:
            return None
        return ahead
    feedback = law.digital(step, anything, 1)
    if feedback.context == "step":
        return None
    return engine.table(feedback)


def _with_memory(engine: Engine, loop: Loop, law: Law, timed: bool) -> EngineTable | None:
    """The same of a law that remembers; with measurements within periods, of one C for all modes.

    Its memory is filled for one run, but for what the modes of a run do to it.
    """
    tables, C = tables_of(law, loop.step, SwitchingSignal.constant(0), loop.whole + 1), law.outputs
    if tables is not None and tables.bank is not None and tables.feedback is not None:
        if C is None or (timed and (C[0] != C).any()):
            return None
        return engine.estimate(tables.feedback, tables.bank, C)
    if tables is None or tables.memory is None or tables.feedback is None or C is None:
        return None
    if tables.memory.tracked.size and loop.whole == 0:  # errors are summed up to the horizon
        return None
    wide = max(part.shape[-1] for part in (tables.memory.Phi, tables.memory.Gamma))
    if (timed and (C[0] != C).any()) or wide**2 * 4 > _MOST_TERMS:
        return None
    return engine.remember(tables.feedback, tables.memory, C)


def _with_belief(engine: Engine, loop: Loop, law: Law) -> EngineTable | None:
    """The same of a law that weighs its rows by a belief."""
    tables = tables_of(law, loop.step, SwitchingSignal.constant(0), loop.whole + 1)
    if tables is None or tables.belief is None or tables.feedback is None:
        return None
    return engine.believe(tables.feedback, tables.belief)
