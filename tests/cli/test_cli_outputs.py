"""Files that commands write: named rightly before the work, whole or not at all, once for all."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
from importlib import import_module
from pathlib import Path

import pytest

import deadtime as dt
from deadtime.base.files import replacing
from deadtime.cli.application import main

SMALL = """
[plant]
delay = 0.2
A = [[[0.5]], [[0.2]]]
B = [[[1.0]], [[1.1]]]
[gains]
poles = [-2.0]
[signal]
kind = "switches"
times = [0.0, 1.0]
modes = [0, 1]
[run]
x0 = [1.0]
horizon = 4.0
step = 0.1
"""
# Every option that names one file, with what its command needs besides.
FILES = {
    "init": ["init", "--force", "--path"],
    "simulate": ["simulate", "small.toml", "--out"],
    "csv": ["simulate", "small.toml", "--csv"],
    "certify": ["certify", "small.toml", "--out"],
    "robustness": ["robustness", "small.toml", "--out"],
    "loop": ["loop", "small.toml", "--out"],
    "monte-carlo": ["monte-carlo", "small.toml", "--out"],
    "data": ["monte-carlo", "small.toml", "--data"],
    "design": ["design", "small.toml", "--out"],
    "fmu": ["export", "small.toml", "--fmu"],
    "fit": ["fit", "log.csv", "--out"],
    "experiment": ["experiment", "small.toml", "--input-limit", "1", "--out"],
    "identify": ["identify", "log.csv", "--out"],
    "figure": ["identify", "log.csv", "--figure"],
    "report": ["identify", "log.csv", "--report"],
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(SMALL, encoding="utf-8")
    (tmp_path / "log.csv").write_text("time,mode\n0,0\n1,1\n", encoding="utf-8")
    return tmp_path


def code_of(*arguments):
    with pytest.raises(SystemExit) as stopped:
        main(list(arguments))
    return stopped.value.code


@pytest.mark.parametrize("command", FILES.values(), ids=FILES)
@pytest.mark.parametrize("name", ["", ".", "/", ".."])
def test_what_names_no_file_is_refused_before_the_work(folder, capsys, command, name):
    before = sorted(folder.iterdir()), sorted(Path("/").iterdir())
    *rest, option = command
    assert code_of(*rest, f"{option}={name}") == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("deadtime: error: ")
    assert captured.err.count("\n") == 1
    assert (sorted(folder.iterdir()), sorted(Path("/").iterdir())) == before


@pytest.mark.parametrize("command", ["simulate", "loop", "robustness", "fit"])
def test_the_ending_of_a_figure_is_checked_before_the_work(folder, capsys, monkeypatch, command):
    def worked(*_, **__):
        raise AssertionError("the work began")

    monkeypatch.setattr("deadtime.problems.comparison.compare", worked)
    monkeypatch.setattr(import_module("deadtime.margins.loop_view"), "loop_view", worked)
    monkeypatch.setattr("deadtime.margins.robustness", worked)
    monkeypatch.setattr(dt.SwitchingSignal, "from_csv", worked)
    assert code_of(*FILES[command], "run.xyz") == 2
    assert "must end in .png or .svg or .pdf or .pgf, got 'run.xyz'" in capsys.readouterr().err


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_a_file_that_is_not_made_whole_leaves_the_old_one_and_nothing_beside_it(tmp_path, error):
    target = tmp_path / "a.csv"
    target.write_text("old")
    target.chmod(0o640)
    expected = KeyboardInterrupt if error is KeyboardInterrupt else dt.ArgumentError

    def stopped():
        with replacing(target, "csv") as place:
            place.write_text("half")
            raise error

    with pytest.raises(expected):
        stopped()
    assert (target.read_text(), [one.name for one in tmp_path.iterdir()]) == ("old", ["a.csv"])
    with replacing(target) as place:
        place.write_text("new")
    assert (target.read_text(), target.stat().st_mode & 0o777) == ("new", 0o640)


def test_a_link_stays_a_link_and_a_pipe_is_written_to(tmp_path):
    real, link, pipe = tmp_path / "real.txt", tmp_path / "link.txt", tmp_path / "pipe"
    real.write_text("old")
    link.symlink_to(real)
    with replacing(link) as place:
        place.write_text("new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    os.mkfifo(pipe)
    got = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_text()))
    reader.start()
    with replacing(pipe) as place:
        place.write_text("through")
    reader.join()
    assert got == ["through"]


def test_who_reads_while_many_write_sees_whole_files(tmp_path):
    target, texts = tmp_path / "a.txt", [letter * 100_000 for letter in "abcd"]

    def write(text):
        for _ in range(20):
            with replacing(target) as place:
                place.write_text(text)

    write(texts[0])
    writers = [threading.Thread(target=write, args=(text,)) for text in texts]
    for one in writers:
        one.start()
    seen = {target.read_text() for _ in range(100)}
    for one in writers:
        one.join()
    assert seen <= set(texts)
    assert [one.name for one in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize("ending", [".png", ".svg", ".pdf"])
def test_a_figure_on_a_full_disk_is_one_line(folder, capsys, ending):
    (folder / f"full{ending}").symlink_to("/dev/full")
    assert code_of("simulate", "small.toml", "--out", f"full{ending}") == 2
    line = f"figure 'full{ending}' cannot be written: No space left on device."
    assert capsys.readouterr().err == f"deadtime: error: {line}\n"


# -- processes -----------------------------------------------------------------------------------

EARLY = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)

class Interrupts:
    def find_spec(self, name, *_):
        if name == "{module}":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupts())
import atexit
if "{module}" == "the end":
    atexit.register(os.kill, os.getpid(), signal.SIGINT)
from deadtime.__main__ import main
sys.argv = ["deadtime", "bound", "paper"]
main()
"""


@pytest.mark.parametrize("module", ["cyclopts", "numpy", "the end"])
def test_ctrl_c_while_modules_load_and_at_the_end_is_one_line(tmp_path, module):
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    command = [sys.executable, "-c", EARLY.format(module=module)]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (130, "deadtime: interrupted\n")
    assert bool(result.stdout) == (module == "the end")


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_json_with_closed_streams_is_no_error(tmp_path, closed):
    line = f'"{sys.executable}" -m deadtime init x.toml --json {closed}'
    assert subprocess.run(["sh", "-c", line], cwd=tmp_path).returncode == 0
    assert (tmp_path / "x.toml").exists()


@pytest.mark.parametrize("columns", ["0", "00", "", "1", "-5", "many"])
def test_no_width_of_the_terminal_stops_a_page(monkeypatch, capsys, columns):
    monkeypatch.setenv("COLUMNS", columns)
    monkeypatch.setenv("LINES", columns)
    with contextlib.suppress(SystemExit):
        main(["--help"])
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "monte" in captured.out.replace("\n", "") or columns == "1"
