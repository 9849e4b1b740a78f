"""The process that compiles for some of the laws: what it does, and what comes of its failing."""

import dataclasses
import inspect
import os
import pickle
import subprocess
import sys
import textwrap

import pytest
from numba import typeof

import deadtime as dt
import plants
from deadtime.imperfections import Noise, Saturation
from deadtime.scenarios import by_period, engine as engines, helper
from deadtime.scenarios.helper import Helper, share_of
from deadtime.scenarios.lane_loop import run_scenarios
from deadtime.scenarios.prepare import BatchRequest, prepare
from deadtime.switching import SignalBatch

PAPER = dt.problems.paper()
X0 = PAPER.x0
KERNEL = run_scenarios.function


def request(laws=PAPER.laws, imperfections=(), step=0.1):
    return BatchRequest(PAPER.plant, dict(laws), X0, 3.0, step, imperfections)


@pytest.fixture
def asked(monkeypatch):
    """The types with which the loop and what it needs are called; the loop does not run."""
    types = []

    def note(*arguments):
        types.append(tuple(map(typeof, arguments)))

    monkeypatch.setattr(engines, "run_scenarios", note)
    monkeypatch.setattr(by_period, "fill_composed", note)
    return types


@pytest.mark.parametrize(("limits", "step"), [((), 0.1), ((Saturation(-2.0, 2.0),), 0.15)])
def test_what_is_compiled_elsewhere_is_what_runs_here(asked, limits, step):
    """Another process has the same types, whatever has become of the arrays on their way to it."""
    laws = {name: make(PAPER.plant) for name, make in plants.LAWS.items()}
    loop, engine, tables, _ = prepare(request(laws, limits, step))
    signals = SignalBatch.of([dt.SwitchingSignal.random(2, 9.0, dwell_time=0.3, seed=0)])
    for table in tables.values():
        engine.run(engine.along(table, signals), loop.sample_signals(signals))
    here = asked.copy()
    asked.clear()
    _, there, others, _ = prepare(pickle.loads(pickle.dumps(request(laws, limits, step))))
    for table in others.values():
        there.compile(table)
    assert list(others) == list(tables)
    assert asked == here
    loops = {types for types in here if len(types) == len(inspect.signature(KERNEL).parameters)}
    assert len({helper._kind(table) for table in tables.values()}) == len(loops) > 4
    # A delay of whole periods has no rest to compose.
    assert (len(loops) < len(set(here))) == (step == 0.15)


def test_a_weight_of_the_cost_asks_for_no_loop_of_its_own(asked):
    weight = dt.Weight([[2.0, 0.0], [0.0, 1.0]], [[0.5]])
    law = {"averaged": PAPER.laws["averaged"]}
    loop, engine, tables, _ = prepare(request(law))
    weighed = engines.Engine(dataclasses.replace(loop, weight=weight))
    for one in (engine, weighed):
        one.compile(tables["averaged"])
    assert asked[0] == asked[1]


def test_it_takes_at_least_half_of_the_work_and_the_most_costly_first():
    _, _, tables, _ = prepare(request())
    assert share_of(tables) == {"oracle", "averaged"}
    assert share_of({"mean": tables["mean"]}) == {"mean"}
    assert share_of({name: tables[name] for name in ("mode 0 only", "mode 1 only")}) == {
        "mode 0 only",
        "mode 1 only",
    }
    assert share_of({}) == frozenset()


@pytest.mark.parametrize("reason", ["one processor", "no Python", "frozen", "noise", "not kept"])
def test_there_is_none_where_it_would_be_of_no_use(monkeypatch, reason):
    monkeypatch.setattr(helper, "processors", lambda: 1 if reason == "one processor" else 2)
    monkeypatch.setattr(helper, "is_kept", lambda dispatcher: reason != "not kept")
    if reason == "no Python":
        monkeypatch.setattr(sys, "executable", "")
    if reason == "frozen":
        monkeypatch.setattr(sys, "frozen", True, raising=False)
    one = request(imperfections=(Noise(0.1),) if reason == "noise" else ())
    _, _, tables, _ = prepare(one)
    assert Helper(one, tables).laws == frozenset()
    monkeypatch.undo()
    monkeypatch.setattr(helper, "processors", lambda: 2)
    assert Helper(request(), tables).laws


def test_nobody_waits_for_one_that_has_died_or_does_not_start(monkeypatch):
    monkeypatch.setattr(helper, "processors", lambda: 2)
    one = request()
    _, _, tables, _ = prepare(one)
    dying, none, late = (Helper(one, tables) for _ in range(3))
    monkeypatch.setattr(helper, "is_cached", lambda dispatcher: False)
    dying._start(run_scenarios.dispatcher)
    dying._process.kill()
    dying.wait(lambda: False)
    assert dying._process.returncode != 0
    dying._process.communicate()
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr(sys, "executable", os.devnull)
        none._start(run_scenarios.dispatcher)
    none.wait(lambda: False)
    late.wait(lambda: False)
    late._start(run_scenarios.dispatcher)  # what it would compile is compiled here by now
    assert none._process is late._process is None


def test_who_has_stopped_does_not_wait_and_it_ends_with_the_run(monkeypatch):
    monkeypatch.setattr(helper, "processors", lambda: 2)
    monkeypatch.setattr(helper, "is_cached", lambda dispatcher: False)
    one = request()
    _, _, tables, _ = prepare(one)
    mine = Helper(one, tables)
    with mine.at_hand():
        mine._start(run_scenarios.dispatcher)
        mine.wait(lambda: True)
        assert mine._process.poll() is None
    assert mine._process.returncode is not None


def test_it_ends_with_the_process_that_started_it(tmp_path):
    """Its input is closed then, whatever became of that process."""
    done = subprocess.run(
        [sys.executable, "-m", "deadtime.scenarios.helper"],
        input=pickle.dumps((request(), frozenset(PAPER.laws))),
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
    )
    assert (done.returncode, done.stderr) == (1, b"")
    assert not list(tmp_path.rglob("*run_scenarios*.nbc"))


FIRST_USE = """
    import sys
    from types import SimpleNamespace
    from numba.core import event
    from deadtime.cli.application import main
    from deadtime.scenarios import helper
    helper.processors = lambda: 2
    {}
    with event.install_recorder("numba:compile") as compiled:
        try:
            main(["monte-carlo", "paper", "--scenarios", "20", "--json"])
        finally:
            started = [one.data["dispatcher"] for _, one in compiled.buffer if one.is_start]
            print([one.py_func.__name__ for one in started].count("run_scenarios"), file=sys.stderr)
"""
WAYS = {
    "with a helper": ("", 2),
    "on one processor": ("helper.processors = lambda: 1", 4),
    "with one that dies": ("helper.pickle = SimpleNamespace(dumps=lambda request: b'none')", 4),
}


def first_use(way, folder):
    """What monte-carlo prints, what is on disk, and how many loops are compiled by itself."""
    code, folder = textwrap.dedent(FIRST_USE).format(WAYS[way][0]), folder / way
    folder.mkdir()
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, sorted(file.name for file in folder.rglob("*.nbc")), done.stderr


@pytest.mark.long
def test_first_use_gives_and_leaves_the_same_with_a_helper_and_without(tmp_path):
    found = {way: first_use(way, tmp_path) for way in WAYS}
    assert {way: int(compiled) for way, (*_, compiled) in found.items()} == {
        way: loops for way, (_, loops) in WAYS.items()
    }
    (printed, files, _), *others = found.values()
    assert [(text, names) for text, names, _ in others] == [(printed, files)] * 2
    assert sum("run_scenarios" in name for name in files) == 4
