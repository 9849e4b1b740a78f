"""The [servo] of a problem file: its laws are those that Python makes, and bad input is refused."""

import dataclasses
import re

import numpy as np
import pytest

import deadtime as dt
from deadtime.app.script import script_of
from deadtime.base.wording import compact
from deadtime.cli.application import main
from deadtime.problems.comparison import ProblemRuns
from deadtime.problems.file import load_problem
from deadtime.problems.templates import template
from deadtime.reports.metrics import tracking_of_runs

PLANT = """\
[plant]
delay = 0.34
A = [[[0.0, 1.0], [0.0, -0.5]], [[0.0, 1.1], [0.0, 0.3]]]
B = [[[0.0], [1.0]], [[0.0], [0.8]]]
states = ["position (m)", "speed (m/s)"]
[gains]
lqr = { Q = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.5]], R = [[1.0]] }
"""
SERVO = """\
[servo]
tracked = ["position (m)"]
reference = { times = [0.0, 5.0], values = [1.0, 3.0] }
"""
OBSERVER = '[observer]\nkind = "luenberger"\nC = [[1.0, 0.0]]\npoles = [-3.0, -4.0]\n'
RUN = """\
[signal]
kind = "periodic"
sojourns = [0.85, 1.1]
modes = [0, 1]
[run]
x0 = [0.2, 0.0]
horizon = 10.0
step = 0.1
"""
LAWS = '[[law]]\nkind = "averaged"\n[[law]]\nkind = "mean"\nmodel = { delay = 0.3 }\n'
LIMITS = '[[imperfection]]\nkind = "saturation"\nlow = -1.0\nhigh = 1.0\n'
Q = np.diag([1.0, 1.0, 0.5])


def write(folder, *parts, plant=PLANT):
    path = folder / "mine.toml"
    path.write_text("".join((plant, *parts)), encoding="utf-8")
    return path


def test_laws_of_a_file_are_those_that_python_makes_of_its_servo(tmp_path):
    problem = load_problem(write(tmp_path, SERVO, OBSERVER, LAWS, RUN))
    assert problem.tracked == problem.outputs == ("position (m)",)
    for (name, law), delay in zip(problem.laws.items(), (0.34, 0.3), strict=True):
        plant = dt.SwitchedSystem(problem.plant.A, problem.plant.B, delay)
        servo = dt.Servo(plant, [[1.0, 0.0]])
        gains = servo.lqr(Q, [[1.0]], step=0.1)
        if name == "averaged":
            mine = dt.AveragedPredictor(servo.plant, gains, allow_unstable=True)
        else:
            mean = dt.Servo(plant.mean(), [[1.0, 0.0]]).lqr(Q, [[1.0]], step=0.1)[0]
            mine = dt.MeanPredictor(servo.plant, mean, gains, allow_unstable=True)
        observer = dt.luenberger(servo.model, servo.C, [-3.0, -4.0], 0.1)
        loop = dt.OutputFeedback(mine, observer, servo=servo, reference=([0.0, 5.0], [1.0, 3.0]))
        ours, run = problem.run(loop), problem.run(law)
        assert np.array_equal(ours.states, run.states)
        assert np.array_equal(ours.inputs, run.inputs)


def test_without_an_observer_the_law_is_told_the_state(tmp_path):
    problem = load_problem(write(tmp_path, SERVO, LAWS, RUN))
    assert problem.outputs == problem.states
    assert problem.tracked == ("position (m)",)
    run = problem.simulate("averaged")
    assert np.array_equal(run.estimates[:2], run.states)
    assert np.array_equal(run.measured, run.states)


def test_the_script_of_the_explorer_makes_the_same_servo(tmp_path):
    problem = load_problem(write(tmp_path, SERVO, OBSERVER, LAWS, RUN))
    made: dict = {}
    text = script_of(problem).split("\nruns = {")[0]
    exec(text, made)
    law = made["laws"]["averaged"]
    assert np.array_equal(problem.run(law).states, problem.simulate("averaged").states)


def test_steps_of_a_reference_come_from_a_csv_by_the_names_of_what_follows(tmp_path):
    (tmp_path / "r.csv").write_text("other,time,position (m)\n9,0,1\n9,5,3\n\n", encoding="utf-8")
    recorded = SERVO.replace("{ times = [0.0, 5.0], values = [1.0, 3.0] }", '{ file = "r.csv" }')
    runs = [
        load_problem(write(tmp_path, servo, OBSERVER, LAWS, RUN)).simulate("averaged")
        for servo in (SERVO, recorded)
    ]
    assert np.array_equal(runs[0].states, runs[1].states)


def test_an_estimated_disturbance_and_no_sum_leave_no_offset_in_one_mode(tmp_path):
    servo = """\
[servo]
reference = 2.0
integral = false
disturbance = [[0.0], [1.0]]
"""
    push = '[[imperfection]]\nkind = "step-disturbance"\nforce = [0.0, 0.3]\n'
    plant = PLANT.replace(
        "lqr = { Q = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.5]], R = [[1.0]] }",
        "poles = [-1.0, -2.0]",
    )
    law = '[[law]]\nkind = "single"\nmode = 1\n'
    run = RUN.replace("horizon = 10.0", "horizon = 40.0")
    run = run.replace('kind = "periodic"\nsojourns = [0.85, 1.1]\nmodes = [0, 1]', "#")
    run = run.replace("[signal]\n", '[signal]\nkind = "constant"\nmode = 1\n')
    observer = OBSERVER.replace("-4.0]", "-4.0, -5.0]")
    problem = load_problem(write(tmp_path, servo, observer, law, push, run, plant=plant))
    found = problem.simulate("mode 1 only")
    assert found.states[0, -1] == pytest.approx(2.0, abs=1e-9)
    assert found.estimates[2, -1] == pytest.approx(0.3, abs=1e-9)


def test_every_law_that_can_follow_runs_where_none_is_listed(tmp_path):
    problem = load_problem(write(tmp_path, SERVO, RUN, OBSERVER))
    assert list(problem.laws) == [
        "averaged",
        "mode 0 only",
        "mode 1 only",
        "mean",
        "oracle",
        "delay ignored",
    ]


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((SERVO.replace("position (m)", "angle"), RUN), "tracked must be names of measured"),
        ((SERVO.replace("position (m)", "speed (m/s)"), RUN), "no constant input moves"),
        ((SERVO.replace('["position (m)"]', "[]"), RUN), "tracked must name an output, got none"),
        (("[servo]\n", RUN), "tracked must have at most as many rows as there are inputs, 1"),
        ((SERVO, RUN.replace("0.1\n", '"ideal"\n')), "a servo runs at samples: give [run] a step"),
        ((SERVO + "disturbance = [[0.0], [1.0]]\n", RUN), "disturbance is estimated by an"),
        (
            (SERVO + "disturbance = [[0.0, 1.0]]\n", OBSERVER, RUN),
            "disturbance must have n = 2 rows and a column per constant force",
        ),
        ((SERVO.replace("5.0]", "0.0]"), RUN), "reference, times must increase"),
        ((SERVO.replace("times", "time"), RUN), "servo.reference"),
        ((SERVO.replace("{ times", '{ file = "none.csv" } #'), RUN), "none.csv"),
        (
            (SERVO, RUN, '[[law]]\nkind = "optimal"\n[switching]\nkind = "markov"\n'
             "rates = [[0.0, 0.5], [0.5, 0.0]]\n"),
            'kind = "optimal" follows no reference: with a [servo] take one of averaged',
        ),
        (
            (SERVO + "[cost]\nQ = [-1.0, 1.0]\n", RUN),
            "Q must be positive semidefinite",
        ),
    ],
)  # fmt: skip
def test_a_servo_that_does_not_fit_is_refused_in_one_line(tmp_path, parts, message):
    with pytest.raises(dt.ProblemFileError, match=re.escape(message)) as caught:
        load_problem(write(tmp_path, *parts))
    assert "\n" not in str(caught.value)


def test_a_reference_beyond_the_limits_is_refused_with_the_steady_input_it_takes(tmp_path):
    plant = PLANT.replace("[[0.0, 1.1], [0.0, 0.3]]", "[[0.0, 1.1], [0.5, 0.3]]")
    path = write(tmp_path, SERVO, LIMITS, RUN, plant=plant)
    # 0 = 0.5 x + 0.8 u at x = 3
    message = (
        "reference 3 is out of reach: in mode 1 it needs the steady input -1.875, and the "
        "saturation allows -1 to 1: change one of them."
    )
    with pytest.raises(dt.ProblemFileError, match=re.escape(message)):
        load_problem(path)
    near = SERVO.replace("3.0", "1.5")
    assert load_problem(write(tmp_path, near, LIMITS, RUN, plant=plant)).tracked


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time\n0\n", "must have the columns time and one for each of the 1 tracked outputs"),
        ("time,r\n0,x\n", "line 2: every column must hold a number"),
        ("time,r\n", "must have a row for each time, got a header alone"),
    ],
)
def test_a_csv_that_is_no_reference_is_refused(tmp_path, text, message):
    (tmp_path / "r.csv").write_text(text, encoding="utf-8")
    servo = '[servo]\ntracked = ["position (m)"]\nreference = { file = "r.csv" }\n'
    with pytest.raises(dt.ProblemFileError, match=re.escape(message)):
        load_problem(write(tmp_path, servo, RUN))


def test_design_is_for_loops_that_come_to_zero(tmp_path, capsys):
    path = write(tmp_path, SERVO, OBSERVER, LAWS, RUN)
    with pytest.raises(SystemExit) as stopped:
        main(["design", str(path), "--delay-margin", "0.1"])
    assert stopped.value.code == 2
    assert "follows a reference" in capsys.readouterr().err


def test_the_theorem_has_no_constants_for_loops_that_follow_a_reference(tmp_path, capsys):
    path = write(tmp_path, SERVO, OBSERVER, LAWS, RUN)
    with pytest.raises(SystemExit) as stopped:
        main(["bound", str(path)])
    assert stopped.value.code == 2
    out, err = capsys.readouterr()
    assert (out, "laws of a [servo] follow a reference" in err) == ("", True)


def test_the_table_of_a_step_says_that_it_ends_at_the_next_switch(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(template("quadrotor"), encoding="utf-8")
    whole = load_problem(path)
    problem = dataclasses.replace(whole, laws={"averaged": whole.laws["averaged"]}, horizon=15.0)
    run = problem.simulate("averaged")
    ((heading, rows),) = tracking_of_runs(ProblemRuns(problem, {"averaged": run}, {}))
    switch = next(t for t in run.signal.times if t > 12.0)
    assert heading.endswith(f"at 12 s, until the next switch, at {switch:.4g} s")
    assert rows[0][-1] == compact(run.step_info(0, until=switch)["SteadyStateError"])


OFFSET = "[[offset]]\nmode = 1\nforce = [0.0, 0.6]\n"


def test_an_offset_is_a_force_in_its_mode(tmp_path):
    problem = load_problem(write(tmp_path, SERVO, OBSERVER, LAWS, OFFSET, RUN))
    force = dt.imperfections.StepDisturbance([[0.0, 0.0], [0.0, 0.6]])
    (made,) = problem.imperfections
    assert np.array_equal(made.force, force.force)
    run = dt.simulate(
        problem.plant,
        problem.laws["averaged"],
        problem.signal,
        problem.x0,
        10.0,
        0.1,
        imperfections=[force],
    )
    assert np.array_equal(problem.simulate("averaged").states, run.states)


def test_the_steady_input_answers_the_offset_too(tmp_path):
    steady = SERVO.replace("3.0", "1.5").replace("[1.0", "[1.5")
    path = write(tmp_path, steady, LIMITS, OFFSET.replace("0.6", "0.9"), RUN)
    with pytest.raises(dt.ProblemFileError, match=r"in mode 1 it needs the steady input -1\.125"):
        load_problem(path)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((OFFSET.replace("mode = 1", "mode = 2"),), "mode must be in 0..1, got 2"),
        ((OFFSET, OFFSET), "mode 1 has an offset already"),
        ((OFFSET.replace("0.6]", "0.6, 0.0]"),), "force must have shape (n,) = (2,), got (3,)"),
    ],
)
def test_an_offset_that_does_not_fit_is_refused_in_one_line(tmp_path, parts, message):
    with pytest.raises(dt.ProblemFileError, match=re.escape(message)):
        load_problem(write(tmp_path, SERVO, *parts, RUN))


def test_an_offset_acts_at_samples(tmp_path):
    plain = PLANT.replace("lqr = { Q", "poles = [-1.0, -2.0] # ")
    ideal = RUN.replace("step = 0.1", 'step = "ideal"')
    with pytest.raises(dt.ProblemFileError, match="at which offsets and imperfections act"):
        load_problem(write(tmp_path, OFFSET, ideal, plant=plain))


@pytest.mark.parametrize("name", ["motor", "quadrotor"])
def test_the_servos_that_init_writes_hold_their_references_in_both_modes(tmp_path, name):
    path = tmp_path / "mine.toml"
    path.write_text(
        re.sub(r'kind = "noise"\nstd = .*', 'kind = "noise"\nstd = 0.0', template(name))
    )
    problem = load_problem(path)
    law, horizon = problem.laws["averaged"], 4.0 * problem.horizon
    for mode in (0, 1):
        run = dt.simulate(
            problem.plant,
            law,
            dt.SwitchingSignal.constant(mode),
            problem.x0,
            horizon,
            problem.step,
            imperfections=problem.imperfections,
        )
        assert abs(run.step_info()["SteadyStateError"]) < 1e-3
        assert run.commanded is not None
        assert dt.growth_rate(problem.plant, law, mode, problem.step) < -0.3
