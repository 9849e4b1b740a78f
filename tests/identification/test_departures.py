"""Departures of logs from the model: their tests against second methods, and found by name.

The generator shares no code with the package: SciPy's exponential and Van Loan's covariance on a
grid of a twentieth of a row, with the actuator between them.
"""

import json
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm

import deadtime as dt
from deadtime.cli import main
from deadtime.identification.actuators import delay_grid, lag_weights, rate_limited
from deadtime.identification.departures import Probe, departures_of, fit_lag
from deadtime.identification.score_tests import Regression, best_of_path, log_tail, random_walk

H, SUB = 0.05, 20
STEP = H / SUB
A = np.array([[[0.0, 1.0], [-4.0, -1.2]], [[0.0, 1.0], [-9.0, -1.2]]])
B = np.array([[[0.0], [4.0]], [[0.0], [6.0]]])
W = np.diag([1e-4, 4e-3])


def log_of(
    seed, delays=(0.31,), actuator=lambda v, u: u, load=None, rows=600, sensor=0.0, binary=False,
    uneven=False, colour=0.0,
):  # fmt: skip
    """A log of an oscillator, or of two, whose input passes an actuator: (state, input) → state."""
    rng, modes = np.random.default_rng(seed), len(delays)
    gaps = rng.integers(SUB // 2, 3 * SUB // 2, rows) if uneven else np.full(rows, SUB)
    begins = np.concatenate(([0], np.cumsum(gaps)))
    held = np.repeat(rng.integers(2, 12, rows), 1)
    values = rng.choice([-1.0, 1.0], rows) if binary else rng.standard_normal(rows)
    u = np.repeat(values, held)[:rows]
    mode = np.repeat(np.arange(rows) % modes, rng.integers(20, 50, rows))[:rows]
    tables = []
    for a, b in zip(A, B, strict=True):
        whole = np.zeros((5, 5))
        whole[:2, :2], whole[:2, 2:3], whole[:2, 3:] = a, b, np.eye(2)
        E = expm(whole * STEP)
        noise = np.block([[-a, W], [np.zeros((2, 2)), a.T]])
        V = expm(noise * STEP)
        root = np.linalg.cholesky(V[2:, 2:].T @ V[:2, 2:] + 1e-18 * np.eye(2))
        tables.append((E[:2, :2], E[:2, 2], E[:2, 3:], root))
    late = [round(one / STEP) for one in delays]
    acts, x, v, state, noise = np.zeros(begins[-1]), np.zeros(2), 0.0, [], 0.0
    normal = rng.standard_normal((begins[-1], 3))
    for k in range(rows):
        state.append(x)
        Phi, gain, free, root = tables[mode[k]]
        for t in range(begins[k], begins[k + 1]):
            v = actuator(v, u[k])
            acts[t] = v
            before = t - late[mode[k]]
            x = Phi @ x + gain * (acts[before] if before >= 0 else 0.0) + root @ normal[t, :2]
            noise = np.exp(-STEP / 0.3) * noise + colour * np.sqrt(STEP) * normal[t, 2]
            added = noise + (0.0 if load is None else load(t * STEP))
            x = x + free @ np.array([0.0, added])
    y = np.array(state) + sensor * rng.standard_normal((rows, 2))
    log = pd.DataFrame({"t": STEP * begins[:-1], "x1": y[:, 0], "x2": y[:, 1], "u1": u})
    return log.assign(mode=mode) if modes > 1 else log


def identified(log, **options):
    modes = "mode" if "mode" in log.columns else None
    return dt.identify(log, modes=modes, delay=(0.0, 1.0), **options)


def lagging(lag):
    keep = np.exp(-STEP / lag)
    return lambda v, u: keep * v + (1.0 - keep) * u


@pytest.fixture(scope="module")
def good():
    return identified(log_of(0))


@pytest.fixture(scope="module")
def lagged():
    return identified(log_of(1, actuator=lagging(0.03)))


PROBED = {
    "exact, two modes": lambda: (log_of(2, (0.31, 0.31), rows=300), False),
    "noisy": lambda: (log_of(3, rows=300, sensor=0.02), True),
    "uneven": lambda: (log_of(4, rows=300, uneven=True), False),
    "uneven, noisy": lambda: (log_of(4, rows=300, uneven=True, sensor=0.02), True),
}


@pytest.fixture(scope="module", params=PROBED)
def probe(request):
    log, noise = PROBED[request.param]()
    return Probe.of(identified(log, noise=noise)._estimate)


def test_residuals_and_slopes_have_the_score_and_the_information_of_the_likelihood(probe):
    log, theta = probe.log, probe.vector.copy()
    theta[: probe.layout.size] *= 1.0 + 1e-4  # off the maximum, where the score is not 0
    own = log.innovations_at(theta, probe.window)
    D, r = own.slopes(theta), own.stacked(own.residuals(theta))
    now = log.evaluate_in(*probe.window)(log.cells(theta))(theta)
    share = 1.0
    if hasattr(own, "roots"):  # of exact states S is divided by degrees of freedom
        terms = log.terms_in(*probe.window)(log.cells(theta))(theta)
        share = next(max(t.periods - 2 - log.layout.acting - 1, 1) / t.periods for t in terms)
    unit = np.sqrt(np.maximum(np.diagonal(now.information), 1e-300))
    tolerance = 0.03 if hasattr(own, "roots") else 1e-6
    assert D.T @ r / unit == pytest.approx(share * now.score / unit, rel=tolerance, abs=0.03)
    F, known = D.T @ D / unit / unit[:, None], now.information / unit / unit[:, None]
    assert share * known == pytest.approx(F, abs=tolerance)


def test_the_response_to_inputs_is_the_difference_of_predictions(probe):
    """Residuals of the log with other inputs, less those of the log, are minus the response."""
    rng = np.random.default_rng(0)
    parts = probe.parts
    changes = [rng.standard_normal((2, *part.input.shape)) for part in parts]
    found = probe.innovations.responses(probe.vector, changes)
    for one in range(2):
        moved = tuple(
            part._replace(input=part.input + change[one])
            for part, change in zip(parts, changes, strict=True)
        )
        log = probe.log.recording._replace(parts=moved)
        other = probe.innovations._replace(log=replace(probe.log, recording=log))
        own = other.residuals(probe.vector)
        plain = probe.innovations.residuals(probe.vector)
        assert found[: own.size, one] == pytest.approx((plain - own).ravel(), abs=1e-8)


def test_a_lag_on_a_grid_of_delays_is_the_integral_over_them():
    """Weights against SciPy's quadrature of a function that is linear between nodes."""
    from scipy.integrate import quad

    grid = delay_grid(0.2, 2.0, 0.31, 0.05)
    rng = np.random.default_rng(0)
    values, first, lag = rng.standard_normal(grid.size), 0.2432, 0.07

    def density(s):
        return np.interp(s, grid, values) * np.exp(-(s - first) / lag) / lag

    ends = [first, *grid[grid > first]]
    each = [quad(density, a, b, epsabs=1e-13)[0] for a, b in pairwise(ends)]
    beyond = values[-1] * np.exp(-(grid[-1] - first) / lag)
    assert lag_weights(grid, first, lag) @ values == pytest.approx(sum(each) + beyond, abs=1e-10)


def test_the_largest_of_a_path_exceeds_its_bound_as_often_as_it_says():
    """2,000 series of noise against steps at 40 times: at 5 % and at 1 %."""
    rng, n = np.random.default_rng(0), 200
    fit = Regression.of(np.zeros(n), np.ones((n, 1)))
    steps = (np.arange(n)[:, None] >= np.linspace(5, 195, 40)) * 1.0
    chances = []
    for _ in range(2000):
        r = rng.standard_normal(n)
        score = best_of_path(fit._replace(residuals=r - r.mean()), steps)
        assert score is not None
        chances.append(score.log_chance)
    for level in (0.05, 0.01):
        share = np.mean(np.array(chances) < np.log(level))
        assert 0.3 * level < share < 1.4 * level


def test_the_tail_of_a_quadratic_form_is_that_of_draws():
    rng, weights = np.random.default_rng(0), 1.0 / np.arange(1, 9) ** 2
    draws = (weights * rng.standard_normal((400_000, 8)) ** 2).sum(axis=1)
    for level in (0.05, 0.01, 0.001):
        assert np.exp(log_tail(float(np.quantile(draws, 1.0 - level)), weights)) == pytest.approx(
            level, rel=0.1
        )


def test_a_random_walk_is_found_in_noise_and_a_constant_is_not():
    rng, n = np.random.default_rng(1), 400
    waves = np.cos(np.pi * np.arange(1, 11) * (np.arange(n)[:, None] + 0.5) / n)
    noise = rng.standard_normal(n)
    walk = np.cumsum(0.1 * rng.standard_normal(n))
    scores = [
        random_walk(Regression.of(r, np.ones((n, 1))), waves) for r in (noise + 5.0, noise + walk)
    ]
    chances = [score.log_chance for score in scores if score is not None]
    assert chances[0] > np.log(0.01)
    assert chances[1] < np.log(1e-6)


def test_scores_of_a_lag_are_standard_normal_where_there_is_none():
    """z of 40 logs: mean and mean square as 40 normal numbers, at 1/1000 each."""
    z = []
    for seed in range(40):
        estimate = identified(log_of(100 + seed, rows=150), noise=False)._estimate
        probe = Probe.of(estimate)
        fit = Regression.of(probe.innovations.stacked(probe.white), probe.slopes)
        own = fit.across(probe.lagged(0, np.array([0.05])))[:, 0]
        z.append(own @ fit.residuals / np.linalg.norm(own))
    assert abs(np.mean(z)) < 3.3 / np.sqrt(40)
    assert 0.4 < np.mean(np.square(z)) < 1.85


def test_a_log_of_the_model_has_no_departures(good):
    assert good.departures == ()
    assert good.doubts == ()
    assert "looks like chance" in good.message


def test_a_lag_of_the_actuator_is_told_from_the_delay(lagged):
    (found,) = lagged.departures
    assert found.name == "actuator lag"
    lag, error, alone = fit_lag(Probe.of(lagged._estimate), 0, 0.05)
    assert lag == pytest.approx(0.03, abs=4.0 * error)
    assert error < 0.003
    assert alone == pytest.approx(0.31, abs=0.003)
    assert 0.325 < lagged.delays[0, 0] < 0.345  # the model's delay includes most of the lag
    assert f"lag of about {lag:.2g} s" in lagged.message
    assert "looks like chance" not in lagged.message


def test_a_departure_that_biases_a_delay_makes_no_law_enough(lagged):
    law = dt.AveragedPredictor(lagged.plant, dt.place(lagged.plant, [-1.0, -2.0]))
    margin = dt.delay_margin(lagged.plant, law, H)
    assert lagged.verdict(margin).endswith(
        "not enough, for the log departs from the model by a lag of the actuator, which the delay "
        "includes."
    )


def limited(rate):
    return lambda v, u: v + np.clip(u - v, -rate * STEP, rate * STEP)


def with_slack(width):
    return lambda v, u: min(max(v, u - width / 2), u + width / 2)


BROKEN = {
    "rate limit": {"actuator": limited(6.0)},
    "saturation": {"actuator": lambda v, u: np.clip(u, -1.0, 1.0)},
    "dead zone": {"actuator": lambda v, u: u - np.clip(u, -0.3, 0.3)},
    "backlash": {"actuator": with_slack(0.4)},
    "unlogged load": {"load": lambda t: 0.4 * (t > 13.0)},
    "delay per mode": {"delays": (0.31, 0.33)},
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_a_log_departs_by_is_named(name):
    fit = identified(log_of(5, **BROKEN[name]), noise=False)
    assert [one.name for one in fit.departures] == [name]
    assert fit.departures[0].sentence in fit.message
    assert fit.departures[0].advice in fit.message
    assert any(fit.departures[0].doubt == one for one in fit.doubts)


def test_coloured_noise_is_named_and_said_once_by_the_test_of_whiteness():
    fit = identified(log_of(5, colour=0.5), noise=False)
    assert [one.name for one in fit.departures] == ["coloured noise"]
    assert fit.departures[0].sentence not in fit.message
    assert "What is left is not white" in fit.message
    assert fit.doubts == (
        "what is left of the log is not white, and intervals are too narrow then",
    )


@pytest.mark.parametrize("name", ["backlash", "delay per mode", "unlogged load"])
def test_what_a_log_with_uneven_rows_departs_by_is_named(name):
    fit = identified(log_of(6, uneven=True, **BROKEN[name]), noise=False)
    assert [one.name for one in fit.departures] == [name]


def test_delays_that_differ_between_modes_are_given_and_per_mode_removes_the_departure():
    log = log_of(7, (0.31, 0.33))
    fit = identified(log, noise=False)
    (found,) = fit.departures
    assert found.advice == "Repeat with per_mode=True, --per-mode."
    again = identified(log, noise=False, per_mode=True)
    assert again.departures == ()
    named = [float(D) for D in re.findall(r"([\d.]+) s in mode", found.sentence)]
    assert named == pytest.approx(again.delays[:, 0], abs=3e-4)


def test_a_drifting_level_is_named():
    rng = np.random.default_rng(8)
    walk = np.cumsum(0.3 * np.sqrt(STEP) * rng.standard_normal(700 * SUB))
    fit = identified(log_of(8, load=lambda t: walk[round(t / STEP)]))
    assert fit.departures[0].name in ("drift", "unlogged load")
    assert "drift" in (fit.departures[0].name, *fit.departures[0].others)


def test_the_time_of_a_load_is_named():
    fit = identified(log_of(9, load=lambda t: 0.4 * (t > 13.0), sensor=0.02))
    (found,) = fit.departures
    assert found.name == "unlogged load"
    assert float(found.sentence.split("t = ")[1].split(" s")[0]) == pytest.approx(13.0, abs=1.5)
    assert "acts on x2" in found.sentence


def test_steps_between_two_values_do_not_tell_saturation_or_a_dead_zone():
    """A map of two values is a gain and an offset: no test is made of it."""
    probe = Probe.of(identified(log_of(10, binary=True, rows=300), noise=False)._estimate)
    fit = Regression.of(probe.innovations.stacked(probe.white), probe.slopes)
    tested = {one.name for one in probe.alternatives() if one.test(fit) is not None}
    assert not tested & {"saturation", "dead zone"}
    assert {"actuator lag", "rate limit", "coloured noise", "drift"} <= tested


def one_step(seed):
    """dx/dt = (u(t − 12.3) − x)/20 with rows every second, and one step after 40 s."""
    rng, u, x, keep = np.random.default_rng(seed), np.zeros(300), np.zeros(300), np.exp(-0.05)
    u[40:] = 1.0
    soon = 1.0 - np.exp(-0.035)  # u_{k−12} acts for 0.7 s
    for k in range(13, 299):
        x[k + 1] = keep * x[k] + (1.0 - keep - soon) * u[k - 13] + soon * u[k - 12]
        x[k + 1] += 0.02 * rng.standard_normal()
    return pd.DataFrame({"t": np.arange(300.0), "x": x, "u": u})


def test_a_step_in_noise_tells_only_the_sum_of_a_lag_and_a_delay():
    fit = dt.identify(one_step(11), None, (0.0, 30.0), noise=False, states=["x"], inputs=["u"])
    assert fit.departures == ()
    (text,) = [one for one in fit.sentences if "may act through a lag of up to" in one]
    assert "the log tells their sum, and not each alone" in text


STEPS_UNSEEN = {
    "between logs": lambda: [log_of(12 + i, rows=300).assign(u2=float(i)) for i in range(2)],
    "on a lost row": lambda: log_of(12).assign(u2=np.repeat([0.0, 1.0], 300)).drop(index=300),
}


@pytest.mark.parametrize("where", STEPS_UNSEEN)
def test_an_input_without_a_step_in_the_rows_is_not_tested_for_a_limited_rate(where):
    fit = dt.identify(STEPS_UNSEEN[where](), None, (0.0, 1.0), noise=False)
    assert fit.departures == ()
    tested = [one.name for one in Probe.of(fit._estimate).alternatives()]
    assert tested.count("rate limit") == 1
    assert tested.count("actuator lag") == 2


def test_advice_names_the_column_of_a_log_for_a_shell():
    log = log_of(1, actuator=lagging(0.03)).rename(columns={"x1": "x1: position (m)"})
    (found,) = identified(log).departures
    assert found.name == "actuator lag"
    assert "outputs=['x1: position (m)'], order=3, --outputs \"x1: position (m)\"" in found.advice
    name = re.findall(r"outputs=\['([^']*)'", found.advice)[0]
    assert dt.identify(log, None, (0.0, 1.0), outputs=[name], order=2).plant.states == 2


@pytest.mark.parametrize("linear", [False, True])
def test_an_input_of_limited_rate_is_the_mean_of_a_fine_course_or_that_at_rows(linear):
    rng = np.random.default_rng(0)
    t, fine = np.arange(40.0), np.arange(0.0, 39.0, 1e-3)
    u = np.repeat(rng.standard_normal(10), 4)
    target = np.interp(fine, t, u) if linear else u[fine.astype(int)]
    course, now = np.empty(fine.size), u[0]
    for k, one in enumerate(target):
        course[k] = now
        now += np.clip(one - now, -0.7e-3, 0.7e-3)
    rows = course.reshape(-1, 1000)
    expected = rows[:, 0] if linear else rows.mean(axis=1)
    assert rate_limited(u, t, 0.7, linear)[:-1] == pytest.approx(expected, abs=5e-3)


def test_a_mode_that_no_stretch_of_a_long_log_visits_has_the_noise_of_all_rows():
    log = log_of(14, rows=8600).assign(mode=0)
    log.loc[600:680, "mode"] = 1  # the first stretch ends before it, and the second begins later
    estimate = dt.identify(log, delay=(0.0, 1.0), noise=False)._estimate
    probe = Probe.of(estimate)
    assert all((part.mode == 0).all() for part in probe.parts)
    whole = probe.whole.innovations_at(probe.vector, probe.window)
    assert probe.innovations.roots == pytest.approx(whole.roots)
    assert departures_of(estimate).found == ()


def test_measurements_without_noise_are_not_tested():
    log = log_of(11, rows=300)
    quiet = log.copy()
    x = np.zeros((300, 2))
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[:2, 2:] = A[0], B[0]
    E = expm(whole * H)
    for k in range(6, 299):
        x[k + 1] = E[:2, :2] @ x[k] + E[:2, 2] * log.u1[k - 6]
    quiet[["x1", "x2"]] = x
    assert departures_of(identified(quiet, noise=False)._estimate) == ((), ())


def test_departures_are_in_the_record_of_the_command_line(tmp_path, capsys):
    path = tmp_path / "log.csv"
    log_of(1, actuator=lagging(0.03)).to_csv(path, index=False)
    with pytest.raises(SystemExit):
        main(["identify", str(path), "--one-mode", "--delay", "0", "1", "--json"])
    record = json.loads(capsys.readouterr().out)
    (found,) = record["departures"]
    assert found["name"] == "actuator lag"
    assert found["statistic"] > 10.0
    assert found["chance"] < 1e-4
    assert found["sentence"] in " ".join(record["sentences"])
