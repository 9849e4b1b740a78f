"""Problem and study files that say what is imperfect."""

import numpy as np
import pytest

import deadtime as dt
from deadtime.cli.application import main
from deadtime.imperfections import Noise, Saturation, StepDisturbance
from deadtime.problems.comparison import compare
from deadtime.problems.file import load_problem
from deadtime.problems.imperfection_registry import ENTRIES
from deadtime.reports.verdict import verdict
from deadtime.scenarios.sweeps import load_study

PLAIN = """\
[plant]
delay = 0.35
A = [[[0.5, 1.0], [0.0, -0.2]], [[0.4, 1.0], [0.1, -0.3]]]
B = [[[0.0], [1.0]], [[0.0], [1.1]]]

[gains]
poles = [-1.0, -2.0]

[signal]
kind = "switches"
times = [0.0, 0.7, 1.55]
modes = [0, 1, 0]

[run]
x0 = [1.0, 0.0]
horizon = 4.0
step = 0.1
seed = 7
"""
EVERY = """
[[imperfection]]
kind = "white-disturbance"
intensity = [1e-4, 1e-3]

[[imperfection]]
kind = "coloured-disturbance"
std = 0.1
time_constant = 0.5
force = [0.0, 1.0]

[[imperfection]]
kind = "step-disturbance"
force = [0.0, 0.1]
start = 1.0

[[imperfection]]
kind = "noise"
std = [0.01, 0.02]

[[imperfection]]
kind = "measurement-delay"
delay = 0.03

[[imperfection]]
kind = "jitter"
most = 0.02

[[imperfection]]
kind = "late-samples"
periods = 1
probability = 0.1

[[imperfection]]
kind = "dropout"
probability = 0.05

[[imperfection]]
kind = "mode-delay"
periods = 1

[[imperfection]]
kind = "wrong-mode"
probability = 0.05

[[imperfection]]
kind = "saturation"
low = -20
high = [20]

[[imperfection]]
kind = "rate-limit"
rate = 200
"""
TRUTH = """
[truth]
delay = 0.36
A = [[[0.5, 1.0], [0.0, -0.25]], [[0.4, 1.0], [0.1, -0.3]]]
"""


def load(tmp_path, text, name="mine.toml"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return load_problem(path)


def test_every_imperfection_can_stand_in_a_file(tmp_path):
    problem = load(tmp_path, PLAIN + EVERY)
    assert {type(one) for one in problem.imperfections} == {entry.made for entry in ENTRIES}
    run = problem.simulate("averaged")
    same = dt.simulate(
        problem.plant, problem.laws["averaged"], problem.signal, problem.x0, 4.0, 0.1,
        imperfections=problem.imperfections, seed=7,
    )  # fmt: skip
    assert (run.states == same.states).all()
    assert not compare(problem).runs["oracle"].diverged
    sentences = verdict(compare(problem))
    assert sentences[1].startswith("The runs are imperfect: white disturbance (intensity ")


def test_the_truth_of_a_file_is_what_runs_and_the_plant_what_laws_believe(tmp_path):
    problem, plain = load(tmp_path, PLAIN + TRUTH), load(tmp_path, PLAIN)
    assert problem.plant.delay == 0.36
    assert problem.plant.A[0, 1, 1] == -0.25
    np.testing.assert_array_equal(problem.plant.B, plain.plant.B)
    assert problem.model is not None
    for name, law in problem.laws.items():
        assert law.plant.delay == 0.35
        np.testing.assert_array_equal(law.plant.A, plain.laws[name].plant.A)
    np.testing.assert_array_equal(problem.gains, plain.gains)
    assert plain.model is None
    assert verdict(compare(problem))[1] == (
        "The runs are imperfect: A of the plant differ from the laws' model; the true delay is "
        "0.36 s, the model's 0.35 s."
    )


def test_commanded_inputs_can_be_what_laws_are_told_of(tmp_path):
    limits = '\n[[imperfection]]\nkind = "saturation"\nlow = -1\nhigh = 1\n'
    told = load(tmp_path, PLAIN + limits).simulate("averaged")
    unidentified = load(tmp_path, PLAIN.replace("seed = 7", 'predict = "commanded"') + limits)
    assert (unidentified.simulate("averaged").states != told.states).any()


def test_the_command_line_runs_imperfect_files(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    load(tmp_path, PLAIN + EVERY)
    with pytest.raises(SystemExit) as stopped:
        main(["simulate", "mine.toml"])
    assert stopped.value.code == 0
    assert "The runs are imperfect" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[[imperfection]]\nkind = "noise"\nstd = -1.0\n', r"Noise.std must be ≥ 0"),
        ('[[imperfection]]\nkind = "noise"\nstd = [1.0]\n', r"Noise.std must have shape"),
        ('[[imperfection]]\nkind = "dust"\n', "imperfection"),
        ('[[imperfection]]\nkind = "saturation"\nlow = 1\nhigh = 1\n', "low < high"),
        ('[[imperfection]]\nkind = "jitter"\nmost = 0.2\n', "at most one period"),
        ("[truth]\nA = [[[0.5]]]\n", r"A must have shape"),
        ("[truth]\nB = [[[0.0, 1.0], [1.0, 1.0]], [[0.0, 1.0], [1.0, 1.0]]]\n", "B must have"),
        ("[truth]\ndelay = 0.0\n", "delay must be positive"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(tmp_path, text, message):
    with pytest.raises(dt.ProblemFileError, match=rf"mine.toml.*{message}") as raised:
        load(tmp_path, PLAIN + "\n" + text)
    assert "\n" not in str(raised.value)


def test_an_ideal_loop_takes_no_imperfections(tmp_path):
    text = PLAIN.replace("step = 0.1", 'step = "ideal"') + EVERY
    with pytest.raises(dt.ProblemFileError, match="imperfections act: give a period"):
        load(tmp_path, text)


STUDY = """\
problem = "mine.toml"
poles = [-1.0, -2.0]
horizon = 2.0
step = 0.05
scenarios = 4
laws = ["averaged"]

[grid]
dwell_time = 0.3
sojourn = "fixed"
"""


def study(tmp_path, text):
    path = tmp_path / "study.toml"
    path.write_text(text, encoding="utf-8")
    return load_study(path)


@pytest.fixture
def noisy(tmp_path):
    """A study with limits of its own, of a problem with noise."""
    load(tmp_path, PLAIN + '\n[[imperfection]]\nkind = "noise"\nstd = 0.1\n')
    limits = '\n[[imperfection]]\nkind = "saturation"\nlow = -3\nhigh = 3\n'
    return study(tmp_path, STUDY + limits)


def test_a_study_has_the_imperfections_of_its_problem_and_its_own(noisy):
    assert noisy.loop(next(noisy.cells())).imperfections == (Noise(0.1), Saturation(-3.0, 3.0))


@pytest.mark.long  # that batches have them: tests/scenarios/test_imperfect_batches.py
def test_a_study_runs_with_its_imperfections(noisy, tmp_path):
    from deadtime.scenarios.sweeps.cell import run_cell

    made = noisy
    ((cell,),) = ([*made.cells()],)
    values = run_cell(made, cell).metrics["ise"]
    assert np.isfinite(values).all()
    # Two modes of fixed sojourns make two signals; every scenario has noise of its own.
    assert np.unique(values[0]).size == 4
    load(tmp_path, PLAIN)
    plain = run_cell(study(tmp_path, STUDY), cell).metrics["ise"]
    assert np.unique(plain[0]).size <= 2
    assert (plain != values).all()


def test_a_study_runs_the_truth_of_its_problem_unless_the_grid_changes_what_it_fixes(tmp_path):
    load(tmp_path, PLAIN + TRUTH)
    made = study(tmp_path, STUDY)
    loop = made.loop(next(made.cells()))
    assert loop.plant.delay != loop.laws["averaged"].plant.delay
    with pytest.raises(dt.StudyFileError, match=r"its \[truth\] fixes what grid\.delay changes"):
        study(tmp_path, STUDY + "delay = [0.4, 0.5]\n")


def test_a_force_without_an_end_needs_none_in_the_file(tmp_path):
    text = '\n[[imperfection]]\nkind = "step-disturbance"\nforce = [0.0, 1.0]\n'
    assert load(tmp_path, PLAIN + text).imperfections == (StepDisturbance([0.0, 1.0]),)
