"""`deadtime loop`."""

import json

import pytest

import deadtime as dt
from deadtime.cli.application import main
from deadtime.margins import loop_view, step_response


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    captured = capsys.readouterr()
    return stopped.value.code, captured.out, captured.err


def test_the_json_is_the_library_s_and_the_picture_is_there(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code, out, _ = run(capsys, "loop", "follower", "--step", "0.05", "--json")
    found, problem = json.loads(out), dt.problems.follower()
    law = problem.law(found["law"])
    view = loop_view(problem.plant, law, 0.05)
    assert code == 0
    assert found["gain_margin"][1] == dt.gain_margin(problem.plant, law, 0.05).upper
    assert found["delay_margin"][1] == dt.delay_margin(problem.plant, law, 0.05).upper
    assert [mode["disk"] for mode in found["modes"]] == [mode.disk for mode in view.modes]
    steps = [step_response(problem.plant, law, mode, 0.05) for mode in range(2)]
    assert [mode["step_info"] for mode in found["modes"]] == [each.info for each in steps]
    assert (tmp_path / found["written"][0]).stat().st_size > 10_000


def test_a_loop_that_grows_is_answered_no(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code, out, _ = run(capsys, "loop", "paper", "--law", "averaged", "--step", "0.05")
    assert code == 1
    assert "There is no gain margin" in out
    code, _, error = run(capsys, "loop", "paper", "--law", "best")
    assert code == 2
    assert "best" in error


def test_an_ideal_loop_has_no_step_that_an_output_could_answer(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    arguments = ["loop", "follower", "--step", "ideal", "--output", "9", "--json"]
    code, out, _ = run(capsys, *arguments)
    assert code == 0
    assert all(mode["step_info"] is None for mode in json.loads(out)["modes"])
    code, _, error = run(capsys, *arguments[:2], "--output", "9")
    assert code == 2
    assert "output must be in 0..2, got 9" in error


def problem_file(A, B, K):
    return f"""
[plant]
A = {A}
B = {B}
delay = 0.5
modes = {["calm", "keen"][: len(A)]}
[gains]
K = {K}
[signal]
kind = "switches"
times = [0.0]
modes = [0]
[run]
x0 = [1.0]
horizon = 5.0
step = 0.05
[[law]]
kind = "delayed"
"""


ONE, BOTH = [[[-1.0]]], [[[-1.0]], [[-2.0]]]


@pytest.mark.parametrize(
    ("A", "B", "K", "there", "absent"),
    [
        (ONE, [[[1.0]]], [[[-5.0]]], [], ["Phase margin –", "load step"]),
        (
            ONE,
            [[[1.0]]],
            [[[-0.5]]],
            ["Phase margin –: none, since the loop gain does not pass 1.", "stays 0.667 off (no"],
            ["calm, since"],
        ),
        (
            BOTH,
            [[[1.0]], [[1.0]]],
            [[[-1.5]], [[-1.0]]],
            [
                "Phase margin –: none in keen, since the loop gain does not pass 1.",
                "x₁ stays up to 0.4 off in calm (no integral action; [servo] on this output",
            ],
            ["none in calm"],
        ),
        # A state in another unit: 1e-9 of the input's effect.
        (ONE, [[[1e-9]]], [[[-0.5e9]]], ["stays 6.67e-10 off (no integral action"], []),
    ],
)
def test_details_name_the_modes_that_they_are_about(
    A, B, K, there, absent, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.toml").write_text(problem_file(A, B, K))
    _, out, _ = run(capsys, "loop", "one.toml")
    words = " ".join(out.split())
    assert [text for text in there if text not in words] == []
    assert [text for text in absent if text in words] == []
