"""Both engines against `simulate` and each other: every law, limits, odd sizes."""

import importlib
import itertools
import re
import sys

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.imperfections import RateLimit, Saturation
from deadtime.plant import Window
from deadtime.scenarios.cpu import CpuEngine
from deadtime.scenarios.figures import metrics_of, needs_own_run
from deadtime.scenarios.jax_engine import JaxEngine
from deadtime.scenarios.jax_kernel import run_scenarios
from deadtime.scenarios.loop import Loop
from deadtime.switching import SignalBatch

X0 = np.array([0.3, -0.6, 0.9])
H, HORIZON, COUNT = 0.1, 6.03, 7
CHUNK = 4  # the last one is not full
TRUTH, BELIEVED = plants.generic(), plants.generic(0.3, seed=5)
LIMITS = (Saturation([-2.0, -1.0], 1.5), RateLimit([9.0, 12.0]))


def signals(count=COUNT):
    """Switches off the grid of samples, several of them in some periods; odd ages at the start."""
    drawn = [
        dt.SwitchingSignal.random(3, HORIZON + 9.0, dwell_time=0.03, seed=i) for i in range(count)
    ]
    return [
        dt.SwitchingSignal(s.times, s.modes, s.end, initial_age=0.07 * i)
        for i, s in enumerate(drawn)
    ]


SIGNALS = signals()


def loop_of(plant=TRUTH, actuators=()):
    return Loop(plant, Window.of(plant.delay, H), X0, HORIZON, actuators)


def table_of(engine, loop, law, own=SIGNALS):
    samples = loop.whole + 1
    feedback = law.digital(H, own[0], samples)
    if feedback.context == "step":
        return engine.tables([law.digital(H, signal, samples) for signal in own])
    return engine.table(feedback)


ENGINES = {"numba": CpuEngine, "jax": lambda loop: JaxEngine(loop, CHUNK)}
both_engines = pytest.mark.parametrize("backend", ENGINES)


def check_as_simulated(backend, loop, law, scenarios=(3, 6)):
    """Metrics, states and inputs of some scenarios are those of `simulate`, to 1e-11 of each."""
    engine = ENGINES[backend](loop)
    figures, path = engine.path(
        table_of(engine, loop, law), loop.lay(SignalBatch.of(SIGNALS)), 0, COUNT
    )
    assert path.x.shape == (COUNT, 3, loop.whole + 1)
    assert not needs_own_run(loop, figures).any()
    found = metrics_of(loop, figures)
    for i in scenarios:
        run = dt.simulate(loop.plant, law, SIGNALS[i], X0, HORIZON, H, imperfections=loop.actuators)
        for name, value in run.metrics().items():
            assert found[name][i] == pytest.approx(value, rel=1e-11), name
        plants.close(path.x[i], run.states[:, : loop.whole + 1], 1e-11)
        plants.close(path.u[i], run.inputs[:, : loop.whole + 1], 1e-11)


# -- against simulate --------------------------------------------------------------------------


def every_law():
    """All laws on both engines; those that add no kind of row to the others take `make long`."""
    kinds = "averaged", "weighted", "expected", "averaged, dwell-aware", "exact"
    free = {"numba": ("mean, dwell-aware",), "jax": ("single", "delayed")}
    for backend, name in itertools.product(ENGINES, plants.LAWS):
        marks = () if name in (*kinds, *free[backend]) else pytest.mark.long
        yield pytest.param(name, backend, marks=marks)


@pytest.mark.parametrize(("name", "backend"), list(every_law()))
def test_every_law_runs_as_simulated_on_a_plant_that_is_not_its_own(name, backend):
    assert TRUTH.delay % H > 0.0
    assert HORIZON % H > 0.0
    check_as_simulated(backend, loop_of(), plants.LAWS[name](BELIEVED))


@pytest.mark.parametrize(
    ("name", "backend"),
    [
        ("averaged", "jax"),
        pytest.param("mean, dwell-aware", "jax", marks=pytest.mark.long),
        ("averaged", "numba"),
    ],
)
def test_limited_inputs_are_as_simulated(name, backend):
    check_as_simulated(backend, loop_of(actuators=LIMITS), plants.LAWS[name](BELIEVED))


@both_engines
@pytest.mark.parametrize("name", ["averaged", "exact"])
def test_a_window_longer_than_the_run_is_as_simulated(name, backend):
    loop = loop_of(plants.generic(8.04))
    assert loop.window.count > loop.whole + 1
    check_as_simulated(
        backend, loop, plants.LAWS[name](plants.generic(8.5, seed=5)), scenarios=(3,)
    )


@pytest.mark.parametrize("backend", [pytest.param("numba", marks=pytest.mark.long), "jax"])
def test_a_window_of_one_input_is_as_simulated(backend):
    check_as_simulated(
        backend, loop_of(plants.generic(H)), plants.LAWS["averaged"](plants.generic(0.06))
    )


# -- against the CPU engine --------------------------------------------------------------------


@pytest.mark.parametrize("name", ["averaged", "averaged, dwell-aware"])
def test_figures_of_all_scenarios_are_those_of_the_cpu_engine(name):
    loop, law = loop_of(), plants.LAWS[name](BELIEVED)
    laid, engines = loop.lay(SignalBatch.of(SIGNALS)), (CpuEngine(loop), JaxEngine(loop, CHUNK))
    one, other = (engine.run(table_of(engine, loop, law), laid) for engine in engines)
    for mine, theirs, field in zip(one, other, one._fields, strict=True):
        assert mine == pytest.approx(theirs, rel=1e-11), field


# -- what it promises --------------------------------------------------------------------------


def test_chunks_and_the_part_that_is_asked_for_change_nothing():
    loop = loop_of()
    laid, law = loop.lay(SignalBatch.of(SIGNALS)), plants.LAWS["averaged"](BELIEVED)
    whole, parts = JaxEngine(loop), JaxEngine(loop, CHUNK)
    table = table_of(whole, loop, law)
    all_at_once, some = whole.run(table, laid), parts.run(table, laid, 1, 6)
    assert some.ise == pytest.approx(all_at_once.ise[1:], rel=1e-12)
    late = parts.path(table, laid, 1, 6, keep=40)[1]
    assert late.u == pytest.approx(parts.path(table, laid, 0, COUNT)[1].u[1:, :, 40:], rel=1e-12)


def test_laws_and_signals_of_one_shape_are_compiled_once():
    loop = loop_of()
    engine, other = JaxEngine(loop, CHUNK), [*SIGNALS[::-1], SIGNALS[3]]
    laid = [loop.lay(SignalBatch.of(some)) for some in (SIGNALS, other)]
    engine.run(table_of(engine, loop, plants.LAWS["averaged"](BELIEVED)), laid[0])
    compiled = run_scenarios._cache_size()
    for law in (plants.LAWS["weighted"](BELIEVED), plants.LAWS["averaged"](BELIEVED.apart(0.5))):
        for one in laid:
            engine.run(table_of(engine, loop, law), one)
    assert run_scenarios._cache_size() == compiled


def test_double_precision_stays_within_the_engine():
    import jax.numpy as jnp

    loop = loop_of()
    engine = JaxEngine(loop, CHUNK)
    law = plants.LAWS["averaged"](BELIEVED)
    figures = engine.run(table_of(engine, loop, law), loop.lay(SignalBatch.of(SIGNALS)))
    assert figures.ise.dtype == np.float64
    assert jnp.ones(1).dtype == jnp.float32


def test_a_chunk_of_no_scenarios_is_refused():
    with pytest.raises(dt.ArgumentError, match="chunk must be an integer of at least 1, got 0"):
        JaxEngine(loop_of(), 0)


def test_without_jax_the_import_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "jax", None)
    for module in ("jax_double", "jax_engine"):
        monkeypatch.delitem(sys.modules, f"deadtime.scenarios.{module}")
    message = 'backend "jax" needs JAX: pip install "deadtime[jax]".'
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        importlib.import_module("deadtime.scenarios.jax_engine")
