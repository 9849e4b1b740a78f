"""How well a run follows its reference: python-control's figures, and errors by hand."""

import json
import math

import control
import numpy as np
import pytest

import deadtime as dt
from deadtime.cli.application import main
from deadtime.simulation.tracking import TRACKING, fill_step_info, step_info

PLANT = dt.SwitchedSystem(
    [[[0.0, 1.0], [0.0, -0.5]], [[0.0, 1.1], [0.0, 0.3]]], [[[0.0], [1.0]], [[0.0], [0.8]]], 0.25
)
SERVO = dt.Servo(PLANT, [[1.0, 0.0]])
GAINS = SERVO.lqr(np.diag([1.0, 1.0, 0.5]), [[1.0]], step=0.1)
LAW = dt.AveragedPredictor(SERVO.plant, GAINS, allow_unstable=True)
OBSERVER = dt.luenberger(SERVO.model, SERVO.C, [-3.0, -4.0], 0.1)
STEPS = ([0.0, 1.0, 9.0], [0.0, 1.0, -0.5])
LOOP = dt.OutputFeedback(LAW, OBSERVER, servo=SERVO, reference=STEPS)
SIGNAL = dt.SwitchingSignal([0.0, 2.03, 7.4, 11.0], [0, 1, 0, 1])
NAMES = ("RiseTime", "SettlingTime", "Overshoot", "Undershoot", "Peak", "PeakTime")


@pytest.mark.parametrize("damping", [0.3, 1.5])
@pytest.mark.parametrize("size", [1.0, -2.5])
def test_of_a_response_without_delay_they_are_those_of_python_control(damping, size):
    time = np.linspace(0.0, 40.0, 4001)
    zero = [-0.4, 1.0]  # first the wrong way
    response = control.step_response(control.tf(zero, [1.0, 2.0 * damping, 1.0]), time)
    y = size * np.asarray(response.outputs).ravel()
    theirs = control.step_info(y, T=time, yfinal=size)
    ours = step_info(time, y, np.full(time.size, size))
    for name in NAMES:
        assert ours[name] == pytest.approx(theirs[name], rel=1e-12, abs=1e-12), name


def test_a_step_from_elsewhere_has_the_figures_of_that_from_zero():
    time = np.linspace(0.0, 20.0, 401)
    y = 1.0 - np.exp(-0.4 * time) * np.cos(time)
    base = step_info(time, y, np.ones(401))
    moved = step_info(time + 7.0, 3.0 - 2.0 * y, np.full(401, 1.0))
    for name in ("RiseTime", "SettlingTime", "Overshoot", "Undershoot"):
        assert moved[name] == pytest.approx(base[name], rel=1e-12)
    assert moved["IAE"] == pytest.approx(2.0 * base["IAE"], rel=1e-12)


def test_the_error_is_integrated_as_straight_between_samples():
    time = np.array([0.0, 1.0, 3.0])
    y, r = np.array([0.0, 2.0, 2.0]), np.array([1.0, 1.0, 1.0])
    # two triangles of 1/4, then 1 for two seconds
    assert step_info(time, y, r)["IAE"] == 2.5


def test_an_output_that_is_there_already_has_no_rise_and_one_that_never_arrives_has_none_in_time():
    time = np.arange(5.0)
    still = step_info(time, np.ones(5), np.ones(5))
    assert math.isnan(still["RiseTime"])
    assert math.isnan(still["Overshoot"])
    assert still["IAE"] == 0.0
    short = step_info(time, np.linspace(0.0, 0.5, 5), np.ones(5))
    assert short["RiseTime"] == short["SettlingTime"] == math.inf
    assert short["SteadyStateError"] == 0.5


def test_a_run_says_it_of_the_last_step_or_of_any_and_at_its_own_samples():
    run = dt.simulate(PLANT, LOOP, SIGNAL, [0.0, 0.0], 16.0, 0.1, times=[3.0])
    assert run.followed is not None
    assert run.followed.changes(16.0) == [0.0, 1.0, 9.0]
    full = dt.simulate(PLANT, LOOP, SIGNAL, [0.0, 0.0], 16.0, 0.1)
    y, time = full.states[0], full.time
    assert full.tracked is not None
    assert np.array_equal(full.tracked[0], y)
    for since, part, r in ((1.0, slice(10, 91), 1.0), (None, slice(90, None), -0.5)):
        found = run.step_info(since=since)
        shifted = y[part] - y[part.start]
        theirs = control.step_info(
            shifted, T=time[part] - time[part.start], yfinal=r - y[part.start]
        )
        for name in ("RiseTime", "SettlingTime", "Overshoot", "Undershoot"):
            # python-control says NaN where a response does not settle, we ∞
            wanted = math.inf if math.isnan(theirs[name]) else theirs[name]
            assert found[name] == pytest.approx(wanted, rel=1e-9, abs=1e-9), name
        assert found["Peak"] == np.abs(y[part]).max()
        assert found["SteadyStateError"] == r - y[part][-1]


def test_compiled_figures_are_those_of_python_to_the_last_bit():
    # Runs side by side, ten of twelve wanted, three states of which y is made of the first two;
    # one settles and crosses the reference, one never moves, one is lost.
    rng, T = np.random.default_rng(4), 300
    time = 0.05 * np.arange(T)
    swing = np.exp(-0.4 * time) * np.cos(2.0 * time + rng.uniform(0.0, 1.0, (12, 1)))
    x = rng.uniform(-0.01, 0.01, (3, T + 20, 3, 4))
    x[:, 20:, 0] += 1.0 - swing.reshape(3, 4, T).transpose(0, 2, 1)
    x[1, 20:, :2, 2], x[2, 200:, 0, 0], x[2, 70:, 0, 1] = 0.0, np.inf, np.nan
    ways = fill_step_info.function, fill_step_info.dispatcher
    for r in (np.ones(T), np.where(time < 5.0, 0.7, 1.1), np.zeros(T)):
        found = np.empty((2, len(TRACKING), 10))
        with np.errstate(all="ignore"):
            for way, room in zip(ways, found, strict=True):
                way(x, 20, np.array([1.0, -0.5]), time, r, 0.02, 0.1, 0.9, room)
        np.testing.assert_array_equal(found[0], found[1])
        assert np.isnan(found[0, :4, 6]).all() == (r[-1] == 0.0)  # the run that never moves


@pytest.mark.long
def test_many_runs_say_the_same_of_every_law_with_a_servo():
    signals = [dt.SwitchingSignal.random(2, 18.0, dwell_time=0.7, seed=i) for i in range(10)]
    options = {"x0": [0.1, 0.0], "horizon": 16.0, "step": 0.1}
    plain = dt.AveragedPredictor(PLANT, dt.place(PLANT, [-1.0, -2.0]))
    data = dt.monte_carlo(PLANT, {"servo": LOOP, "plain": plain}, signals, **options)
    assert data.one_by_one == []
    for i in (0, 9):
        found = dt.simulate(PLANT, LOOP, signals[i], **options).step_info()
        for name in TRACKING:
            value = data[name].sel(law="servo", output=0).values[i]
            assert value == pytest.approx(found[name], rel=1e-9, abs=1e-9), name
    assert np.isnan(data.RiseTime.sel(law="plain")).all()


TWO = dt.SwitchedSystem([[[0.0, 0.4], [0.0, -1.0]]], [np.eye(2)], 0.2)
SETTING = [0.0, 0.0], 20.0, 0.1  # x0, horizon, step


def two_outputs():
    """A servo of two outputs, the reference of the second stays; its run."""
    servo = dt.Servo(TWO, np.eye(2))
    gains = servo.lqr(np.eye(4), np.eye(2), step=0.1)
    law = dt.SingleModePredictor(servo.plant, gains, 0, allow_unstable=True)
    observer = dt.luenberger(servo.model, servo.C, [-5.0, -6.0], 0.1)
    steps = ([0.0, 8.0], [[1.0, 1.0], [2.0, 1.0]])
    loop = dt.OutputFeedback(law, observer, servo=servo, reference=steps)
    return loop, dt.simulate(TWO, loop, dt.SwitchingSignal.constant(0), *SETTING)


def test_each_output_is_asked_about_steps_of_its_own_reference():
    _, run = two_outputs()
    assert run.followed is not None
    assert [run.followed.changes(run.end, i) for i in (0, 1)] == [[0.0, 8.0], [0.0]]
    for output, since, r in ((0, 80, 2.0), (1, 0, 1.0)):
        time, y = run.time[since:], run.states[output, since:]
        assert run.step_info(output) == step_info(time, y, np.full(time.size, r))
    asked = run.step_info(1, since=8.0)  # when the other output's steps
    assert all(math.isnan(asked[name]) for name in NAMES[:4])
    assert asked["IAE"] == step_info(run.time[80:], run.states[1, 80:], np.ones(121))["IAE"]


@pytest.mark.long
def test_many_runs_are_asked_about_steps_of_each_output_s_own_reference():
    loop, run = two_outputs()
    data = dt.monte_carlo(TWO, {"servo": loop}, [dt.SwitchingSignal.constant(0)], *SETTING)
    assert data.one_by_one == []
    for output in (0, 1):
        for name, wanted in run.step_info(output).items():
            value = data[name].sel(law="servo", output=output).values[0]
            assert value == pytest.approx(wanted, rel=1e-9, abs=1e-9), name


def test_exports_of_a_run_hold_what_is_tracked_and_the_reference():
    run = dt.simulate(PLANT, LOOP, SIGNAL, [0.0, 0.0], 12.0, 0.1)
    frame, data = run.to_pandas(), run.to_xarray()
    assert np.array_equal(frame["y[0]"], run.states[0])
    assert frame["r[0]"].iloc[[5, 10, 95]].tolist() == [0.0, 1.0, -0.5]
    assert np.array_equal(data.r[0], frame["r[0]"])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda run: run.step_info(1), "output must be in 0..0, got 1: outputs count from 0"),
        (lambda run: run.step_info(since=12.5), r"since must be in \[0, 12\) s, got 12.5"),
    ],
)
def test_there_must_be_such_an_output_and_such_a_time(call, message):
    run = dt.simulate(PLANT, LOOP, SIGNAL, [0.0, 0.0], 12.0, 0.1)
    with pytest.raises(dt.ArgumentError, match=message):
        call(run)


def test_a_run_that_tracks_nothing_has_none():
    problem = dt.problems.paper()
    with pytest.raises(dt.ArgumentError, match="step_info needs a law with a servo"):
        problem.simulate("averaged").step_info()


FILE = """\
[plant]
delay = 0.25
A = [[[0.0, 1.0], [0.0, -0.5]], [[0.0, 1.1], [0.0, 0.3]]]
B = [[[0.0], [1.0]], [[0.0], [0.8]]]
states = ["position (m)", "speed (m/s)"]
[gains]
poles = [-0.7, -1.0, -1.5]
[servo]
tracked = ["position (m)"]
reference = { times = [0.0, 4.0], values = [1.0, 2.0] }
[[law]]
kind = "averaged"
[signal]
kind = "random"
dwell_time = 0.8
mean_sojourn = 1.5
[run]
x0 = [0.0, 0.0]
horizon = 12.0
step = 0.1
"""


@pytest.mark.long
def test_the_commands_say_them(tmp_path, capsys):
    path = tmp_path / "mine.toml"
    path.write_text(FILE, encoding="utf-8")
    out = str(tmp_path / "run.png")
    with pytest.raises(SystemExit) as stopped:
        main(["simulate", str(path), "--out", out])
    assert stopped.value.code == 0
    assert "position (m) after the last step of its reference" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["simulate", str(path), "--out", out, "--json"])
    told = json.loads(capsys.readouterr().out)["laws"]["averaged"]["tracking"]["position (m)"]
    assert [step["since"] for step in told] == [0.0, 4.0]
    data = tmp_path / "all.csv"
    with pytest.raises(SystemExit):
        main(["monte-carlo", str(path), "--scenarios", "8", "--out", out, "--data", str(data),
              "--json"])  # fmt: skip
    record = json.loads(capsys.readouterr().out)["tracking"]["position (m)"]["averaged"]
    header, *rows = data.read_text(encoding="utf-8").splitlines()
    assert len(rows) == 8
    place = header.split(",").index("IAE[0]")
    found = sorted(float(row.split(",")[place]) for row in rows)
    assert record["IAE"] == pytest.approx(found[3])


@pytest.mark.parametrize("until", [1.6, 2.3, 5.0, 9.0, 12.0])
def test_a_window_that_ends_at_an_event_is_that_of_a_run_that_ends_there(until):
    run = dt.simulate(PLANT, LOOP, SIGNAL, [0.0, 0.0], 16.0, 0.1)
    last = min(round(10 * until), 90)  # the reference steps again at 9 s
    part = slice(10, last + 1)
    found = run.step_info(since=1.0, until=until)
    assert found == step_info(run.time[part], run.states[0, part], np.ones(last - 9))


def test_a_window_that_ends_before_its_step_is_refused():
    run = dt.simulate(PLANT, LOOP, SIGNAL, [0.0, 0.0], 16.0, 0.1)
    with pytest.raises(dt.ArgumentError, match="until must be after the step, at 9 s, got 5"):
        run.step_info(until=5.0)
