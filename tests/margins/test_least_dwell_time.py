"""The least dwell time: between a proof and a signal that grows, on plants where both are known."""

import json
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

import deadtime as dt
import exponential_products as products
from deadtime.base.errors import ArgumentError
from deadtime.cli.application import main
from deadtime.margins import dwell_time as module
from deadtime.margins.stability import Questions, bracket

TURNING = np.array([[[0.0, 1.0], [-10.0, -1.0]], [[0.0, 1.0], [-0.1, -0.5]]])
PLANT = dt.SwitchedSystem(TURNING, np.ones((2, 2, 1)), 0.3)
IDLE = dt.AveragedPredictor(PLANT, np.zeros((2, 1, 2)), allow_unstable=True)


@pytest.mark.long
def test_the_least_dwell_time_of_two_modes_that_turn_lies_in_a_narrow_bracket():
    turn = 2.0 * np.pi / math.sqrt(10.0)
    limit = products.critical(
        lambda T: products.worst_multiplier(TURNING, [T] * 2, [T + turn] * 2), 6.0, 2.0
    )
    assert limit == pytest.approx(2.70775, abs=1e-4)
    found = dt.least_dwell_time(PLANT, IDLE, 0.01)
    assert 2.69 <= found.refuted <= limit <= found.certified <= 2.77
    assert found.ratio == found.certified / found.refuted
    assert (found.proven, found.certificate.stable) == (True, True)
    assert found.certificate.evidence.setting.signals.dwell_time == pytest.approx(found.certified)
    cycle = list(zip(found.witness.modes, found.witness.sojourns, strict=True))
    assert products.multiplier(TURNING, cycle) > 1.0
    assert min(found.witness.sojourns) == found.refuted
    said = re.search(r"dwell time of (\S+) s or more; with (\S+) s a growing", found.message)
    proved, grows = map(float, said.groups())
    assert found.certified <= proved <= found.certified * 1.0002
    assert found.refuted * 0.9998 <= grows <= found.refuted
    times, answers = zip(*found.evaluations, strict=True)
    assert list(times) == sorted(times)
    assert [answer for answer in answers if answer is not None] == sorted(
        answer for answer in answers if answer is not None
    )  # refuted below, proved above


@pytest.mark.long
def test_a_common_lyapunov_function_proves_every_dwell_time_above_a_period():
    plant = dt.SwitchedSystem([[[-1.0]], [[-2.0]]], np.ones((2, 1, 1)), 0.1)
    law = dt.AveragedPredictor(plant, np.zeros((2, 1, 1)), allow_unstable=True)
    found = dt.least_dwell_time(plant, law, 0.1)
    assert found.certified == pytest.approx(0.1, rel=1e-3)
    assert (found.refuted, found.ratio, found.witness) == (None, None, None)
    assert "the shortest that can be described at this period" in found.message


def test_dwell_times_in_proportion_are_tried_only_up_to_the_longest_that_can_be_described(
    monkeypatch,
):
    monkeypatch.setattr(module, "MOST_ROUNDED", 100.0)
    plant = dt.SwitchedSystem([[[-1.0]], [[-2.0]]], np.ones((2, 1, 1)), 0.1)
    law = dt.AveragedPredictor(plant, np.zeros((2, 1, 1)), allow_unstable=True)
    found = dt.least_dwell_time(plant, law, 0.1, dwell_time=[0.1, 0.5])
    assert found.evaluations[-1][0] == pytest.approx(100.0 * 0.1 / 5.0)
    assert found.certified_each == pytest.approx((found.certified, 5.0 * found.certified))


def test_no_answer_near_the_period_does_not_hide_the_proofs_beyond_it():
    calm = SimpleNamespace(grows=False)

    def certify(value):
        return SimpleNamespace(stable=True if value < 1.0 else None, message="not found")

    ask = Questions(lambda _: False, certify, lambda _: calm)
    found = bracket(ask, 0.045, 20.0, 1.05)
    assert 0.9 <= found.certified < 1.0
    assert found.open[0] <= 1.06


def test_no_dwell_time_is_long_enough_for_a_constant_mode_that_grows():
    plant = dt.SwitchedSystem(-np.eye(2) * [[[1.0]], [[-0.1]]], np.ones((2, 2, 1)), 0.3)
    law = dt.AveragedPredictor(plant, np.zeros((2, 1, 2)), allow_unstable=True)
    found = dt.least_dwell_time(plant, law, 0.1)
    assert (found.certified, found.refuted, found.ratio) == (None, math.inf, None)
    assert found.witness.growth_rate == pytest.approx(0.1, rel=1e-3)
    assert found.message == (
        "No dwell time is long enough: held in mode 1 the loop grows at +0.1 1/s."
    )


def test_where_nothing_is_proved_the_answer_is_a_refuted_dwell_time_and_a_reason(monkeypatch):
    monkeypatch.setattr(module, "DOUBLINGS", 0)
    monkeypatch.setattr(module, "CALM", 0.1)
    found = dt.least_dwell_time(PLANT, IDLE, 0.1)
    assert (found.certified, found.proven, found.certificate) == (None, False, None)
    assert 0.1 <= found.refuted < 2.7078
    assert "was certified: Inconclusive" in found.message


ALONE = dt.SwitchedSystem(TURNING[:1], PLANT.B[:1], 0.3)
BAD = {
    "plant must be": lambda: dt.least_dwell_time(3, IDLE),
    "law must be": lambda: dt.least_dwell_time(PLANT, "averaged"),
    "step must be": lambda: dt.least_dwell_time(PLANT, IDLE, 0.0),
    "ratio must be above 1, got 1": lambda: dt.least_dwell_time(PLANT, IDLE, 0.1, ratio=1.0),
    "plant must have two modes or more, got one": lambda: dt.least_dwell_time(
        ALONE, dt.AveragedPredictor(ALONE, np.zeros((1, 1, 2)), allow_unstable=True)
    ),
    "law must be a table": lambda: dt.least_dwell_time(
        PLANT, dt.ExactPredictor(PLANT, np.zeros((2, 1, 2)), allow_unstable=True)
    ),
    "modes": lambda: dt.least_dwell_time(dt.problems.three_mode().plant, IDLE),
}


@pytest.mark.parametrize("message", BAD)
def test_bad_input_is_refused_by_name(message):
    with pytest.raises(ArgumentError, match=message):
        BAD[message]()


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    captured = capsys.readouterr()
    return stopped.value.code, captured.out, captured.err


NOT_EACH = {"certified_each": None, "refuted_each": None}


@pytest.fixture
def made_up(monkeypatch):
    """Answers by the law's label."""

    def answer(plant, law, step, **signals):
        if law.label == "oracle":
            raise ArgumentError("law must be a table.")
        if law.label == "mean":
            return SimpleNamespace(
                certified=None, refuted=math.inf, message="mode 1 grows.", **NOT_EACH
            )
        message = f"{law.label}: proved from 0.75 s."
        return SimpleNamespace(certified=0.75, refuted=0.5, message=message, **NOT_EACH)

    monkeypatch.setattr("deadtime.margins.least_dwell_time", answer)


def test_the_command_line_prints_the_bracket_of_every_law(capsys, made_up):
    code, out, _ = run(capsys, "certify", "paper", "--least-dwell-time")
    assert code == 0
    assert "proved dwell time, s" in out
    assert "0.75" in out
    assert "any" in out
    assert "law must be a table." in out
    code, out, _ = run(capsys, "certify", "paper", "--least-dwell-time", "--json")
    record = json.loads(out)["least_dwell_times"]
    assert record["averaged"] == {
        "certified": 0.75,
        "refuted": 0.5,
        "message": "averaged: proved from 0.75 s.",
    }


def test_the_command_line_fails_for_one_law_without_a_certified_dwell_time(capsys, made_up):
    assert run(capsys, "certify", "paper", "--law", "averaged", "--least-dwell-time")[0] == 0
    assert run(capsys, "certify", "paper", "--law", "mean", "--least-dwell-time")[0] == 1
    code, _, error = run(capsys, "certify", "paper", "--least-dwell-time", "--dwell-time", "0.5")
    assert code == 2
    assert "--least-dwell-time searches for the dwell time" in error


LIMITED = """\
[plant]
delay = 0.2
A = [[[-1.0]], [[-2.0]], [[-3.0]]]
B = [[[1.0]], [[1.0]], [[1.0]]]
[gains]
poles = [-4.0]
[[law]]
kind = "averaged"
[run]
x0 = [1.0]
horizon = 60.0
step = 0.1
[signal]
kind = "random"
dwell_time = [0.3, 0.6, 0.4]
maximum_dwell = [0.8, inf, 0.9]
transitions = [[0, 1, 0], [1, 0, 1], [0, 1, 0]]
"""


def test_the_command_line_keeps_what_the_problem_says_of_its_signals(capsys, tmp_path, monkeypatch):
    asked = []

    def answer(plant, law, step, dwell_time, mode):
        asked.append((dwell_time, mode))
        each = (0.2, 0.4, 0.8 / 3)
        return SimpleNamespace(
            certified=0.2, refuted=None, message="so.", certified_each=each, refuted_each=None
        )

    monkeypatch.setattr("deadtime.margins.least_dwell_time", answer)
    path = tmp_path / "problem.toml"
    path.write_text(LIMITED, encoding="utf-8")
    about = "certify", str(path), "--law", "averaged", "--least-dwell-time"
    code, out, _ = run(capsys, *about)
    assert code == 0
    ways = [[0, 1, 0], [1, 0, 1], [0, 1, 0]]
    assert asked[0] == (dt.SignalClass([0.3, 0.6, 0.4], [0.8, math.inf, 0.9], ways), None)
    assert "0.2, 0.4, 0.26667" in out
    assert "Dwell times of the modes stay in proportion to 0.3, 0.6, 0.4 s." in out
    name = "mode 1"
    code, out, _ = run(capsys, *about, "--mode", name, "--maximum-dwell", "2.0,3.0,2.5", "--json")
    assert asked[1] == (dt.SignalClass([0.3, 0.6, 0.4], [2.0, 3.0, 2.5], ways), 1)
    record = json.loads(out)
    assert record["least_dwell_times"]["averaged"]["certified_each"] == [0.2, 0.4, 0.8 / 3]
    assert (record["mode"], record["maximum_dwell"]) == (1, [2.0, 3.0, 2.5])
    assert record["transitions"] == ways
    code, out, _ = run(capsys, *about, "--dwell-time", "0.3,0.3,0.9", "--maximum-dwell", "inf")
    assert asked[2] == (dt.SignalClass([0.3, 0.3, 0.9], transitions=ways), None)
    code, _, error = run(capsys, "certify", str(path), "--mode", "1")
    assert code == 2
    assert "--mode needs --least-dwell-time" in error
