"""The [observer] of a problem file turns its laws into output feedback."""

import re
from pathlib import Path

import numpy as np
import pytest

import deadtime as dt
from deadtime.cli.application import main
from deadtime.problems.file import load_problem
from deadtime.scenarios.sweeps import load_study

PLANT = """\
[plant]
delay = 0.35
A = [[[0.5, 1.0], [0.0, -0.2]], [[0.4, 1.0], [0.1, -0.3]]]
B = [[[0.0], [1.0]], [[0.0], [1.1]]]
[gains]
poles = [-1.0, -2.0]
[[law]]
kind = "averaged"
[[law]]
kind = "delayed"
model = { delay = 0.3 }
[signal]
kind = "constant"
mode = 0
"""
RUN = "[run]\nx0 = [1.0, 0.0]\nhorizon = 4.0\nstep = 0.1\n"
PLACED = '[observer]\nkind = "luenberger"\nC = [[1.0, 0.0]]\npoles = ["-3+1j", "-3-1j"]\n'
KALMAN = """\
[observer]
kind = "kalman"
C = [[[1.0, 0.0]], [[1.0, 0.1]]]
process = [[0.1, 0.0], [0.0, 1.0]]
measurement = [[0.01]]
estimate = [0.5, 0.0]
"""


def write(tmp_path, *parts):
    path = tmp_path / "mine.toml"
    path.write_text("".join((PLANT, *parts)), encoding="utf-8")
    return path


def test_every_law_runs_on_an_observer_of_its_own_model(tmp_path):
    problem = load_problem(write(tmp_path, PLACED, RUN))
    assert list(problem.laws) == ["averaged", "delay ignored"]
    for law, delay in zip(problem.laws.values(), (0.35, 0.3), strict=True):
        assert isinstance(law, dt.OutputFeedback)
        assert law.observer.plant.delay == law.plant.delay == delay
        same = dt.luenberger(law.law.plant, [[1.0, 0.0]], [-3 + 1j, -3 - 1j], 0.1)
        assert (law.observer.gain == same.gain).all()
    run = problem.simulate("averaged")
    assert run.measured.shape == (1, run.time.size)


def test_a_kalman_filter_takes_an_output_per_mode_and_a_first_estimate(tmp_path, capsys):
    path = write(tmp_path, KALMAN, RUN)
    law = load_problem(path).laws["averaged"]
    C = [[[1.0, 0.0]], [[1.0, 0.1]]]
    same = dt.kalman(law.law.plant, C, np.diag([0.1, 1.0]), [[0.01]], 0.1)
    assert (law.observer.covariance == same.covariance).all()
    assert law.estimate.tolist() == [0.5, 0.0]
    with pytest.raises(SystemExit) as stopped:
        main(["simulate", str(path), "--out", str(tmp_path / "run.png")])
    assert stopped.value.code == 0
    assert "averaged" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((PLACED.replace("[1.0, 0.0]", "[0.0, 0.0]"), RUN), "mode 0 is not observable"),
        ((PLACED, RUN.replace("0.1", '"ideal"')), "an observer runs at samples: give [run] a step"),
        ((PLACED.replace('"-3+1j"', '"fast"'), RUN), "poles must be numbers"),
        ((KALMAN.replace("[[0.01]]", "[[0.0]]"), RUN), "measurement must be positive definite"),
        ((KALMAN.replace("[0.5, 0.0]", "[0.5]"), RUN), "estimate must have shape (n,) = (2,)"),
        ((PLACED.replace("luenberger", "magic"), RUN), "observer"),
        ((PLACED.replace("poles", "pols"), RUN), "pols"),
    ],
)
def test_a_section_that_does_not_fit_is_refused_in_one_line(tmp_path, parts, message):
    with pytest.raises(dt.ProblemFileError, match=re.escape(message)) as caught:
        load_problem(write(tmp_path, *parts))
    assert "\n" not in str(caught.value)


def test_noise_of_the_file_is_that_of_the_outputs(tmp_path):
    noise = '[[imperfection]]\nkind = "noise"\nstd = [0.1]\n'
    push = '[[imperfection]]\nkind = "step-disturbance"\nforce = [0.0, 1.0]\n'
    problem = load_problem(write(tmp_path, noise, push, PLACED, RUN))
    run = problem.simulate("averaged")
    assert 0.05 < (run.measured[0] - run.states[0]).std() < 0.2
    with pytest.raises(dt.ProblemFileError, match=r"Noise.std must have shape \(size,\) = \(2,\)"):
        load_problem(write(tmp_path, noise, RUN))


def test_a_study_does_not_take_a_problem_with_an_observer(tmp_path):
    write(tmp_path, PLACED, RUN)
    study = tmp_path / "study.toml"
    text = (Path(__file__).parents[2] / "studies" / "paper.toml").read_text(encoding="utf-8")
    study.write_text(re.sub(r'problem = ".*?"', 'problem = "mine.toml"', text, count=1), "utf-8")
    with pytest.raises(dt.StudyFileError, match=r"read the state, remove its \[observer\]"):
        load_study(study)


@pytest.mark.parametrize("model", ['"mean"', "0", "1"])
def test_an_observer_of_one_model_reads_no_mode_and_the_other_is_said_to_need_it(
    tmp_path, model, capsys
):
    one = load_problem(write(tmp_path, PLACED, f"model = {model}\n", RUN))
    law, name = one.laws["averaged"], model.strip('"')
    told = name if name == "mean" else int(name)
    same = dt.luenberger(law.plant, [[1.0, 0.0]], [-3 + 1j, -3 - 1j], 0.1, model=told)
    assert law.observer.gain.tolist() == same.gain.tolist()
    assert not law.observer.reads_mode
    assert one.observer_alone_reads_mode == ()
    both = load_problem(write(tmp_path, PLACED, RUN))
    assert both.observer_alone_reads_mode == ("averaged",)
    said = "The observer needs the mode at every sample, although the averaged law does not. Where"
    for more, needs in ((f"model = {model}\n", False), ("", True)):
        path = write(tmp_path, PLACED, more, RUN)
        with pytest.raises(SystemExit) as stopped:
            main(["simulate", str(path), "--out", str(tmp_path / "a.png")])
        assert stopped.value.code == 0
        assert (said in " ".join(capsys.readouterr().out.split())) == needs


def test_a_model_that_is_none_is_refused(tmp_path):
    for model, message in (
        ('"median"', "model must be the number of a mode or one of 'modes', 'mean', got"),
        ("2", "must be in 0..1"),
    ):
        with pytest.raises(dt.ProblemFileError, match=re.escape(message)):
            load_problem(write(tmp_path, PLACED, f"model = {model}\n", RUN))


def test_a_law_on_a_belief_refuses_a_servo_and_says_what_needs_no_mode(tmp_path):
    parts = '[[law]]\nkind = "belief"\n', "[servo]\nintegral = false\n", PLACED
    words = r'follows no reference: .* need none on an \[observer\] with model = "mean"'
    with pytest.raises(dt.ProblemFileError, match=words):
        load_problem(write(tmp_path, *parts, RUN))
