"""Plants on logs that they were not identified from; free runs by `dlsim` and `solve_ivp`."""

import itertools
import json
import pickle
import re

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import dlsim

import deadtime as dt
from deadtime.base.errors import ArgumentError
from deadtime.cli import main
from deadtime.reports.identification_report import write_identification
from synthetic_logs import Plant, oscillator

H = 0.05
OF = {"delay": (0.0, 1.0), "switches": "samples"}
FIRST_ORDER = Plant([[[-1.0]]], [[[1.0]]], 0.262, 1e-3 * np.eye(1))


def logged(plant, seed, count=300, sensor=0.0, gain=1.0, jitter=0.0, begin=0.0, feedback=None):
    rng = np.random.default_rng(seed)
    t = begin + H * (np.arange(count) + jitter * rng.uniform(-1.0, 1.0, count))
    mode, u = (np.arange(count) // 23) % len(plant.A), rng.standard_normal((count, 1))
    of = Plant(plant.A, gain * plant.B, plant.D, plant.W)
    x, u = of.log(t, u, rng, mode, sensor, feedback)
    states = {f"x{i + 1}": one for i, one in enumerate(x.T)}
    return pd.DataFrame({"t": t, "mode": mode} | states | {"u1": u[:, 0]})


def nrmse(y, predicted):
    """As MATLAB's `compare`, by the ratio of root mean squares."""
    error = np.sqrt(np.mean((y - predicted) ** 2, axis=0))
    return 100.0 - 100.0 * error / np.std(y, axis=0)


def by_solve_ivp(plant, log, start):
    """States by integration from one arrival of an input to the next, from the row `start`."""
    t, u, mode = (log[name].to_numpy() for name in ("t", "u1", "mode"))
    columns = [name for name in log if name.startswith("x")]
    x = log[columns].to_numpy()[start]
    states = [x]
    for k in range(start, len(t) - 1):
        A, b = plant.A[mode[k]], plant.B[mode[k]][:, 0]
        arrivals = t + plant.delays[mode[k], 0]
        inner = arrivals[(arrivals > t[k]) & (arrivals < t[k + 1])]
        cuts = [t[k], *inner, t[k + 1]]
        for left, right in itertools.pairwise(cuts):
            acting = u[np.searchsorted(arrivals, 0.5 * (left + right)) - 1]
            x = solve_ivp(
                lambda _, x, A=A, force=b * acting: A @ x + force,
                (left, right),
                x,
                rtol=1e-10,
                atol=1e-12,
            ).y[:, -1]
        states.append(x)
    return np.array(states)


def by_dlsim(plant, log, start):
    """A plant of one mode and even rows, its state augmented by the inputs that still act."""
    n, whole = plant.states, int(np.ceil(plant.delay / H))
    late = plant.delay - (whole - 1) * H
    Z = np.zeros((n + 1, n + 1))
    Z[:n, :n], Z[:n, n:] = plant.A[0], plant.B[0]
    E, after = expm(Z * H), expm(Z * (H - late))[:n, n:]
    A = np.zeros((n + whole, n + whole))
    A[:n, :n] = E[:n, :n]
    A[:n, -1:] = E[:n, n:] - after
    B = np.zeros((n + whole, 1))
    if whole > 1:
        A[:n, -2:-1] = after
    else:
        B[:n] = after
    A[n + 1 :, n:-1], B[n] = np.eye(whole - 1), 1.0
    u = log["u1"].to_numpy()
    first = np.concatenate((log[["x1"]].to_numpy()[start], u[start - whole : start][::-1]))
    return dlsim((A, B, np.eye(n, n + whole), np.zeros((n, 1)), H), u[start:], x0=first)[1]


def test_a_free_run_is_that_of_dlsim_with_a_state_augmented_by_past_inputs():
    fit = dt.identify(logged(FIRST_ORDER, 0), modes=None, delay=(0.0, 1.0), noise=False)
    test = logged(FIRST_ORDER, 1, begin=7.0)
    validation = fit.compare(test)
    assert fit.operating_point is None
    (course,) = validation.courses
    start = int(np.flatnonzero(np.isfinite(course.free_run[:, 0]))[0]) - 1
    assert start == np.ceil(fit.plant.delay / H)
    expected = by_dlsim(fit.plant, test, start)
    np.testing.assert_allclose(course.free_run[start + 1 :], expected[1:], atol=1e-9)
    percent = nrmse(test[["x1"]].to_numpy()[start + 1 :], expected[1:])
    np.testing.assert_allclose(validation.free_run, percent, atol=1e-6)
    assert 0.0 < percent[0] < 100.0
    assert validation.samples == len(test) - start - 1
    with np.testing.assert_raises(AssertionError):  # it would fail with a wrong delay
        shifted = dt.SwitchedSystem(fit.plant.A, fit.plant.B, fit.plant.delay + 0.01)
        np.testing.assert_allclose(by_dlsim(shifted, test, start), expected, atol=1e-4)


def test_with_uneven_rows_two_modes_and_lost_rows_it_is_that_of_an_integration_between_events():
    fit = dt.identify(logged(oscillator(), 0, jitter=0.3), noise=False, **OF)
    test = logged(oscillator(), 1, 120, jitter=0.3, begin=3.0)
    test.loc[70, "x1"] = np.nan
    validation = fit.compare(test)
    (course,) = validation.courses
    start = int(np.flatnonzero(np.isfinite(course.free_run[:, 0]))[0]) - 1
    expected = by_solve_ivp(fit.plant, test, start)
    np.testing.assert_allclose(course.free_run[start + 1 :], expected[1:], atol=1e-7)
    measured = test[["x1", "x2"]].to_numpy()[start + 1 :]
    for i in (0, 1):
        known = np.isfinite(measured[:, i])
        percent = nrmse(measured[known, i], expected[1:][known, i])
        assert validation.free_run[i] == pytest.approx(percent, abs=1e-5)


def test_a_row_ahead_and_the_last_value_are_compared_over_the_same_rows():
    fit = dt.identify(logged(oscillator(), 0), noise=False, **OF)
    test = logged(oscillator(), 1)
    validation = fit.compare(test)
    x, plant = test[["x1", "x2"]].to_numpy(), fit.plant
    rows = np.flatnonzero(np.isfinite(validation.courses[0].one_step[:, 0]))
    each = [by_solve_ivp(plant, test[: k + 1], k - 1)[-1] for k in rows[:40]]
    np.testing.assert_allclose(validation.courses[0].one_step[rows[:40]], each, atol=1e-8)
    np.testing.assert_allclose(validation.last_value, nrmse(x[rows], x[rows - 1]), atol=1e-9)
    ahead = validation.courses[0].one_step[rows]
    np.testing.assert_allclose(validation.one_step, nrmse(x[rows], ahead), atol=1e-9)
    assert (validation.one_step > validation.last_value).all()


def test_lost_rows_divide_the_free_run_and_each_begins_at_a_logged_state():
    fit = dt.identify(logged(oscillator(), 0), noise=False, **OF)
    test = logged(oscillator(), 1).drop(index=range(100, 104))
    validation = fit.compare(test)
    assert len(validation.courses) == 1
    longest = int(np.ceil(fit.plant.delay / H))
    # The two rows after the gap are 4 + 2 < `longest` rows after inputs before it, which still act.
    assert validation.samples == 296 - 2 * (longest + 1) + longest - 1 - 4
    assert "Each of 3 free runs starts from the logged state" in validation.message


def test_where_sensors_are_noisy_the_first_state_is_fitted_and_the_filter_predicts():
    fit = dt.identify(logged(oscillator(), 0, sensor=0.02), noise=True, **OF)
    validation = fit.compare(logged(oscillator(), 1, sensor=0.02))
    assert "starts from the state that fits its first 29 rows best" in validation.message
    assert (validation.one_step > validation.last_value).all()
    assert (validation.free_run > 50.0).all()
    assert not validation.worse_than_constant
    assert "differs" not in validation.message


def test_the_held_out_half_begins_with_inputs_that_are_known():
    log = logged(FIRST_ORDER, 0, 400)
    fit = dt.identify(log, modes=None, delay=(0.0, 1.0), noise=False, test="half")
    first = dt.identify(log[:200], modes=None, delay=(0.0, 1.0), noise=False)
    assert fit.samples == 200
    assert fit.delays == first.delays
    assert fit.validation.samples == 199
    expected = by_dlsim(fit.plant, log, 200)
    percent = nrmse(log[["x1"]].to_numpy()[201:], expected[1:])
    np.testing.assert_allclose(fit.validation.free_run, percent, atol=1e-6)
    assert first.validation is None
    assert fit.validation.sentences[0] in fit.sentences
    again = pickle.loads(pickle.dumps(fit))
    np.testing.assert_array_equal(again.validation.free_run, fit.validation.free_run)


def fahrenheit(log):
    return log.assign(x1=1.8 * log["x1"] + 32.0)


def test_a_test_log_in_other_units_is_worse_than_a_constant_and_gain_and_level_are_named():
    fit = dt.identify(logged(FIRST_ORDER, 0), modes=None, delay=(0.0, 1.0), noise=False)
    validation = fit.compare(fahrenheit(logged(FIRST_ORDER, 1)))
    assert validation.worse_than_constant
    assert validation.free_run[0] < 0.0
    percent = f"{validation.free_run[0]:.1f}".replace("-", "−")
    assert validation.sentences[0] == (
        f"On the test log the model predicts worse than a constant: free-run fit {percent} %."
    )
    text = next(one for one in validation.sentences if "differs from the model" in one)
    gain, level = re.search(r"gain is ([\d.]+) times .* off by \+([\d.]+) in x1", text).groups()
    assert float(gain) == pytest.approx(1.8, rel=0.05)
    assert float(level) == pytest.approx(32.0, rel=0.05)
    assert "Compare the units of its columns." in text


def test_such_a_test_makes_no_law_good_enough():
    log, test = logged(FIRST_ORDER, 0), fahrenheit(logged(FIRST_ORDER, 1))
    how = {"modes": None, "delay": (0.0, 1.0), "noise": False}
    good, fit = dt.identify(log, **how), dt.identify(log, **how, test=test)
    assert fit.sentences[0].startswith("On the test log the model predicts worse than a constant")
    law = dt.AveragedPredictor(fit.plant, dt.place(fit.plant, [-1.5]))
    margin = dt.delay_margin(fit.plant, law, H)
    assert "not enough" not in good.verdict(margin)
    assert "not enough, for the model predicts worse than a constant" in fit.verdict(margin)


@pytest.mark.parametrize(
    ("level", "delay", "words"),
    [
        (0.5, None, r"its level is off by \+([\d.]+) in x1"),
        (0.0, 0.412, r"its delay is ([\d.]+) s longer"),
    ],
)
def test_a_level_or_a_delay_of_its_own_is_named_alone(level, delay, words):
    fit = dt.identify(logged(FIRST_ORDER, 0), modes=None, delay=(0.0, 1.0), noise=False)
    other = Plant(FIRST_ORDER.A, FIRST_ORDER.B, delay or 0.262, FIRST_ORDER.W)
    test = logged(other, 1)
    message = fit.compare(test.assign(x1=test["x1"] + level)).message
    assert float(re.search(words, message)[1]) == pytest.approx(level or 0.15, rel=0.1)
    assert "its gain" not in message


def test_logs_of_one_plant_do_not_differ_and_those_of_two_do():
    """24 pairs at a level of 1/1000, of which none may differ, and six pairs of other gains."""
    how = {"modes": None, "delay": (0.0, 1.0), "noise": False}
    for seed in range(0, 48, 2):
        fit = dt.identify([logged(FIRST_ORDER, seed), logged(FIRST_ORDER, seed + 1)], **how)
        assert "contradict" not in fit.message
    for seed in range(0, 12, 2):
        pair = [logged(FIRST_ORDER, seed), logged(FIRST_ORDER, seed + 1, gain=1.3)]
        fit = dt.identify(pair, **how)
        assert "the logs contradict one another" in fit.doubts
        text = next(one for one in fit.sentences if "contradict" in one)
        name, gain = re.search(r"of (log\[\d\]),.* its gain is ([\d.]+) times", text).groups()
        assert (float(gain) > 1.0) == (name == "log[1]")


def test_of_three_logs_the_one_of_another_delay_is_named_by_its_file(tmp_path):
    late = Plant(FIRST_ORDER.A, FIRST_ORDER.B, 0.412, FIRST_ORDER.W)
    names = [tmp_path / f"{name}.csv" for name in ("monday", "tuesday", "friday")]
    for seed, (plant, name) in enumerate(zip((FIRST_ORDER, FIRST_ORDER, late), names, strict=True)):
        logged(plant, seed).to_csv(name, index=False)
    fit = dt.identify(names, modes=None, delay=(0.0, 1.0), noise=False)
    text = next(one for one in fit.sentences if "contradict" in one)
    assert "friday.csv" in text
    assert "longer" in text


def test_a_log_with_larger_noise_alone_is_named_with_the_ratio():
    loud = Plant(FIRST_ORDER.A, FIRST_ORDER.B, 0.262, 16e-3 * np.eye(1))
    logs = [logged(FIRST_ORDER, 0, 600), logged(loud, 1)]
    fit = dt.identify(logs, modes=None, delay=(0.0, 1.0), noise=False)
    text = next(one for one in fit.sentences if "contradict" in one)
    ratio = float(re.search(r"log\[1\] are ([\d.]+) times", text)[1])
    assert ratio == pytest.approx(4.0, rel=0.2)


def test_an_unstable_plant_is_judged_by_predictions_of_some_delays_instead():
    plant = Plant([[[0.5]]], [[[1.0]]], 0.262, 1e-3 * np.eye(1))
    loop = {"feedback": np.array([[-1.2]]), "count": 500}
    how = {"modes": None, "delay": (0.0, 1.0), "noise": False}
    fit = dt.identify(logged(plant, 0, **loop), **how)
    validation = fit.compare(logged(plant, 1, **loop))
    assert not validation.judged
    assert not validation.worse_than_constant
    assert "is not judged, for the plant is unstable by itself: the fit is" in validation.message
    assert validation.several_steps[0] > 0.0
    assert validation.horizon == pytest.approx(0.8)
    assert not any("worse than a constant" in one for one in fit.doubts)


def test_predictions_of_some_delays_are_those_of_integrations_from_each_row():
    fit = dt.identify(logged(FIRST_ORDER, 0), modes=None, delay=(0.0, 1.0), noise=False)
    test = logged(FIRST_ORDER, 1, 80)
    validation = fit.compare(test)
    rows, first = round(validation.horizon / H), int(np.ceil(fit.plant.delay / H))
    starts = range(first, 80 - rows)
    ends = np.array([by_dlsim(fit.plant, test[: k + rows + 1], k)[-1] for k in starts])
    measured = test[["x1"]].to_numpy()[first + rows :]
    np.testing.assert_allclose(validation.several_steps, nrmse(measured, ends), atol=1e-6)


def test_a_regulated_loop_whose_free_run_is_all_noise_is_not_condemned():
    loop = {"feedback": np.array([[-3.0]]), "count": 600}
    quiet = Plant([[[-0.2]]], [[[1.0]]], 0.262, 1e-2 * np.eye(1))
    validation = dt.identify(
        logged(quiet, 0, **loop), modes=None, delay=(0.0, 1.0), noise=False
    ).compare(logged(quiet, 1, **loop))
    assert not validation.worse_than_constant


def at_rest_later(count=400):
    """A log whose inputs stop moving long before its second half."""
    log = logged(FIRST_ORDER, 0, count)
    u = log["u1"].to_numpy().copy()
    u[100:150], u[150:] = 2.0, 0.0
    rng = np.random.default_rng(5)
    quiet = Plant(FIRST_ORDER.A, FIRST_ORDER.B, 0.262, 1e-6 * np.eye(1))
    x, u = quiet.log(log["t"].to_numpy(), u[:, None], rng, log["mode"].to_numpy())
    return log.assign(x1=x[:, 0], u1=u[:, 0])


def test_a_held_out_part_in_which_nothing_moves_tests_nothing_and_has_no_figure():
    fit = dt.identify(at_rest_later(600), modes=None, delay=(0.0, 1.0), noise=False, test="half")
    assert np.isnan(fit.validation.free_run).all()
    assert not fit.validation.judged
    assert not fit.worse_than_constant
    assert fit.validation.sentences == (
        "Nothing moves in the held-out part: inputs are constant and outputs at rest, so that it "
        "does not test the model. Choose one in which inputs move: test=0.8, --test 0.8, holds out "
        "more, and test= or --test takes a second log.",
    )


def test_constant_inputs_test_the_return_to_rest_alone():
    fit = dt.identify(logged(FIRST_ORDER, 0), modes=None, delay=(0.0, 1.0), noise=False)
    test = at_rest_later()[150:190]
    validation = fit.compare(test)
    assert validation.free_run[0] > 90.0
    assert "it tests the return to rest, and not the delay." in validation.message


@pytest.mark.parametrize(
    ("test", "message"),
    [
        (1.0, 'test must be "half", a share between 0 and 1'),
        (0.999, "test must leave at least 2 rows of a log on either side, got 0.999"),
        ("missing.csv", "missing.csv cannot be read"),
        (True, "test must be the path of a CSV file or a pandas DataFrame, got bool"),
        ([], "test must be a path, a table or a list of them, got an empty list"),
    ],
)
def test_other_tests_are_refused(test, message):
    with pytest.raises(ArgumentError, match=re.escape(message)):
        dt.identify(logged(FIRST_ORDER, 0), modes=None, delay=(0.0, 1.0), test=test)


def test_modes_that_are_only_in_the_held_out_part_are_refused_by_name():
    log = logged(oscillator(), 0)
    log["mode"] = np.where(np.arange(300) < 200, "ice", "road")
    with pytest.raises(ArgumentError, match=r"holds out all rows of mode 'road'.*--test 0\.2"):
        dt.identify(log, test="half", **OF)
    fit = dt.identify(log.assign(mode="ice"), **OF)
    with pytest.raises(ArgumentError, match="must be one of the modes that were identified, ice"):
        fit.compare(log)


def test_modes_that_were_not_logged_are_refused():
    with pytest.raises(ArgumentError, match="need modes that were logged"):
        dt.identify(logged(oscillator(), 0), modes=2, delay=(0.0, 1.0), test="half")


def test_an_input_that_was_constant_and_moves_in_the_test_log_is_said():
    log = logged(FIRST_ORDER, 0).assign(u2=3.0)
    fit = dt.identify(log, modes=None, delay=(0.0, 1.0), noise=False)
    message = fit.compare(logged(FIRST_ORDER, 1).assign(u2=4.0)).message
    assert "u2 is 3 throughout the log that was identified and another in the test log" in message


def test_the_command_has_the_fits_in_its_table_its_json_its_figure_and_its_page(tmp_path, capsys):
    logged(FIRST_ORDER, 0).to_csv(tmp_path / "log.csv", index=False)
    fahrenheit(logged(FIRST_ORDER, 1)).to_csv(tmp_path / "second.csv", index=False)
    log = [str(tmp_path / "log.csv"), "--one-mode", "--delay", "0", "1", "--no-noise"]

    def said(*options):
        with pytest.raises(SystemExit) as stopped:
            main(["identify", *log, *options])
        return stopped.value.code, capsys.readouterr().out

    code, out = said("--test", "half", "--report", str(tmp_path / "page.html"))
    assert code == 0
    assert re.search(r"fit, % +free run +a row ahead +last value +a constant", out)
    assert re.search(r"\nx1 +\d+\.\d +\d+\.\d +\d+\.\d +0\n", out)
    page = (tmp_path / "page.html").read_text("utf-8")
    assert "Does it predict a log that was not identified?" in page
    code, out = said("--test", str(tmp_path / "second.csv"), "--json")
    record = json.loads(out)
    assert code == 1
    assert record["validation"]["free_run"][0] < 0.0
    assert record["validation"]["worse_than_constant"]
    assert "compare" not in record["validation"]
    code, out = said("--test", str(tmp_path / "second.csv"), "--figure", str(tmp_path / "f.svg"))
    assert out.startswith("On the test log the model predicts worse than a constant")
    assert "x1, test" in (tmp_path / "f.svg").read_text("utf-8") or code == 1


def test_the_figure_has_what_was_measured_and_both_predictions_in_the_log_s_units(tmp_path):
    log = fahrenheit(logged(FIRST_ORDER, 0, 400))
    fit = dt.identify(log, modes=None, delay=(0.0, 1.0), noise=False, test="half")
    above, below = fit.validation.plot().axes
    lines = {one.get_label(): one for one in above.get_lines()}
    assert {"log", "free run", "a row ahead"} <= lines.keys()
    drawn = pd.Series(lines["log"].get_ydata(), lines["log"].get_xdata()).dropna()
    np.testing.assert_allclose(drawn, log["x1"][200:], rtol=1e-12)
    np.testing.assert_allclose(drawn.index, log["t"][200:])
    free = np.asarray(lines["free run"].get_ydata(), float)
    np.testing.assert_allclose(free, fit.validation.courses[0].free_run[:, 0])
    error = np.asarray(below.get_lines()[1].get_ydata(), float)
    np.testing.assert_allclose(error[-5:], drawn.to_numpy()[-5:] - free[-5:])
    write_identification(fit, tmp_path / "page.html")


def test_lost_inputs_cost_only_the_rows_in_which_they_act():
    fit = dt.identify(logged(FIRST_ORDER, 0), modes=None, delay=(0.0, 1.0), noise=False)
    test = logged(FIRST_ORDER, 1)
    test["u1"] = test["u1"].where(np.arange(300) % 40 != 7)
    validation = fit.compare(test)
    assert 200 < validation.samples < 293
    assert "differs" not in validation.message


def test_a_constant_output_is_predicted_worse_than_by_a_constant_beyond_any_number():
    fit = dt.identify(logged(FIRST_ORDER, 0), modes=None, delay=(0.0, 1.0), noise=False)
    validation = fit.compare(logged(FIRST_ORDER, 1).assign(x1=2.0))
    assert validation.free_run[0] == -np.inf
    assert validation.worse_than_constant
    assert "free-run fit −∞ %" in validation.sentences[0]


def test_a_test_log_in_milliseconds_is_refused():
    fit = dt.identify(logged(FIRST_ORDER, 0), modes=None, delay=(0.0, 1.0), noise=False)
    test = logged(FIRST_ORDER, 1)
    with pytest.raises(ArgumentError, match="if its t counts milliseconds"):
        fit.compare(test.assign(t=1000.0 * test["t"]))


def test_an_exact_plant_predicts_exactly_and_round_off_is_no_difference():
    quiet = Plant(FIRST_ORDER.A, FIRST_ORDER.B, 0.262)
    fit = dt.identify(logged(quiet, 0), modes=None, delay=(0.0, 1.0), noise=False, test="half")
    np.testing.assert_allclose(fit.validation.free_run, 100.0, atol=1e-5)
    assert len(fit.validation.sentences) == 3


def test_repr_has_the_figures():
    fit = dt.identify(logged(FIRST_ORDER, 0), modes=None, delay=(0.0, 1.0), noise=False)
    validation = fit.compare(logged(FIRST_ORDER, 1))
    assert repr(validation) == (
        f"Validation(x1={validation.free_run[0]:.1f} % free, {validation.one_step[0]:.1f} % a row "
        f"ahead, samples={validation.samples})"
    )
