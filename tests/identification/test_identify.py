"""What a log of a known plant gives back, and what is refused."""

import dataclasses
import re

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.problems import load_problem
from synthetic_logs import Plant, oscillator

H = 0.05


def table(t, y, u, mode=None):
    columns = {"t": t} | {f"x{i + 1}": x for i, x in enumerate(y.T)}
    columns |= {f"u{j + 1}": one for j, one in enumerate(u.T)}
    return pd.DataFrame(columns if mode is None else {**columns, "mode": mode})


def made(plant, count=400, seed=0, m=1, switching=False, t=None, **how):
    rng = np.random.default_rng(seed)
    t = H * np.arange(count) if t is None else t
    mode = (np.arange(count) // 20) % 2 if switching else None
    y, u = plant.log(t, rng.standard_normal((count, m)), rng, mode, **how)
    return table(t, y, u, mode)


def holds(fit, plant):
    """The share of unknowns that lie in their intervals, delays all."""
    A, B = fit.plant.A, fit.plant.B
    inside = []
    for name, true in (("A", plant.A), ("B", plant.B)):
        for i, a, b in np.ndindex(true.shape):
            low, high = fit.interval(f"{name}[{i}][{a},{b}]")
            inside.append(low < true[i, a, b] < high)
    low, high = fit.delay_interval[..., 0], fit.delay_interval[..., 1]
    wide = 0.5 * (high - low)  # a few intervals of many are allowed to miss by half their length
    near = (low - wide < plant.D) & (high + wide > plant.D)
    assert near.all(), (fit.delays, fit.delay_interval)
    assert A.shape == plant.A.shape
    assert B.shape == plant.B.shape
    return np.mean(inside)


ONE = Plant([[[0.0, 1.0], [-2.0, -1.0]]], [[[0.0], [1.0]]], 0.312, 1e-3 * np.eye(2))
TWO_INPUTS = Plant(
    [[[-1.0, 0.5], [0.0, -2.0]]], [[[1.0, 0.2], [0.3, -1.0]]], [0.312, 0.17], 1e-3 * np.eye(2)
)
UNSTABLE = Plant([[[0.5]]], [[[1.0]]], 0.23, 1e-3 * np.eye(1))


def test_two_modes_share_a_delay_that_is_known_to_a_thousandth_of_it():
    fit = dt.identify(made(oscillator(), switching=True))
    assert holds(fit, oscillator()) > 0.7
    assert np.diff(fit.delay_interval).max() < 2e-3
    assert (fit.noise == 0.0).all()
    np.testing.assert_allclose(fit.disturbance, np.tile(1e-3 * np.eye(2), (2, 1, 1)), atol=4e-4)
    low, high = fit.interval("disturbance[0][0,0]")
    assert low < 1e-3 < high
    assert "looks like chance" in fit.message


def test_every_input_has_its_own_delay():
    fit = dt.identify(made(TWO_INPUTS, m=2), modes=None, delay=(0.0, 0.6))
    assert holds(fit, TWO_INPUTS) > 0.7
    assert fit.interval("delay[1]") == tuple(fit.delay_interval[0, 1])


def test_every_mode_may_have_its_own_delay():
    plant = oscillator(D=[[0.312], [0.104]])
    fit = dt.identify(made(plant, switching=True), delay=(0.0, 1.0), per_mode=True)
    assert holds(fit, plant) > 0.7
    assert fit.interval("delay[1][0]") == tuple(fit.delay_interval[1, 0])


def test_a_loop_that_is_closed_and_a_plant_that_is_unstable_are_identified():
    log = made(UNSTABLE, feedback=np.array([[-1.2]]))
    assert holds(dt.identify(log, modes=None), UNSTABLE) == 1.0


@pytest.mark.parametrize("true", [0.3, 0.3001])
def test_a_delay_at_a_whole_number_of_periods_lies_in_its_interval(true):
    plant = Plant(ONE.A, ONE.B, true, ONE.W)
    fit = dt.identify(made(plant, 300, seed=2), modes=None)
    holds(fit, plant)
    assert np.diff(fit.delay_interval).max() < 5e-3


@pytest.mark.parametrize("count", [120, pytest.param(400, marks=pytest.mark.long)])
def test_uneven_rows_are_taken_exactly(count):
    rng = np.random.default_rng(5)
    t = H * np.arange(count) + rng.uniform(-0.4, 0.4, count) * H
    fit = dt.identify(made(ONE, count, t=t), modes=None, delay=(0.0, 0.6))
    assert holds(fit, ONE) > 0.6
    assert np.diff(fit.delay_interval).max() < 4e-3
    assert "unevenly" in fit.message


def test_a_log_that_is_written_with_few_digits_is_even():
    log = made(ONE)
    log["t"] = (1e4 + log["t"]).round(3)
    fit = dt.identify(log, modes=None)
    assert holds(fit, ONE) > 0.7
    assert fit.step == pytest.approx(H)


def test_noise_of_a_sensor_is_noticed():
    log = made(UNSTABLE, 120, seed=1, sensor=np.array([0.03]))
    told = []
    fit = dt.identify(log, modes=None, delay=(0.0, 0.5), progress=told.append)
    assert told[-2:] == ["looking for the delay between 0 and 0.5 s", "taking sensors for noisy"]
    assert holds(fit, UNSTABLE) == 1.0
    low, high = fit.interval("noise[0]")
    assert low < 0.03 < high < 1.5 * low
    assert "noisy" in fit.message


@pytest.mark.long
def test_noise_of_sensors_is_noticed_and_told_from_that_of_the_plant():
    log = made(ONE, 300, sensor=np.array([0.02, 0.04]))
    log.loc[100:103, "x1"] = np.nan
    fit = dt.identify(log, modes=None, delay=(0.0, 0.6))
    assert holds(fit, ONE) > 0.6
    for j, true in enumerate((0.02, 0.04)):
        low, high = fit.interval(f"noise[{j}]")
        assert 0.9 * low < true < 1.1 * high
        assert high < 1.5 * low
    assert "noisy" in fit.message
    quiet = dt.identify(log, modes=None, delay=(0.0, 0.6), noise=False)
    assert "not white" in quiet.message
    assert abs(quiet.plant.A[0, 1, 1] + 1.0) > 4.0 * abs(fit.plant.A[0, 1, 1] + 1.0)


@pytest.mark.long
def test_redundant_outputs_are_states():
    log = made(ONE, 300)
    C = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    rng = np.random.default_rng(1)
    y = log[["x1", "x2"]].to_numpy() @ C.T + 0.03 * rng.standard_normal((300, 3))
    outputs = pd.DataFrame({"t": log["t"], "u": log["u1"]} | {f"y{i}": y[:, i] for i in range(3)})
    fit = dt.identify(outputs, modes=None, delay=(0.0, 0.6), C=C)
    holds(fit, ONE)
    np.testing.assert_allclose(fit.noise, 0.03, rtol=0.2)


def test_several_logs_and_lost_rows_are_one_recording():
    log = made(ONE, 500)
    lost = log.drop(index=range(200, 210))
    fit = dt.identify([lost, made(ONE, 100, seed=3)], modes=None)
    assert holds(fit, ONE) > 0.7
    assert fit.samples == 590


def test_what_is_saved_is_a_problem_that_loads(tmp_path):
    rng = np.random.default_rng(0)
    mode = np.repeat(np.arange(60) % 2, rng.integers(4, 9, 60))
    y, u = oscillator().log(
        H * np.arange(mode.size), rng.standard_normal((mode.size, 1)), rng, mode
    )
    log = table(H * np.arange(mode.size), y, u, np.array(["slow", "fast"])[mode])
    log.to_csv(tmp_path / "log.csv", index=False)
    fit = dt.identify(tmp_path / "log.csv")
    fit.save(tmp_path / "problem.toml", title='a "plant"')
    problem = load_problem(tmp_path / "problem.toml")
    assert (problem.plant.A == fit.plant.A).all()
    assert (problem.plant.delays == fit.delays).all()
    assert problem.uncertain is not None
    np.testing.assert_allclose(problem.uncertain.covariance, fit.uncertain.covariance, rtol=1e-6)
    assert problem.modes == ("fast", "slow")
    assert fit.model is not None
    lasts = max(float(one.mean()) for one in fit.model.sojourn)
    assert problem.horizon == pytest.approx(max(20.0 * fit.delays.max(), 5.0 * lasts), abs=H)
    slow = dataclasses.replace(fit, plant=dt.SwitchedSystem(fit.plant.A, fit.plant.B, 0.01))
    slow.save(tmp_path / "short_delay.toml")
    assert load_problem(tmp_path / "short_delay.toml").horizon == pytest.approx(5.0 * lasts, abs=H)
    assert problem.title == 'a "plant"'
    figure = fit.plot()
    assert len(figure.axes) == 5
    with pytest.raises(dt.ArgumentError, match="cannot be written"):
        fit.save(tmp_path / "nowhere" / "problem.toml")


def test_a_margin_that_is_narrower_than_the_interval_is_not_enough():
    fit = dt.identify(made(UNSTABLE, 200, feedback=np.array([[-1.2]])), modes=None)
    plant, gains = fit.plant, dt.place(fit.plant, [-1.0])
    margin = dt.delay_margin(plant, dt.AveragedPredictor(plant, gains), H)
    assert fit.verdict(margin).endswith(": enough.")
    said = fit.verdict(margin, dt.AveragedPredictor(plant, gains), H)
    assert re.search(r"enough\. Of 100 plants drawn .*, 100 decay", said)
    weak = dt.AveragedPredictor(plant, -0.51 * np.ones((1, 1, 1)))  # the log leaves a = 0.5 ± 0.03
    margin_of_weak = dt.delay_margin(plant, weak, H)
    assert "Not enough: log for longer" in fit.verdict(margin_of_weak, weak, H)
    narrow = type(margin)(**{**vars(margin), "lower": margin.nominal - 1e-6})
    assert "not enough" in fit.verdict(narrow)
    nothing = type(margin)(**{**vars(margin), "lower": None, "upper": None})
    assert "no delay at all" in fit.verdict(nothing)


GOOD = made(ONE, 120)


def changed(**columns):
    return GOOD.assign(**columns)


def put(column, row, value):
    log = GOOD.astype({column: object})
    log.loc[row, column] = value
    return log


@pytest.mark.parametrize(
    ("log", "how", "said"),
    [
        (GOOD, {"modes": "gear"}, "must have the column 'gear'.*modes=None"),
        (changed(mode=[0] * 60 + [2] * 60), {"modes": "mode"}, "mode 1 is never visited"),
        (changed(mode=[0.0] * 60 + [np.nan] * 60), {"modes": "mode"}, "row 60: mode must be there"),
        (changed(u1=1.0), {}, "u1 must change"),
        (put("x1", 7, "much"), {}, "row 7: x1 must be a finite number, got 'much'"),
        (put("t", 7, np.nan), {}, "row 7: t must be a number"),
        (put("t", 7, 0.3), {}, "row 7: t must be later than in row 6"),
        (GOOD.drop(columns="t"), {}, "must have a column t"),
        (GOOD.drop(columns=["x1", "x2"]), {}, "must have columns x1, x2"),
        (GOOD[:9], {}, "too short.*is t in seconds"),
        (changed(t=1000.0 * GOOD["t"]), {}, "every 50 s.*milliseconds"),
        (changed(x3=0.0), {}, "x3 must move"),
        (changed(x3=GOOD["x1"] - GOOD["x2"]), {}, "x1, x2, x3 must be states of their own"),
        (GOOD, {"delay": (0.5, 0.2)}, "0 ≤ low < high"),
        (GOOD, {"delay": (0.0, np.inf)}, r"delay\[1\] must be finite"),
        (GOOD, {"switches": "now"}, "switches must be"),
        (GOOD, {"inputs": ["v"]}, "must have the column 'v'"),
        (GOOD.rename(columns={"x1": "y1", "x2": "y2"}), {"C": [[1, 0]]}, "C must have a row"),
        (GOOD.rename(columns={"x1": "y1"}), {"C": [[1.0, 0.0]]}, "C must have rank n = 2, got 1"),
        ([], {}, "empty list"),
        ("nowhere.csv", {}, "nowhere.csv cannot be read"),
        (3.5, {}, "must be the path"),
        (GOOD, {"delay": (0.0, 60.0)}, "1,200 periods.*narrow the range"),
    ],
)
def test_what_is_wrong_with_a_log_is_said(log, how, said):
    with pytest.raises(dt.ArgumentError, match=said):
        dt.identify(log, **{"modes": None, **how})


def test_a_line_of_a_file_is_named_as_an_editor_counts_it(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,x,u\n0,1,1\n1,2,0\n1,3,1\n")
    with pytest.raises(dt.ArgumentError, match=r"line 4: t must be later"):
        dt.identify(path, modes=None)
    path.write_text("t,x,u\n0,1,1,\n1,2,0,\n1,3,1,\n")  # no column for the last commas
    with pytest.raises(dt.ArgumentError, match=r"line 4: t must be later.* got 1 after 1"):
        dt.identify(path, modes=None)
    path.write_text("")
    with pytest.raises(dt.ArgumentError, match="is no CSV table"):
        dt.identify(path, modes=None)


def test_an_unknown_that_is_not_there_is_refused():
    fit = dt.identify(GOOD, modes=None)
    with pytest.raises(dt.ArgumentError, match=r"name must be one of A\[0\]\[0,0\]"):
        fit.interval("D")


def test_a_delay_beyond_the_range_is_said_not_to_be_found():
    fit = dt.identify(made(ONE), modes=None, delay=(0.0, 0.28), noise=False)
    assert fit.delays[0, 0] == pytest.approx(0.28)
    assert "the best fit is at the longest delay of the range searched, 0 … 0.28 s" in fit.message
    assert fit.delays_not_found == ("delay",)
    assert not fit.tests.unrelated


@pytest.mark.long
def test_intervals_of_the_delay_hold_the_truth_as_often_as_they_say():
    """400 samples, two modes, process noise alone: 95 % of 60, give or take three deviations."""
    inside, error, claimed = 0, [], []
    for seed in range(60):
        fit = dt.identify(made(oscillator(), seed=100 + seed, switching=True), delay=(0.0, 1.0))
        low, high = fit.interval("delay")
        inside += low < 0.312 < high
        error.append(fit.delays[0, 0] - 0.312)
        claimed.append((high - low) / 3.94)
    assert inside >= 52
    assert np.std(error) == pytest.approx(np.mean(claimed), rel=3.0 / np.sqrt(120))
    assert abs(np.mean(error)) < 3.0 * np.std(error) / np.sqrt(60)
