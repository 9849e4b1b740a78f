"""A job that hangs, dies or fails spoils no other."""

import gc
import math
import os
import signal
import time
import weakref
from pathlib import Path

import pytest

import deadtime as dt
from deadtime.app.documents import open_named
from deadtime.app.settings import GivenSignal


@pytest.mark.long
def test_a_job_that_takes_too_long_is_stopped_and_the_next_one_runs(workers):
    began = time.monotonic()
    with pytest.raises(dt.ArgumentError, match=r"takes longer than 0\.5 s, and was stopped"):
        workers.submit(0.5, time.sleep, 60.0).result()
    assert time.monotonic() - began < 30.0
    assert workers.submit(5.0, math.sqrt, 4.0).result() == 2.0


@pytest.mark.long
def test_a_process_that_dies_is_replaced(workers):
    with pytest.raises(dt.ArgumentError, match="ended its process"):
        workers.submit(5.0, os._exit, 1).result()
    assert workers.submit(5.0, math.sqrt, 9.0).result() == 3.0


@pytest.mark.long
def test_a_job_that_nobody_waits_for_is_stopped_and_the_next_one_runs(workers):
    began = time.monotonic()
    running, waiting = (
        workers.submit(60.0, time.sleep, 50.0),
        workers.submit(60.0, time.sleep, 50.0),
    )
    while not running.running():
        time.sleep(0.01)
    workers.stop(waiting)
    workers.stop(running)
    assert waiting.cancelled()
    with pytest.raises(dt.ArgumentError, match="was stopped"):
        running.result()
    assert workers.submit(30.0, math.sqrt, 4.0).result() == 2.0
    assert time.monotonic() - began < 40.0
    workers.stop(running)  # over already: nothing happens
    assert workers.submit(30.0, math.sqrt, 9.0).result() == 3.0


def kill_the_idle(workers, how):
    (worker,) = workers._all
    os.kill(worker._process.pid, how)
    worker._process.join()


def test_an_idle_process_that_dies_costs_no_job(workers):
    assert workers.submit(30.0, math.sqrt, 9.0).result() == 3.0
    kill_the_idle(workers, signal.SIGKILL)
    assert workers.submit(30.0, math.sqrt, 4.0).result() == 2.0


@pytest.mark.long
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_neither_do_two_in_a_row_nor_one_that_is_still_loading(workers, how):
    kill_the_idle(workers, how)
    waiting = workers.submit(30.0, math.sqrt, 4.0)
    while not (alive := [one for one in list(workers._doing.values()) if one.alive]):
        time.sleep(0.001)  # the one that was killed is tried first
    (worker,) = alive
    os.kill(worker._process.pid, how)
    assert waiting.result() == 2.0


@pytest.mark.long
def test_where_no_process_lives_a_job_says_so_and_the_next_one_runs(workers, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("deadtime.app.workers._serve", os._exit)
        kill_the_idle(workers, signal.SIGKILL)
        with pytest.raises(dt.ArgumentError, match="no process begins that: 3 ended"):
            workers.submit(30.0, math.sqrt, 4.0).result()
    kill_the_idle(workers, signal.SIGKILL)
    assert workers.submit(30.0, math.sqrt, 4.0).result() == 2.0


def test_a_job_that_is_stopped_while_it_waits_leaves_nothing_of_it(workers):
    class GivenSignal:
        """What no other process could read."""

    worker = workers._idle.get()  # all are busy
    try:
        first, given = workers.submit(30.0, math.sqrt, 4.0), GivenSignal()
        waiting = workers.submit(30.0, math.sqrt, given)
        seen = weakref.ref(given)
        workers.stop(waiting)
        assert waiting.cancelled()
        del given, waiting
        gc.collect()
        assert seen() is None
    finally:
        workers._idle.put(worker)
    assert first.result() == 2.0


def test_errors_of_jobs_come_back(workers):
    with pytest.raises(dt.ArgumentError, match=r"ValueError: (math|expected)"):
        workers.submit(5.0, math.sqrt, -1.0).result()


def test_given_signals_and_seeds_are_plain_data():
    assert GivenSignal((0.0,), (0,)).about == ""
    assert Path(open_named("paper").source).name == "paper.toml"
