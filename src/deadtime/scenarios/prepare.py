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

_MOST_TERMS = 1500  # of straight-line code for a period of the plant

Runnable = EngineTable | ModelAhead  # the latter is a table along signals


class BatchRequest(NamedTuple):
    """A run without its signals; each field as in `run.compare`."""

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
    """The imperfections that engines model themselves: limits of the inputs."""
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
    if loop.forced and not loop.plant.modes_share_delays:
        return {}
    if n * wide + wide * (wide + 1) // 2 > _MOST_TERMS:
        return {}
    timed = any(isinstance(one, TimingImperfection) for one in imperfections)
    tables = {name: _table(engine, loop, law, timed) for name, law in laws.items()}
    return {name: table for name, table in tables.items() if table is not None}


def _table(engine: Engine, loop: Loop, law: Law, timed: bool) -> Runnable | None:
    """A law as the engine takes it; None for one that it cannot run."""
    if law.draws:  # the engine keeps one beginning and one reference for all scenarios
        return None
    C = law.outputs
    if C is not None and law.needs_preview:
        return None
    steps = 1 if C is None else loop.whole + 1
    tables = law.tables_along(loop.step, SwitchingSignal.constant(0), steps)
    if tables is None:
        return None
    if tables.preview is not None:
        ahead = ModelAhead(law, law.sampled_plant(loop.step), loop.whole + 1)
        fits = ahead.loop.tables is not None and loop.plant.states**3 <= _MOST_TERMS
        return ahead if fits else None
    feedback = tables.feedback
    if feedback is None or feedback.context == "step":
        return None
    if C is not None:
        return _on_outputs(engine, loop, tables, feedback, C, timed)
    return (
        engine.table(feedback) if tables.belief is None else engine.believe(feedback, tables.belief)
    )


def _on_outputs(
    engine: Engine,
    loop: Loop,
    tables: Tables,
    feedback: Feedback,
    C: Float[np.ndarray, "mode p n"],
    timed: bool,
) -> EngineTable | None:
    """The table of a law on outputs; measurements within periods need one C for all modes."""
    memory = tables.memory
    if timed and (C[0] != C).any():
        return None
    if tables.bank is not None:
        return engine.estimate(feedback, tables.bank, C)
    if memory is None or (memory.tracked.size and loop.whole == 0):  # errors are summed to the end
        return None
    wide = max(part.shape[-1] for part in (memory.Phi, memory.Gamma))
    return None if wide**2 * 4 > _MOST_TERMS else engine.remember(feedback, memory, C)
