"""The command `deadtime sweep` says what there is to do, how far it came, and what went wrong."""

import json
from contextlib import nullcontext
from pathlib import Path

import pytest

from deadtime.cli.application import main
from deadtime.cli.sweep import Lines
from deadtime.scenarios.sweeps import Progress
from own_sweep import STUDY, load


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a part of the study, where commands run."""
    monkeypatch.chdir(tmp_path)
    few = STUDY.replace("12", "3").replace("[0.234, 0.31]", "[0.31]")
    load(tmp_path, few.replace("[-0.1, 0.0, 0.1]", "[0.0, 0.1]"))


def ran(*arguments):
    with pytest.raises(SystemExit) as stopped:
        main(["sweep", *arguments])
    return stopped.value.code


@pytest.mark.usefixtures("here")
def test_the_command_says_what_there_is_to_do_and_does_it(capsys):
    assert ran("study.toml", "--dry-run") == 0
    said = capsys.readouterr().out
    assert "4 cells (1 plant.delay × 2 law.told.dwell_time × 2 delay_error), 3 signals" in said
    assert "not there yet" in said
    assert "To do: 48 runs in 1 block of cells, about 1 s of one core like this one" in said
    assert "(4 cells timed)" in said
    assert not Path("study.zarr").exists()
    assert ran("study.toml", "--workers", "1") == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert captured.out.endswith("Store: study.zarr. Next: deadtime plot study.zarr\n")
    assert ran("study.toml", "--status", "--json") == 0
    plan = json.loads(capsys.readouterr().out)
    assert (plan["cells"], plan["done"], plan["missing"], plan["runs"]) == (4, 4, 0, 0)
    files = sum(path.is_file() for path in Path("study.zarr").rglob("*/c/**/*"))
    assert files <= plan["objects"] + 5  # and the coordinates


@pytest.mark.usefixtures("here")
def test_the_command_lists_what_went_wrong_law_by_law(capsys):
    text = Path("study.toml").read_text(encoding="utf-8").replace("[0.1, 0.15]", "[0.1, -1.0]")
    Path("study.toml").write_text(text, encoding="utf-8")
    assert ran("study.toml", "--store", "own name.zarr", "--workers", "1", "--scenarios", "2") == 0
    said = capsys.readouterr().out
    assert "• told: in 2 of 4 cells, such as: dwell_time" in said
    assert "averaged: in" not in said


@pytest.mark.long
@pytest.mark.usefixtures("here")
def test_interrupted_the_command_says_how_far_it_came_and_ends_with_130(monkeypatch, capsys):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("deadtime.cli.sweep.progress_of", lambda *_, **__: nullcontext(interrupt))
    assert ran("study.toml", "--workers", "1") == 130
    assert capsys.readouterr().err == (
        "deadtime: interrupted after 4 of 4 cells; the same command continues\n"
    )


def test_progress_on_a_cluster_is_a_line_now_and_then(capsys):
    lines = Lines(10.0)
    for seconds in (1.0, 2.0, 11.5, 12.0):
        lines(Progress(5, 20, 4, seconds, 4.0 * seconds, 8, 2.0, 8.0))
    lines(Progress(20, 20, 19, 30.0, 120.0, 8, 8.0, 8.0))
    assert capsys.readouterr().err.splitlines() == [
        "5 of 20 cells, 4 cells/s on 8 threads, about 3 s left",
        "5 of 20 cells, 0.348 cells/s on 8 threads, about 34 s left",
        "20 of 20 cells, 0.633 cells/s on 8 threads, done in 30 s",
    ]


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("none.toml",), "none.toml cannot be read"),
        (("study.toml", "--scenarios", "0"), "scenarios must be an integer of at least 1"),
        (("study.toml", "--workers", "0"), "workers must be an integer of at least 1"),
        (("study.toml", "--store", "study.toml"), "study.toml"),
        (
            ("study.toml", "--store", "/proc/x.zarr", "--workers", "1"),
            "'/proc/x.zarr' cannot be written",
        ),
    ],
)
@pytest.mark.usefixtures("here")
def test_bad_requests_get_one_line_and_code_2(capsys, arguments, message):
    assert ran(*arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert message in error
