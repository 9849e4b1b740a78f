"""A log that is dropped on the page becomes a problem, and hostile ones change nothing."""

import html
import re
import shlex
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.app import uploaded_log
from deadtime.app.documents import open_named
from deadtime.app.file_upload import FileUpload
from deadtime.app.jobs import try_log
from deadtime.app.log_card import HIDDEN, INPUT, MODE, ONE, STATE, UNUSED, LogForm
from deadtime.app.page import Page
from deadtime.app.uploaded_log import (
    MOST_ROWS,
    IdentifiedPlant,
    LogRequest,
    details_html,
    identified_html,
    look_at,
    open_log,
)
from deadtime.app.workers import TooLongError
from deadtime.cli import main
from deadtime.problems import load_problem
from synthetic_logs import Plant, oscillator

H = 0.05
MOTOR = Path(__file__).parents[2] / "examples" / "logs" / "motor.csv"


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


def opened(name, content, folder):
    """A log as a page opens it whose columns have the usual names."""
    return open_log(name, content, folder, look_at(name, content, folder).guess)


@pytest.mark.parametrize("per_mode", [False, True])
def test_delays_are_said_by_the_names_of_inputs_and_modes(per_mode, tmp_path):
    """As on the page their own sentences are left out."""
    rng, t = np.random.default_rng(0), H * np.arange(400)
    plant = Plant([[[-1.0]], [[-3.0]]], [[[1.0, 0.5]], [[2.0, 0.5]]], [[0.112, 0.163]])
    mode = np.arange(t.size) // 20 % 2
    x, u = plant.log(t, rng.standard_normal((t.size, 2)), rng, mode, sensor=1e-4)
    columns = {"t": t, "x1": x[:, 0], "u1: hot": u[:, 0], "u2: <b>": u[:, 1]}
    table = pd.DataFrame(columns | {"mode": np.array(["dry", "wet"])[mode]})
    content = table.to_csv(index=False).encode()
    asked = look_at("tank.csv", content, tmp_path).guess._replace(per_mode=per_mode)
    found, fit = open_log("tank.csv", content, tmp_path, asked)
    names = [one[0] for one in found.delays]
    if per_mode:
        assert names == [
            f"delay of {u} in mode {i}" for i in ("dry", "wet") for u in ("hot", "<b>")
        ]
    else:
        assert names == ["delay of hot", "delay of <b>"]
    assert [one[1] for one in found.delays] == fit.delays[: 1 + per_mode].ravel().tolist()
    assert "Delay of hot" in identified_html(found)
    assert "Delay of &lt;b&gt;" in identified_html(found)


def test_a_delay_that_is_not_found_has_no_number_on_the_page(tmp_path):
    rng, t = np.random.default_rng(0), H * np.arange(300)
    x, u = Plant([[[-1.0]]], [[[1.0]]], [[0.312]]).log(t, rng.choice([-1.0, 1.0], (300, 1)), rng)
    content = pd.DataFrame({"t": t, "x1": x[:, 0], "u1": u[:, 0]}).to_csv(index=False).encode()
    asked = look_at("tank.csv", content, tmp_path).guess._replace(delay=(0.0, 0.3115))
    found, fit = open_log("tank.csv", content, tmp_path, asked)
    assert fit.delays_not_found == ("delay",)
    page = identified_html(found)
    assert "Delay not found</div>" in page
    assert "at 95&nbsp;%" not in page
    assert all("Nothing is known of the delay" in one for one in found.verdicts)


def test_a_log_becomes_the_problem_that_identify_makes(log, tmp_path):
    path = tmp_path / "own.csv"
    path.write_bytes(log)
    fit = dt.identify(path, delay=(0.0, 2.0))
    folder = tmp_path / "empty"
    folder.mkdir()
    found, _ = opened("../../drive <b>.csv", log, folder)
    assert not list(folder.iterdir())
    assert found.document.name == "drive b"
    assert found.document.draft["plant"]["A"] == fit.plant.A.tolist()
    assert found.document.draft["plant"]["delay"] == fit.delays[0, 0]
    assert found.sentences[: len(fit.sentences)] == fit.sentences
    assert len(found.verdicts) == 2
    assert all("Of 100 plants drawn" in one for one in found.verdicts)
    low, high = fit.interval("delay")
    assert found.delays == (("delay", fit.delays[0, 0], low, high),)
    page = identified_html(found)
    assert f"Delay <b>{fit.delays[0, 0]:.4g} s</b>" in page
    assert f"({low:.5g} … {high:.5g} s at 95&nbsp;%)" in page
    more = details_html(found)
    assert f"<td>delay</td><td>{fit.delays[0, 0]:.5g}</td><td>{low:.5g}</td><td>{high:.5g}" in more
    assert more.count("data:image/png;base64,") == 3
    assert "<img src=x>" not in page + more


def test_the_likelihood_comes_last_so_that_nothing_is_lost_if_it_takes_too_long(log):
    told = []
    picture, report = try_log(
        "drive.csv", log, LogRequest(("x1", "x2"), ("u1",), "mode", (0.0, 1.0)), told.append
    )
    assert picture.name == "likelihood"
    assert picture.image in report.decode()
    said = [one for one in told if isinstance(one, str)]
    assert said[:2] == ["reading the log", "looking for the delay between 0 and 1 s"]
    (place,) = (i for i, one in enumerate(told) if not isinstance(one, str))
    found, seconds = told[place]
    assert told[place + 1 :] == ["drawing how likely every delay is"]
    assert [one.name for one in found.pictures] == ["predictions", "whiteness", "inputs"]
    assert seconds < 5.0


@pytest.mark.long
def test_a_page_that_is_given_a_log_shows_its_plant(log, workers):
    page = Page(open_named("paper"), workers)
    assert not page.log.view.visible
    page.upload_log("drive.csv", log)
    wait(lambda: "as a problem" in page.message.object or page.message.severity == "error")
    assert page.message.severity == "info"
    assert "likelihood" in page.log.likelihood.object
    assert page.outcome.problem.modes == ("<img src=x>", 'say "no"')
    assert abs(page.outcome.problem.plant.delays[0, 0] - 0.312) < 2e-3
    page.open(open_named("paper"))
    assert not page.log.view.visible


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"x" * (uploaded_log.MOST_BYTES + 1), "has 16.0 MB, a page takes logs of at most 16 MB"),
        (b"t,x,u\n" + b"0,0,0\n" * (MOST_ROWS + 1), "more than 200,000 rows"),
        (b"t," + b",".join(b"c%d" % i for i in range(41)) + b"\n", "offers at most 40"),
        (b"t,x,x ,u\n0,1,1,1\n", r"got \['t', 'x \(column 2\)', 'x \(column 3\)', 'u'\]"),
        (b"", r"log\.csv is no CSV table"),
        (b"\xff\xfe\x00,\x01", r"log\.csv"),
        (b"t,x,u\n0,1,1\n1,2,0\n1,3,1\n", r"log\.csv, line 4: t must be later"),
        (b"when,x,u\n0,1,1\n1,2,0\n2,1,0\n", "must have a column t"),
        (b't,x,u\n0,"1,1\n', r"log\.csv"),
        (
            b"t,x,u\n0,1,1,5\n1,2,0,6\n2,3,1,7\n",
            "line 2 has 4 cells, and the header",
        ),
        (b"t,x,u\n0,1e999,1\n1,2,0\n2,3,1\n", "line 2: x must be a finite number, got '1e999'"),
    ],
)
def test_hostile_and_malformed_logs_are_refused_by_name(content, said, tmp_path):
    with pytest.raises(dt.ArgumentError, match=said) as refused:
        opened("../log.csv", content, tmp_path)
    assert str(tmp_path) not in str(refused.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("stamp", ["2026-03-02T08:15:0{}Z", "2026-03-02 08:15:0{}", "8:15:0{}"])
def test_stamps_are_read_at_a_look_or_refused_in_the_words_of_identify(stamp, tmp_path):
    rows = "".join(f"{stamp.format(i)},{i},{i % 2}\n" for i in range(8))
    text = f"t,x1,u1\n{rows}"
    assert look_at("log.csv", text.encode(), tmp_path).step == 1.0
    text += "noon,1,2\n"
    (tmp_path / "own").mkdir()
    with pytest.raises(dt.ArgumentError, match="line 10: t must be a number or a st") as at_a_look:
        look_at("log.csv", text.encode(), tmp_path)
    path = tmp_path / "own" / "log.csv"
    path.write_text(text)
    with pytest.raises(dt.ArgumentError) as later:
        dt.identify(path, None)
    assert str(later.value).replace(str(path), "log.csv") == str(at_a_look.value)


def test_a_log_that_is_refused_changes_nothing(own, workers):
    page = Page(own, workers)
    before = page.outcome
    page.upload_log("log.csv", b"t,x,u\n0,1,1\n1,2,0\n1,3,1\n")
    wait(lambda: page.message.severity == "error")
    assert re.search("line 4: t must be later.*Nothing was changed", page.message.object)
    assert page.outcome is before
    page.upload_log("log.csv", b"x" * (uploaded_log.MOST_BYTES + 1))
    assert "at most 16 MB" in page.message.object


def test_a_plant_of_a_log_that_takes_too_long_to_run_is_for_the_command(own, workers):
    page = Page(own, workers)
    before = page.outcome
    page.log._on_progress((IdentifiedPlant(page.document, (), (), (), (), ()), 9.0))
    assert re.search(
        r"The plant of \w+\.csv takes 9\.0 s .* use `deadtime identify`", page.message.object
    )
    assert page.outcome is before


def test_a_log_that_takes_too_long_says_what_to_do_and_keeps_what_was_asked(
    own, workers, monkeypatch, tmp_path
):
    page = Page(own, workers)
    page.upload_log("motor.csv", MOTOR.read_bytes())
    wait(lambda: "Say what the columns of motor.csv are" in page.message.object)
    assert page.log.view.visible
    monkeypatch.setattr(page.log, "_jobs", Refusing(TooLongError("too long")))
    for name, role in (("speed", STATE), ("current", STATE), ("voltage", INPUT)):
        page.log.form.roles[name].value = role
    page.log.form.high.value = 0.1
    page.log.identify()
    said = html.unescape(page.message.object)
    assert "motor.csv takes longer than 120 s" in said
    assert "a narrower range of delays" in said
    assert page.log.view.visible
    assert not page.log.begin.disabled
    assert page.log.form.request().delay == (0.0, 0.1)
    command = re.search(r"without a limit: (deadtime .*) Nothing was changed", said)[1]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "motor.csv").write_bytes(MOTOR.read_bytes())
    with pytest.raises(SystemExit) as ended:
        main(shlex.split(command)[1:])
    assert not ended.value.code
    names = {"states": ["speed", "current"], "inputs": ["voltage"]}
    fit = dt.identify(MOTOR, "arm", (0.0, 0.1), **names)
    assert load_problem(tmp_path / "motor.toml").plant.A.tolist() == fit.plant.A.tolist()


class Refusing:
    """BackgroundJobs of which every one fails."""

    def __init__(self, error):
        self.error = error

    def begin(self, limit, done, failed, *job, **more):
        failed(self.error)


def test_what_is_cancelled_leaves_the_log_to_be_asked_again(own, workers):
    page = Page(own, workers)
    rows = np.random.default_rng(0).standard_normal((3000, 4))
    table = pd.DataFrame(rows, columns=["x1", "x2", "x3", "u1"])
    table.insert(0, "t", 0.1 * np.arange(3000))
    page.upload_log("noise.csv", table.to_csv(index=False).encode())
    wait(lambda: "Identifying the plant" in page.message.object)
    assert page.log.cancel.visible
    page.log.stop()
    assert "Cancelled. Nothing was changed." in page.message.object
    assert not page.log.cancel.visible
    assert not page.log.begin.disabled
    assert not page.log.shown.object


def test_the_form_asks_for_what_names_do_not_tell(tmp_path):
    columns = look_at("motor.csv", MOTOR.read_bytes(), tmp_path)
    assert (columns.rows, columns.sure) == (900, False)
    assert columns.numbers == ("speed", "current", "voltage")
    form = LogForm()
    form.fill(columns)
    assert {name: one.value for name, one in form.roles.items()} == {
        "speed": UNUSED, "current": UNUSED, "voltage": UNUSED, "arm": MODE
    }  # fmt: skip
    assert not form.modes.visible
    with pytest.raises(dt.ArgumentError, match="No column is said to be state"):
        form.request()
    form.roles["speed"].value = form.roles["current"].value = STATE
    with pytest.raises(dt.ArgumentError, match="No column is said to be input"):
        form.request()
    form.roles["voltage"].value = INPUT
    assert form.request() == LogRequest(("speed", "current"), ("voltage",), "arm", (0.0, 0.6))
    form.samples.value = form.apart.value = True
    assert form.request()[-2:] == (True, True)
    form.high.value = 0.0
    with pytest.raises(dt.ArgumentError, match="Delay: give a range"):
        form.request()
    form.high.value = 0.5
    form.roles["arm"].value = UNUSED
    assert form.modes.visible
    assert not form.least.visible
    assert form.request().modes is None
    assert not form.request().at_samples
    form.modes.value = HIDDEN
    assert form.least.visible
    assert form.request().modes == (1, 3)
    assert "--modes 1..3" in form.request().command("motor.csv")
    form.least.value = 4
    with pytest.raises(dt.ArgumentError, match="their least number"):
        form.request()
    form.modes.value = ONE
    assert "--one-mode --delay 0 0.5 --out motor.toml" in form.request().command("motor.csv")


@pytest.mark.parametrize(
    ("header", "mode", "sure"),
    [
        ("t,x1,u1,mode", "mode", True),
        ("t,x1,u1,other", None, False),
        ("t,speed,force,mode", "mode", False),
        ("time,x1,x2,u1", None, True),
    ],
)
def test_a_log_is_asked_about_unless_the_names_of_its_columns_tell_all(
    header, mode, sure, tmp_path
):
    rows = "".join(f"{i},{i % 3},{i % 2},{i}\n" for i in range(20))
    columns = look_at("log.csv", f"{header}\n{rows}".encode(), tmp_path)
    assert (columns.guess.modes, columns.sure) == (mode, sure)


def test_only_logs_and_problems_come_in_by_the_door(own, workers):
    page = Page(own, workers)
    taken = []
    chooser = FileUpload(lambda *given: taken.append(given), page.refuse)
    chooser._handle_msg({"name": "a.csv", "size": 3, "content": b"t,x"})
    chooser._handle_msg({"name": "b.csv", "size": 46_000_000, "content": None})
    assert taken == [("a.csv", 3, b"t,x"), ("b.csv", 46_000_000, None)]
    chooser._handle_msg({"count": 2})
    assert "2 files came at once: drop one at a time." in page.message.object
    page.take(*taken[1])
    assert "b.csv has 46.0 MB, a page takes logs of at most 16 MB" in page.message.object
    page.take("c.toml", 2_000_000, None)
    assert "c.toml has 2.0 MB, a problem file at most 1 MB" in page.message.object
    page.take("photo.jpg", 10, b"x")
    assert "photo is neither a problem (.toml) nor a log (.csv)" in page.message.object


@pytest.mark.parametrize(("step", "longest"), [(0.0005, 0.03), (0.05, 2.0)])
def test_the_longest_delay_looked_for_follows_the_period(step, longest, tmp_path):
    table = pd.DataFrame({"t": step * np.arange(50), "x": 0.0, "u": 1.0})
    columns = look_at("log.csv", table.to_csv(index=False).encode(), tmp_path)
    assert columns.guess.delay == (0.0, pytest.approx(longest))
