"""A sweep survives killed workers and clients, and uses a cluster elsewhere by its address."""

import asyncio
import gc
import importlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest

import deadtime as dt
from deadtime.scenarios.sweeps.blocks import BlockLayout
from deadtime.scenarios.sweeps.cluster import _reachable, cluster
from deadtime.scenarios.sweeps.store import create
from own_sweep import filled, tree

# Cells take their time in processes that are told so, which are there to be killed.
CELLS = """\
import os
import time

import deadtime as dt


def cell(delay, weight):
    time.sleep(float(os.environ.get("CELL_SECONDS", "0")))
    plant = dt.problems.paper().plant
    plant = dt.SwitchedSystem(plant.A, plant.B, delay)
    laws = {"mine": dt.AveragedPredictor(plant, dt.place(plant, [-1, -2]), [weight, 1.0 - weight])}
    model = dt.Markov([[0, 2], [2, 0]])
    return dict(plant=plant, laws=laws, model=model, x0=[1.0, 0.0], horizon=1.5, step=0.05)


def study():
    grid = {"delay": [0.1, 0.17, 0.3], "weight": [0.1, 0.2, 0.3, 0.4, 0.5]}
    return dt.function_study(cell, grid, scenarios=5)


if __name__ == "__main__":
    import sys

    import cells

    dt.sweep(cells.study(), sys.argv[1], workers=2)
"""


@pytest.fixture(scope="module")
def slow(tmp_path_factory):
    """A study of 15 cells in as many blocks, and the store of an uninterrupted run."""
    folder = tmp_path_factory.mktemp("slow")
    (folder / "cells.py").write_text(CELLS, encoding="utf-8")
    sys.path.insert(0, str(folder))
    study = importlib.import_module("cells").study()
    sys.path.remove(str(folder))
    create(str(folder / "whole.zarr"), study, BlockLayout(study.shape, (1, 1)), {})
    filled(study, folder / "whole.zarr")
    return study, folder


def started(slow, name):
    """The same sweep in a process of its own, some cells of which are done."""
    study, folder = slow
    store = folder / name
    create(str(store), study, BlockLayout(study.shape, (1, 1)), {})
    command = [sys.executable, str(folder / "cells.py"), str(store)]
    client = subprocess.Popen(command, cwd=folder, env=os.environ | {"CELL_SECONDS": "0.25"})
    wait_for(lambda: done(store) >= 3)
    assert client.poll() is None
    return store, client


def done(store):
    return sum(path.is_file() for path in Path(store, "done", "c").rglob("*"))


def wait_for(condition, patience=60.0):
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def kill_a_worker(client):
    """The workers are the processes with the most threads."""
    children = psutil.Process(client.pid).children(recursive=True)
    max(children, key=lambda process: process.num_threads()).kill()


@pytest.mark.long
def test_a_killed_worker_stops_nothing_and_after_a_killed_client_the_next_run_goes_on(slow):
    study, folder = slow
    store, client = started(slow, "client.zarr")
    kill_a_worker(client)
    wait_for(lambda: done(store) >= 7)
    workers = psutil.Process(client.pid).children(recursive=True)
    client.send_signal(signal.SIGKILL)
    client.wait()
    wait_for(lambda: not any(worker.is_running() for worker in workers))
    before = done(store)
    assert 7 <= before < study.size
    seen = []
    dt.sweep(study, store, workers=1, progress=seen.append)
    assert [state.done for state in seen] == list(range(before + 1, study.size + 1))
    assert tree(store) == tree(folder / "whole.zarr")


@pytest.mark.long
def test_a_killed_worker_is_made_up_for(slow):
    _, folder = slow
    store, client = started(slow, "worker.zarr")
    kill_a_worker(client)
    assert client.wait(60.0) == 0
    assert tree(store) == tree(folder / "whole.zarr")


@pytest.mark.long
def test_a_cluster_elsewhere_is_used_by_its_address(slow, tmp_path, monkeypatch):
    from distributed import LocalCluster

    study, folder = slow
    monkeypatch.setattr("deadtime.scenarios.sweeps.cluster._PATIENCE", 0.5)
    create(str(tmp_path / "x.zarr"), study, BlockLayout(study.shape, (1, 1)), {})
    options = {"host": "127.0.0.1", "protocol": "tcp", "dashboard_address": "127.0.0.1:0"}
    with (
        LocalCluster(n_workers=0, processes=False, **options) as empty,
        pytest.raises(dt.ClusterError, match=r"has no workers: start some with .dask worker"),
    ):
        dt.sweep(study, tmp_path / "x.zarr", empty.scheduler_address)
    with LocalCluster(n_workers=1, threads_per_worker=4, processes=False, **options) as remote:
        dt.sweep(study, tmp_path / "x.zarr", remote.scheduler_address)
    assert tree(tmp_path / "x.zarr") == tree(folder / "whole.zarr")


def test_a_scheduler_that_is_not_there_is_named(own, tmp_path, monkeypatch):
    monkeypatch.setattr("deadtime.scenarios.sweeps.cluster._PATIENCE", 0.3)
    with pytest.raises(dt.ClusterError, match=r"'tcp://127\.0\.0\.1:9' cannot be reached"):
        dt.sweep(own[0], tmp_path / "x.zarr", "tcp://127.0.0.1:9")
    with pytest.raises(dt.ClusterError, match=r"'nonsense' cannot be reached"):
        dt.sweep(own[0], tmp_path / "x.zarr", "nonsense")


@pytest.mark.parametrize("status", ["connecting", "closed"])
def test_a_scheduler_that_is_lost_is_named_and_other_errors_are_left_alone(status):
    from distributed import CancelledError
    from distributed.comm import CommClosedError

    client = SimpleNamespace(status=status)
    for error in (CancelledError("block-0"), CommClosedError("closed"), RuntimeError("no loop")):
        said = r"'tcp://one:1' was lost: what is stored is kept; start .* run the same command"
        with pytest.raises(dt.ClusterError, match=said), _reachable(client, "tcp://one:1"):
            raise error
        client.status = "running"
        with pytest.raises(type(error)), _reachable(client, "tcp://one:1"):
            raise error
        client.status = status
    with pytest.raises(dt.StoreError, match="full"), _reachable(client, "tcp://one:1"):
        raise dt.StoreError("full")


@pytest.mark.long
def test_after_a_killed_scheduler_the_sweep_ends_by_an_error_and_the_next_one_goes_on(
    slow, tmp_path
):
    study, folder = slow
    place, store = tmp_path / "scheduler.json", tmp_path / "killed.zarr"
    create(str(store), study, BlockLayout(study.shape, (1, 1)), {})

    def start(kind, *options):
        command = [sys.executable, "-m", "dask", kind, "--scheduler-file", str(place)]
        env = os.environ | {"CELL_SECONDS": "0.3"}
        return subprocess.Popen([*command, "--no-dashboard", *options], cwd=folder, env=env)

    scheduler = start("scheduler", "--host", "127.0.0.1", "--port", "0")
    worker = start("worker", "--no-nanny", "--nthreads", "1", "--local-directory", str(tmp_path))
    try:
        wait_for(place.exists)
        address = json.loads(place.read_text(encoding="utf-8"))["address"]
        with pytest.raises(dt.ClusterError, match=rf"'{address}' was lost: what is stored is kept"):
            dt.sweep(study, store, address, progress=lambda _: scheduler.kill())
    finally:
        for process in (scheduler, worker):
            process.kill()
            process.wait()
    assert 1 <= done(store) < study.size
    dt.sweep(study, store, workers=1)
    assert tree(store) == tree(folder / "whole.zarr")


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.long)])
def test_waits_that_the_end_of_a_cluster_cuts_off_are_not_reported(workers, capfd, caplog):
    def forsake():
        for error in (TimeoutError("of Dask's own"), OSError("of somebody else")):
            asyncio.get_running_loop().create_future().set_exception(error)
        gc.collect()

    with cluster(None, workers) as client:
        client.run(forsake)
        client.loop.add_callback(forsake)
    seen = capfd.readouterr().err + caplog.text
    assert "of Dask" not in seen
    assert seen.count("OSError: of somebody else") == workers + 1
