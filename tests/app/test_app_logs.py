"""A log that is dropped on the page becomes a problem, and hostile ones change nothing."""

import re
import time

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.app import logs
from deadtime.app.documents import open_named
from deadtime.app.logs import MOST_ROWS, FoundPlant, open_log, shown
from deadtime.app.page import Page
from synthetic_logs import oscillator

H = 0.05


@pytest.fixture(scope="module")
def log():
    """Two modes named by somebody hostile; the delay is 0.312 s."""
    rng = np.random.default_rng(0)
    mode = np.repeat(np.arange(40) % 2, rng.integers(6, 14, 40))
    x, u = oscillator().log(
        H * np.arange(mode.size), rng.standard_normal((mode.size, 1)), rng, mode
    )
    columns = {"t": H * np.arange(mode.size), "x1": x[:, 0], "x2": x[:, 1], "u1": u[:, 0]}
    table = pd.DataFrame(columns | {"mode": np.array(["<img src=x>", 'say "no"'])[mode]})
    return table.to_csv(index=False).encode()


def wait(done, seconds=120.0):
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_log_becomes_the_problem_that_identify_makes(log, tmp_path):
    path = tmp_path / "own.csv"
    path.write_bytes(log)
    fit = dt.identify(path, delay=(0.0, 2.0))
    folder = tmp_path / "empty"
    folder.mkdir()
    found = open_log("../../drive <b>.csv", log, folder)
    assert not list(folder.iterdir())
    assert found.document.name == "drive b"
    assert found.document.draft["plant"]["A"] == fit.plant.A.tolist()
    assert found.document.draft["plant"]["delay"] == fit.delays[0, 0]
    assert found.sentences[1 : 1 + len(fit.sentences)] == fit.sentences
    assert "Of 100 plants drawn" in found.sentences[-1]
    page = shown(found)
    low, high = fit.interval("delay")
    assert f"<td>delay</td><td>{fit.delays[0, 0]:.5g}</td><td>{low:.5g}</td><td>{high:.5g}" in page
    assert "data:image/png;base64," in page
    assert "<img src=x>" not in page


@pytest.mark.long
def test_a_page_that_is_given_a_log_shows_its_plant(log, workers):
    page = Page(open_named("paper"), workers)
    assert not page.found.visible
    page.upload_log("drive.csv", log)
    wait(lambda: page.found.visible or page.message.severity == "error")
    assert "as a problem" in page.message.object
    assert page.outcome.problem.modes == ("<img src=x>", 'say "no"')
    assert abs(page.outcome.problem.plant.delays[0, 0] - 0.312) < 2e-3
    page.open(open_named("paper"))
    assert not page.found.visible


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"x" * (logs.MOST_BYTES + 1), "has 4.0 MB, a page takes logs of at most 4 MB"),
        (b"t,x,u\n" + b"0,0,0\n" * (MOST_ROWS + 1), "more than 20,000 rows"),
        (b"", r"log\.csv is no CSV table"),
        (b"\xff\xfe\x00,\x01", r"log\.csv"),
        (b"t,x,u\n0,1,1\n1,2,0\n1,3,1\n", r"log\.csv, line 4: t must be later"),
        (b"when,x,u\n0,1,1\n1,2,0\n2,1,0\n", "must have a column t"),
        (b't,x,u\n0,"1,1\n', r"log\.csv"),
        (b"t,x,u\n0,1,1,5\n1,2,0,6\n2,3,1,7\n", "rows have more columns than its header names"),
        (b"t,x,u\n0,1e999,1\n1,2,0\n2,3,1\n", "line 2: x must be a finite number, got inf"),
    ],
)
def test_hostile_and_malformed_logs_are_refused_by_name(content, said, tmp_path):
    with pytest.raises(dt.ArgumentError, match=said) as refused:
        open_log("../log.csv", content, tmp_path)
    assert str(tmp_path) not in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_a_log_that_is_refused_changes_nothing(own, workers):
    page = Page(own, workers)
    before = page.outcome
    page.upload_log("log.csv", b"t,x,u\n0,1,1\n1,2,0\n1,3,1\n")
    wait(lambda: page.message.severity == "error")
    assert re.search("line 4: t must be later.*Nothing was changed", page.message.object)
    assert page.outcome is before
    assert not page.found.visible
    page.upload_log("log.csv", b"x" * (logs.MOST_BYTES + 1))
    assert "at most 4 MB" in page.message.object


def test_a_plant_of_a_log_that_takes_too_long_to_run_is_for_the_command(own, workers, monkeypatch):
    page = Page(own, workers)
    found = FoundPlant(page.document, (), (), b"")
    monkeypatch.setattr(page, "elsewhere", lambda limit, done, *rest: done((found, 9.0)))
    page.upload_log("log.csv", b"t,x,u\n")
    assert re.search(
        r"The plant of \w+\.csv takes 9\.0 s .* use `deadtime identify`", page.message.object
    )
    assert not page.found.visible


@pytest.mark.parametrize(("step", "longest"), [(0.0005, 0.03), (0.05, 2.0)])
def test_the_longest_delay_looked_for_follows_the_period(step, longest, tmp_path):
    path = tmp_path / "log.csv"
    pd.DataFrame({"t": step * np.arange(50), "x": 0.0, "u": 1.0}).to_csv(path, index=False)
    assert logs._look(path) == (False, pytest.approx(longest))
