"""Gain, time constants and dead time: against least squares on closed forms; their intervals."""

import itertools
import json

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import curve_fit

import deadtime as dt
from deadtime.base.errors import ArgumentError
from deadtime.cli import main
from deadtime.identification.process_models import (
    Quantity,
    TransferMatrix,
    coefficients,
    ratio_ends,
    unit_of,
)
from deadtime.reports.identification_report import process_rows

MOVES = ((20.0, 1.0), (120.0, -2.0), (200.0, 1.5))
Q = 1.959963984540054


def first_order(late, gain, lag):
    return gain * -np.expm1(-late / lag)


def second_order(late, gain, slow, fast):
    return gain * (
        1.0 - (slow * np.exp(-late / slow) - fast * np.exp(-late / fast)) / (slow - fast)
    )


def oscillating(late, gain, frequency, damping):
    w = frequency * np.sqrt(1.0 - damping**2)
    swing = np.cos(w * late) + damping * frequency / w * np.sin(w * late)
    return gain * (1.0 - np.exp(-damping * frequency * late) * swing)


def integrating(late, gain):
    return gain * late


def lagged_integrator(late, gain, lag):
    return gain * (late + lag * np.expm1(-late / lag))


def response(shape, t, moves, *parameters):
    """The output after steps of the input; the dead time is the last parameter."""
    late = [np.maximum(t - at - parameters[-1], 0.0) for at, _ in moves]
    return sum(size * shape(s, *parameters[:-1]) for s, (_, size) in zip(late, moves, strict=True))


def made(shape, truth, noise, seed=0, h=1.0, end=300.0, moves=MOVES):
    t = h * np.arange(round(end / h))
    u = sum(size * (t >= at - 1e-9) for at, size in moves)
    y = response(shape, t, moves, *truth)
    return pd.DataFrame(
        {"t": t, "y1": y + noise * np.random.default_rng(seed).normal(size=t.size), "u1": u}
    )


def quantities(process):
    pairs = [one for pair in process.oscillations for one in pair]
    return [process.gain, *process.time_constants, *pairs, process.dead_time]


CASES = {
    "fopdt": (first_order, (2.0, 20.0, 4.3), {"model": "fopdt"}),
    "fopdt of negative gain": (first_order, (-0.5, 8.0, 7.71), {"model": "fopdt"}),
    "sopdt": (second_order, (2.0, 20.0, 6.0, 4.3), {"model": "sopdt"}),
    "sopdt that oscillates": (oscillating, (2.0, 0.2, 0.3, 4.3), {"model": "sopdt"}),
    "integrating": (integrating, (0.03, 4.3), {"model": "integrating"}),
    "integrating with a lag": (
        lagged_integrator,
        (0.03, 8.0, 4.3),
        {"model": "integrating", "order": 2},
    ),
}


@pytest.mark.parametrize("kind", CASES)
def test_estimates_and_intervals_are_those_of_least_squares_on_the_closed_form(kind):
    shape, truth, options = CASES[kind]
    noise = 0.01 * abs(truth[0]) * (30.0 if "integrating" in kind else 1.0)
    log = made(shape, truth, noise, seed=1)
    fit = dt.identify(log, modes=None, delay=(0.0, 20.0), **options)
    (one,) = fit.processes
    assert one.integrating == ("integrating" in kind)

    def expected(t, *p):
        """Integrators keep their unknown first state, and the log does not say that it is 0."""
        parameters, first = p[: len(truth)], p[len(truth) :]
        lag = 1.0 if len(first) < 2 else parameters[1]
        free = [1.0, lag * -np.expm1(-t / lag)][: len(first)]
        return response(shape, t, MOVES, *parameters) + sum(
            a * b for a, b in zip(first, free, strict=True)
        )

    unknown = {"integrating": 1, "integrating with a lag": 2}.get(kind, 0)
    best, covariance = curve_fit(expected, log["t"], log["y1"], p0=(*truth, *unknown * (0.0,)))
    best, covariance = best[: len(truth)], covariance[: len(truth), : len(truth)]
    deviation = np.sqrt(np.diagonal(covariance))
    for found, value, error in zip(quantities(one), best, deviation, strict=True):
        assert abs(found.value - value) < 0.25 * error
        assert found.low < found.value < found.high
        assert found.high - found.low == pytest.approx(2.0 * Q * error, rel=0.1)


def test_a_first_order_process_says_its_numbers_first_and_as_a_transfer_function():
    control = pytest.importorskip("control")
    shape, truth, options = CASES["fopdt"]
    log = made(shape, truth, 0.02).rename(columns={"y1": "x1: T [°C]", "u1": "u1: valve [%]"})
    fit = dt.identify(log, modes=None, delay=(0.0, 20.0), **options)
    (one,) = fit.processes
    first = fit.sentences[0]
    assert first.startswith("Gain 2.0")
    assert ") °C/%, time constant " in first
    assert ", dead time 4." in first
    assert first.endswith(").")
    assert one.gain.unit == "°C/%"
    assert one.time_constants[0].unit == one.dead_time.unit == "s"
    t = np.linspace(0.0, 100.0, 51)
    found = control.step_response(one.transfer_function(), t).outputs
    expected = first_order(t, one.gain.value, one.time_constants[0].value)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8)
    without = dt.identify(log, modes=None, delay=(0.0, 20.0), states=["x1: T [°C]"])
    assert first in without.sentences[1:]


def two_regimes(seed=0, noise=0.02, h=1.0):
    """A tank whose gain and lag depend on the flow; a dead time of each."""
    rng = np.random.default_rng(seed)
    t = h * np.arange(900)
    mode = np.where((t // 150) % 2 == 0, "low", "high")
    u = np.repeat(rng.uniform(-1.0, 1.0, 60), 15)
    gain, lag, dead = (
        {"low": 2.0, "high": 1.0},
        {"low": 40.0, "high": 15.0},
        {"low": 8.3, "high": 3.6},
    )
    y = np.zeros(t.size)
    for k in range(t.size - 1):
        i = mode[k]
        x, lo = y[k], t[k]
        cuts = np.unique(
            np.clip(
                [lo, lo + h, *(np.array([0, 1]) * h + np.ceil((lo - dead[i]) / h) * h + dead[i])],
                lo,
                lo + h,
            )
        )
        for a, b in itertools.pairwise(cuts):
            q = int(np.floor((0.5 * (a + b) - dead[i]) / h))
            steady = gain[i] * (u[q] if q >= 0 else 0.0)
            x = steady + (x - steady) * np.exp(-(b - a) / lag[i])
        y[k + 1] = x
    return pd.DataFrame(
        {"t": t, "y1": y + noise * rng.standard_normal(t.size), "u1": u, "mode": mode}
    )


def test_every_flow_regime_has_its_gain_time_constant_and_dead_time():
    fit = dt.identify(
        two_regimes(), delay=(0.0, 20.0), model="fopdt", per_mode=True, switches="samples"
    )
    assert [one.mode for one in fit.processes] == ["high", "low"]
    for one, truth in zip(fit.processes, ((1.0, 15.0, 3.6), (2.0, 40.0, 8.3)), strict=True):
        for found, value in zip(quantities(one), truth, strict=True):
            assert abs(found.value - value) < 1.0 * (found.high - found.low)
            assert found.high - found.low < 0.3 * value
    assert fit.sentences[0].startswith("In mode high: gain ")
    assert fit.sentences[1].startswith("In mode low: gain ")
    assert [row[0] for row in process_rows(fit)] == [
        "y1 from u1, mode high",
        "y1 from u1, mode low",
    ]


def test_every_input_has_its_gain_and_dead_time():
    moved = ((60.0, -1.0), (160.0, 1.0), (240.0, -1.0))
    log = made(first_order, (2.0, 20.0, 4.3), 0.01)
    other = made(first_order, (-0.7, 20.0, 9.6), 0.0, moves=moved)
    log = log.assign(y1=log["y1"] + other["y1"], u2=other["u1"])
    fit = dt.identify(log, modes=None, delay=(0.0, 20.0), model="fopdt")
    first, second = fit.processes
    assert first.gain.low < 2.0 < first.gain.high < 2.1
    assert second.gain.low < -0.7 < second.gain.high < -0.6
    assert first.dead_time.value == pytest.approx(4.3, abs=0.3)
    assert second.dead_time.value == pytest.approx(9.6, abs=0.9)
    assert fit.sentences[0].startswith("From u1: gain ")
    assert fit.sentences[1].startswith("From u2: gain -0.")


def test_states_get_these_words_without_the_poles_that_do_not_act():
    """Two tanks in a row: the level of the first does not show the second's time constant."""
    A, b = np.array([[-0.08, 0.0], [0.08, -0.02]]), np.array([0.12, 0.0])
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 600.0)
    u = np.repeat(rng.uniform(-1.0, 1.0, 30), 20)
    run = solve_ivp(
        lambda s, x: A @ x + b * (u[int(s - 3.4)] if s >= 3.4 else 0.0),
        (0.0, 599.0),
        np.zeros(2),
        t_eval=t,
        max_step=0.1,
        rtol=1e-8,
    )
    y = run.y.T + 0.01 * rng.standard_normal((600, 2))
    log = pd.DataFrame({"t": t, "x1": y[:, 0], "x2": y[:, 1], "u1": u})
    fit = dt.identify(log, modes=None, delay=(0.0, 20.0))
    upper, lower = fit.processes
    assert [round(one.value, 1) for one in upper.time_constants] == [12.5]
    assert [one.value for one in lower.time_constants] == pytest.approx([50.0, 12.5], rel=0.03)
    assert upper.gain.low < 1.5 < upper.gain.high
    assert lower.gain.low < 6.0 < lower.gain.high
    assert not any("ain " in one for one in fit.sentences)


def test_a_log_that_does_not_exclude_an_integrator_bounds_gain_and_time_constant_from_below():
    log = made(integrating, (0.03, 4.3), 0.02)
    fit = dt.identify(log, modes=None, delay=(0.0, 20.0), model="fopdt")
    (one,) = fit.processes
    for found in (one.gain, one.time_constants[0]):
        assert found.high == np.inf
        assert found.low > 0.0
    assert "Gain at least " in fit.sentences[0]
    assert "does not exclude an integrator" in fit.sentences[1]
    assert "--model integrating" in fit.sentences[1]
    assert one.dead_time.low < 4.3 < one.dead_time.high


def test_levels_far_from_0_change_nothing():
    shape, truth, options = CASES["integrating"]
    plain = made(shape, truth, 0.01)
    high = plain.assign(y1=plain["y1"] + 300.0, u1=plain["u1"] + 50.0)
    ours, other = (
        dt.identify(log, modes=None, delay=(0.0, 20.0), **options).processes[0]
        for log in (plain, high)
    )
    assert ours.gain.value == pytest.approx(other.gain.value, rel=5e-3)
    assert ours.dead_time.value == pytest.approx(other.dead_time.value, abs=0.05)


def test_a_higher_order_than_the_log_shows_names_the_model_of_the_lower_one():
    log = made(second_order, (2.0, 20.0, 6.0, 4.3), 0.3)
    fit = dt.identify(log, modes=None, delay=(0.0, 20.0), model="sopdt")
    assert 'say model="fopdt", --model fopdt' in fit.message


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "pid"}, r'model must be "fopdt", "sopdt" or "integrating" \(--model .*\'pid\''),
        ({"model": 1}, "model must be"),
        ({"model": "fopdt", "order": 2}, "order must be left out with model='fopdt'"),
        ({"model": "integrating", "order": 3}, "order must be 1, or 2 for one with a lag"),
        ({"model": "sopdt", "zeros": True}, "zeros must be left out with model='sopdt', --model"),
        ({"model": "sopdt", "C": [[1.0]]}, "C must be left out with model='sopdt'"),
        ({"model": "sopdt", "noise": False}, "noise must not be False"),
    ],
)
def test_arguments_that_contradict_a_model_are_refused(options, message):
    log = made(first_order, (2.0, 20.0, 4.3), 0.01)
    with pytest.raises(ArgumentError, match=message):
        dt.identify(log, **({"modes": None, "delay": (0.0, 20.0)} | options))


def test_a_model_of_several_outputs_is_refused_and_says_how_to_choose_one():
    log = made(first_order, (2.0, 20.0, 4.3), 0.01).rename(columns={"y1": "x1"})
    log = log.assign(x2=log["x1"] ** 2)
    with pytest.raises(ArgumentError, match=r"one output, got 2 \(x1, x2\): .* --outputs x1"):
        dt.identify(log, modes=None, delay=(0.0, 20.0), model="fopdt")
    fit = dt.identify(log, modes=None, delay=(0.0, 20.0), model="fopdt", outputs=["x1"])
    assert fit.states == ("x1",)


def test_the_command_its_json_its_page_and_its_file_say_it(tmp_path, capsys):
    log = made(first_order, (2.0, 20.0, 4.3), 0.02)
    log.to_csv(tmp_path / "log.csv", index=False)
    options = ("--one-mode", "--delay", "0", "20", "--model", "fopdt")

    def run(*more):
        with pytest.raises(SystemExit) as stopped:
            main(["identify", str(tmp_path / "log.csv"), *options, *more])
        assert stopped.value.code == 0
        return capsys.readouterr().out

    page, file = tmp_path / "page.html", tmp_path / "plant.toml"
    text = " ".join(run("--report", str(page), "--out", str(file)).split())
    assert text.startswith("Gain 2.0")
    assert "process gain time constants dead time y1 from u1" in text
    (one,) = json.loads(run("--json"))["processes"]
    assert one["gain"]["low"] < 2.0 < one["gain"]["high"]
    assert one["time_constants"][0]["value"] == pytest.approx(20.0, rel=0.05)
    assert one["dead_time"]["unit"] == "s"
    assert file.read_text("utf-8").startswith("# Gain 2.0")
    assert "<h2>Gain, time constants and dead time</h2>" in page.read_text("utf-8")


def test_fieller_s_interval_is_the_set_of_ratios_that_a_test_does_not_reject():
    rng = np.random.default_rng(0)
    for _ in range(200):
        root = rng.standard_normal((2, 2)) * rng.uniform(0.05, 1.0)
        V, above, below = root @ root.T, rng.normal(), abs(rng.normal())
        low, high = ratio_ends(above, below, V, Q)
        K = np.linspace(-50.0, 50.0, 20001)
        z2 = (above - K * below) ** 2 / (V[0, 0] - 2.0 * K * V[0, 1] + K**2 * V[1, 1])
        kept = z2 <= Q**2
        if np.isfinite([low, high]).all():
            np.testing.assert_array_equal(kept, (low <= K) & (high >= K))
        elif np.isinf([low, high]).all():  # but for a gap on one side of 0
            assert kept[K.size // 2]
            assert kept[[0, -1]].all()
        else:  # the set also has the other sign, of plants that are not stable
            own = (K > 0.0) == (above > 0.0)
            np.testing.assert_array_equal(kept[own], ((low <= K) & (high >= K))[own])


@pytest.mark.parametrize("lags", [(20.0, 6.0), (10.0, 9.0), (30.0, 5.0, 1.0)])
def test_intervals_of_time_constants_are_those_that_a_test_of_a_pole_does_not_reject(lags):
    p = np.poly(-1.0 / np.array(lags))
    n = len(lags)
    A = np.eye(n, k=1)
    A[-1] = -p[:0:-1]
    b = np.zeros((n, 1))
    b[-1] = p[-1]
    rng = np.random.default_rng(0)
    scale = 0.03 * np.abs(A[-1])
    root = rng.standard_normal((n, n)) * scale[:, None]
    covariance = np.zeros((n * n + n,) * 2)
    covariance[n * n - n : n * n, n * n - n : n * n] = root @ root.T
    transfer = TransferMatrix.of(A, b, np.eye(1, n), covariance, Q)
    pole = -np.geomspace(1e-3, 10.0, 20001)
    powers = pole[:, None] ** np.arange(n)
    value = pole**n - powers @ A[-1]
    kept = value**2 <= Q**2 * np.einsum("ka,ab,kb->k", powers, root @ root.T, powers)
    covered = np.zeros(pole.size, bool)
    for lag in lags:
        found = transfer.time_constant(-1.0 / lag)
        assert found.value == pytest.approx(lag)
        assert found.low < lag < found.high
        covered |= (-1.0 / pole >= found.low) & (-1.0 / pole <= found.high)
    np.testing.assert_array_equal(kept & covered, covered)
    near = (-1.0 / pole > 0.5 * min(lags)) & (-1.0 / pole < 2.0 * max(lags))
    assert not (kept & ~covered & near).any() or n > 2


def test_the_interval_of_a_ratio_holds_it_where_that_of_the_delta_method_does_not():
    """b and a of a short log: strongly correlated, and a known to a third."""
    rng = np.random.default_rng(1)
    V = np.array([[0.09, 0.087], [0.087, 0.09]])
    inside = []
    for above, below in rng.multivariate_normal([2.0, 1.0], V, 4000):
        low, high = ratio_ends(above, below, V, Q)
        inside.append(low <= 2.0 <= high)
    assert 0.94 < np.mean(inside) < 0.96


def test_coefficients_are_those_of_the_transfer_matrix():
    rng = np.random.default_rng(2)
    A, B, C = rng.normal(size=(4, 4)), rng.normal(size=(4, 2)), rng.normal(size=(3, 4))
    N, p = coefficients(A, B, C)
    for s in (0.3, -1.2 + 0.7j, 4.0):
        expected = C @ np.linalg.solve(s * np.eye(4) - A, B.astype(complex))
        found = sum(N[k] * s ** (3 - k) for k in range(4)) / np.polyval(p, s)
        np.testing.assert_allclose(found, expected, rtol=1e-10)


@pytest.mark.parametrize(
    ("quantity", "text"),
    [
        (Quantity(9.493, 7.274, 13.21, "s"), "9.5 s (7.3 … 13.2)"),
        (Quantity(-0.5, -0.61, -0.42), "-0.50 (-0.61 … -0.42)"),
        (Quantity(23456.0, 21000.0, 26000.0, "s"), "23500 s (21000 … 26000)"),
        (Quantity(1.0, 1.0, 1.0), "1 (1 … 1)"),
        (Quantity(2e-7, 1.5e-7, 2.5e-7), "2e-07 (1.5e-07 … 2.5e-07)"),
        (Quantity(-np.inf, -np.inf, -12.3), "at most -12.3"),
        (Quantity(1.0, -np.inf, np.inf), "not determined"),
    ],
)
def test_quantities_as_texts(quantity, text):
    assert str(quantity) == text


def test_units_are_those_in_brackets():
    names = ("Level 1 [cm]", "T (°C)", "T (2)", "x1", "a [1/min] (raw)", "[V]", "position (2) [m]")
    assert [unit_of(name) for name in names] == ["cm", "°C", "", "", "raw", "V", "m"]


def test_a_textbook_s_heat_exchanger_has_its_gain_and_lags():
    """0.8/((30 s + 1)(10 s + 1)(3 s + 1)), %TO/%CO, of which the book's two points make 33.8, 11.2.

    Smith and Corripio, "Principles and Practice of Automatic Process Control", 2nd ed., Wiley 1997,
    example 7-2.1, fit 3. In second order the shortest lag counts as dead time.
    """
    lags = 30.0, 10.0, 3.0
    late = np.linspace(0.0, 300.0, 30001)

    def rise(s):
        """Of unequal lags: 1 − Σ T_i^2 e^(−s/T_i) / Π_k≠i (T_i − T_k)."""
        shares = [T**2 / np.prod([T - other for other in lags if other != T]) for T in lags]
        return 1.0 - sum(share * np.exp(-s / T) for share, T in zip(shares, lags, strict=True))

    first, second = np.interp([0.283, 0.632], rise(late), late)
    lag = 1.5 * (second - first)
    assert lag == pytest.approx(33.8, rel=0.02)
    assert second - lag == pytest.approx(11.2, rel=0.02)
    t, rng = np.arange(0.0, 500.0, 2.0), np.random.default_rng(0)
    u = 60.0 + 5.0 * (t >= 60.0) - 8.0 * (t >= 280.0)
    y = 52.0 + 0.8 * (
        5.0 * rise(np.maximum(t - 60.0, 0.0)) - 8.0 * rise(np.maximum(t - 280.0, 0.0))
    )
    log = pd.DataFrame({"t": t, "y1: TO": y + 0.02 * rng.standard_normal(t.size), "u1: CO": u})
    (one,) = dt.identify(log, modes=None, delay=(0.0, 40.0), model="sopdt").processes
    assert one.gain.low < 0.8 < one.gain.high
    slow, fast = one.time_constants
    assert slow.value == pytest.approx(30.0, rel=0.03)
    assert fast.value == pytest.approx(10.0, rel=0.15)
    assert one.dead_time.value == pytest.approx(3.0, abs=0.8)
