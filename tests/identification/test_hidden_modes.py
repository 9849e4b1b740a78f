"""Modes that were not logged: what they are found to be, how well, and what is refused."""

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.identification.expectation_maximisation import draw_start, stretches_of
from deadtime.identification.hidden_estimate import DecodedFit
from deadtime.identification.hidden_fit import HiddenFit
from deadtime.identification.identify_hidden import (
    TriedNumbers,
    best_of,
    numbers_of,
    of_numbers,
)
from deadtime.identification.likelihoods.hidden_chain import Periods
from deadtime.identification.log.recording import Part
from deadtime.identification.parameters import Layout
from deadtime.identification.sampling import EvenSampling
from synthetic_logs import Plant, oscillator

H = 0.05
THIRD_ORDER = Plant(
    [
        [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, -3.0, -2.0]],
        [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-6.0, -3.0, -1.5]],
        [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-2.0, -8.0, -1.0]],
    ],
    [
        [[0.0, 0.3], [0.0, 0.0], [1.0, 0.0]],
        [[0.0, 0.3], [0.0, 0.5], [1.5, 0.0]],
        [[0.0, -0.3], [0.2, 0.0], [-1.0, 0.0]],
    ],
    [0.312, 0.174],
    1e-4 * np.eye(3),
)


def stiffer(D=0.312, W=1e-4):
    """A slow and a stiff mode."""
    plant = oscillator(D, W)
    plant.A[1] = [[0.0, 1.0], [-6.0, -0.5]]
    return plant


def made(plant, count=400, seed=0):
    """A log without its modes, and these; they last 10 to 30 rows."""
    rng, (modes, _, m) = np.random.default_rng(seed), plant.B.shape
    mode = np.repeat(np.arange(count) % modes, rng.integers(10, 31, count))[:count]
    y, u = plant.log(H * np.arange(count), rng.standard_normal((count, m)), rng, mode)
    return table(H * np.arange(count), y, u), mode


def table(t, y, u):
    columns = {"t": t} | {f"x{i + 1}": x for i, x in enumerate(y.T)}
    return pd.DataFrame(columns | {f"u{j + 1}": one for j, one in enumerate(u.T)})


def found(log, modes: Any = 2, switches="samples", **how) -> Any:
    return dt.identify(log, modes=modes, delay=(0.0, 0.6), switches=switches, **how)


def matched(fit, mode):
    """The numbering of modes under which most rows are right, and their share."""
    orders = itertools.permutations(range(fit.plant.modes))
    return max((np.mean(np.array(o)[fit.hidden.mode] == mode), o) for o in orders)


@pytest.mark.long
def test_three_modes_with_two_inputs_are_found_with_the_delay_of_each():
    log, mode = made(THIRD_ORDER)
    fit = found(log, 3)
    share, order = matched(fit, mode)
    assert share > 0.97
    off = np.abs(fit.delays[0] - THIRD_ORDER.D[0])
    assert (off < 0.75 * np.diff(fit.delay_interval[0])[:, 0]).all()
    assert (off < [1e-3, 3e-3]).all()
    np.testing.assert_allclose(fit.plant.A, THIRD_ORDER.A[list(order)], atol=0.7)
    assert (np.diff(fit.hidden.likelihoods) > -1e-8).all()
    assert fit.hidden.probability.shape == (400, 3)
    np.testing.assert_allclose(fit.hidden.probability.sum(axis=1), 1.0)
    seen = list(dict.fromkeys(fit.hidden.mode.tolist()))
    assert seen == [0, 1, 2]
    assert "looks like chance" in fit.message


@pytest.mark.long
def test_modes_that_lie_far_apart_are_as_good_as_logged():
    log, mode = made(stiffer(W=1e-7), seed=2)
    hidden, logged = (
        found(log),
        dt.identify(log.assign(mode=mode), delay=(0.0, 0.6), switches="samples", noise=False),
    )
    share, order = matched(hidden, mode)
    assert share > 0.98
    order = np.argsort(order)
    np.testing.assert_allclose(hidden.plant.A[order], logged.plant.A, atol=2e-2)
    assert hidden.interval("delay") == pytest.approx(logged.interval("delay"), abs=1e-5)


@pytest.mark.parametrize("noise", [1e-2, pytest.param(1e-4, marks=pytest.mark.long)])
def test_the_likelihood_never_falls(noise):
    fit = found(made(stiffer(W=noise), 300, seed=3)[0])
    assert (np.diff(fit.hidden.likelihoods) > -1e-8).all()
    assert fit.hidden.likelihoods.size > 3


def test_the_number_of_modes_is_found_by_bic():
    fit = found(made(stiffer(), 300)[0], range(1, 4))
    assert fit.plant.modes == 2
    assert "2 modes of 1 to 3: BIC is least" in fit.message
    one = Plant(stiffer().A[:1], stiffer().B[:1], 0.312, 1e-4 * np.eye(2))
    fit = found(made(one, 300)[0], (1, 2))
    assert fit.plant.modes == 1
    assert fit.hidden is None
    assert "1 mode of 1 to 2" in fit.message


def test_identical_modes_are_said_to_be_alike():
    twice = Plant(stiffer().A[[0, 0]], stiffer().B[[0, 0]], 0.312, 1e-4 * np.eye(2))
    said = found(made(twice, 300, seed=1)[0]).message
    assert "1 mode explains the log better" in said
    assert "alike" in said


@pytest.mark.long
def test_every_mode_may_have_its_own_delay_and_inputs_of_opposite_sign():
    plant = Plant(oscillator().A, [[[0.0], [1.0]], [[0.0], [-1.0]]], [[0.312], [0.104]])
    plant.W = 1e-4 * np.eye(2)
    log, mode = made(plant, 400, seed=4)
    fit = found(log, per_mode=True)
    share, order = matched(fit, mode)
    assert share > 0.97
    assert np.abs(fit.delays - plant.D[list(order)]).max() < 1.5e-3


@pytest.mark.long
def test_switches_between_samples_cost_their_periods_and_no_bias():
    """Rows at every switch, too, of which only those on the grid are kept."""
    plant, rng, count = stiffer(), np.random.default_rng(6), 500
    switch = np.cumsum(rng.uniform(0.5, 1.5, count))
    switch = switch[switch < H * (count - 1)]
    grid, t = H * np.arange(count), np.unique(np.append(H * np.arange(count), switch))
    mode = np.searchsorted(switch, t, side="right") % 2
    held = rng.standard_normal((count, 1))[np.searchsorted(grid, t, side="right") - 1]
    y, u = plant.log(t, held, rng, mode)
    kept = np.searchsorted(t, grid)
    fit = found(table(grid, y[kept], u[kept]), switches="anywhere")
    share, _ = matched(fit, mode[kept])
    assert share > 0.93
    low, high = fit.interval("delay")
    assert low - 0.5 * (high - low) < 0.312 < high + 0.5 * (high - low)
    assert high - low < 2e-3


def test_missing_rows_and_several_logs_are_taken():
    log, mode = made(stiffer(), 400, seed=5)
    log.loc[100:102, "x1"] = np.nan
    log.loc[200, "u1"] = np.nan
    fit = found([log.iloc[:250], log.iloc[250:255], log.iloc[255:]])  # the second tells nothing
    assert fit.hidden.mode.size == 400
    assert matched(fit, mode)[0] > 0.9
    assert abs(fit.delays[0, 0] - 0.312) < 1e-3
    assert "looks like chance" in fit.message


GOOD = made(stiffer(), 120)[0]
REFUSED = [
    (GOOD, {"modes": 0}, "modes must be the column of the mode, None for one mode, or"),
    (GOOD, {"modes": True}, "got True"),
    (GOOD, {"modes": []}, "got \\[\\]"),
    (GOOD, {"modes": range(2)}, "got range\\(0, 2\\)"),
    (GOOD * [1, 1e-150, 1e-150, 1], {}, "x1 must be of a size between 1e-70 and 1e\\+70"),
    (GOOD.iloc[:60], {"modes": 12}, "modes = 12 is too many for this log: 47 periods in it"),
    (GOOD.iloc[:15], {"modes": (1, 2)}, "log is too short: 2 periods in it have inputs and ends"),
    (GOOD.iloc[:70], {"modes": 5}, "modes = 5 is too many for this log"),
]


@pytest.mark.parametrize(("log", "how", "message"), REFUSED)
def test_what_hidden_modes_cannot_be_found_in_is_refused(log, how, message):
    with pytest.raises(dt.ArgumentError, match=message):
        found(log, **{"modes": 2, **how})


def test_a_number_of_modes_is_whole():
    with pytest.raises(dt.ArgumentError, match=r"modes must be the column .* got 2\.5"):
        numbers_of(2.5)
    assert numbers_of([3, 1, 3]) == (1, 3)


def test_the_next_number_is_taken_where_the_likeliest_path_leaves_a_mode_out():
    """Fits that are numbers and BIC alone: no log is known that always ends so."""

    def fit(modes: int, bic: float) -> Any:
        log = SimpleNamespace(layout=Layout(modes, 1, 1, False))
        one = object.__new__(HiddenFit)
        vars(one).update(log=log, bic=bic)
        return one

    path: DecodedFit[Any] = object.__new__(DecodedFit)

    def decode(one: Any) -> Any:
        if one.layout.modes == 3:
            raise dt.ArgumentError("a mode is left out")
        return path

    tried = TriedNumbers([fit(2, 20.0), fit(3, 10.0)], (2, 3), None)
    best, found, left_out = best_of(tried, decode)
    assert best.layout.modes == 2
    assert found is path
    assert left_out == [3]
    said = of_numbers(2, tried, left_out)[0]
    assert said.endswith("20.0 with 2, 10.0 with 3; that of 3 leaves one out.")
    with pytest.raises(dt.ArgumentError, match="a mode is left out"):
        best_of(TriedNumbers([fit(3, 10.0)], (3,), None), decode)


def test_uneven_rows_tell_modes_as_even_ones_do():
    plant, rng, count = stiffer(), np.random.default_rng(0), 300
    t = np.cumsum(H * rng.uniform(0.5, 1.5, count))
    mode = np.repeat(np.arange(count) % 2, rng.integers(10, 31, count))[:count]
    log = table(t, *plant.log(t, rng.standard_normal((count, 1)), rng, mode))
    fit = found(log)
    share, _ = matched(fit, mode)
    assert share > 0.95
    low, high = fit.interval("delay")
    assert low - 0.5 * (high - low) < 0.312 < high + 0.5 * (high - low)
    assert high - low < 2e-3
    assert (np.diff(fit.hidden.likelihoods) > -1e-8).all()
    np.testing.assert_allclose(fit.hidden.chain.sum(axis=1), 1.0)


@pytest.mark.long
def test_intervals_hold_the_delay_where_many_rows_are_wrong():
    inside, right = [], []
    for seed in range(40):
        log, mode = made(stiffer(W=1e-2), 400, seed)
        fit = found(log, noise=False)
        low, high = fit.interval("delay")
        inside.append(low < 0.312 < high)
        right.append(matched(fit, mode)[0])
    assert 0.7 < np.mean(right) < 0.95
    assert np.sum(inside) >= 34


def test_a_log_without_noise_is_told_where_modes_change_anywhere():
    plant = Plant([[[-1.0]], [[-4.0]]], [[[1.0]], [[3.0]]], 0.312, np.zeros((1, 1)))
    log, mode = made(plant, 240, seed=1)
    fit = found(log, switches="anywhere")
    assert matched(fit, mode)[0] > 0.9
    assert abs(fit.delays[0, 0] - 0.312) < 1e-4


def test_a_start_has_a_covariance_where_noise_enters_at_the_end_of_a_chain_of_states():
    """What a period adds is then nearly of one direction: medians of its entries are indefinite."""
    n, h, rng = 4, 0.05, np.random.default_rng(0)
    A = np.diag(np.ones(n - 1), 1)
    A[-1] = -np.poly(-np.ones(n))[:0:-1]
    plant = Plant([A], [np.eye(n)[:, 3:]], h, np.diag([1e-15, 1e-15, 1e-15, 1e-2]))
    y, u = plant.log(h * np.arange(400), rng.standard_normal((400, 1)), rng)
    part = Part(h * np.arange(400), y, u, np.zeros(400, np.int64))
    layout = Layout(2, n, 1, per_mode=False)
    sampling = EvenSampling(h, np.zeros(0))
    periods = Periods.of(sampling, (part,), (0.0, 4 * h), None, constant=False)
    stretches = stretches_of(periods, layout)
    assert stretches is not None
    for _ in range(3):
        start = draw_start(periods, stretches, np.array([1]), layout, rng)
        assert (np.linalg.eigvalsh(start.S) > 0.0).all()


def test_a_faint_input_leaves_delays_open_that_lie_far_from_the_likeliest():
    """The likeliest lies 0.6 s off; the interval goes on to all peaks of the range, and says so."""
    rng, count, plant = np.random.default_rng(11), 300, stiffer(W=1e-3)
    mode = np.repeat(np.arange(count) % 2, rng.integers(10, 31, count))[:count]
    u = 0.05 * rng.standard_normal((count, 1))
    log = table(H * np.arange(count), *plant.log(H * np.arange(count), u, rng, mode))
    fit = dt.identify(log, modes=2, delay=(0.0, 1.0), switches="samples")
    low, high = fit.interval("delay")
    assert low < 0.312 < high
    assert "others that lie apart explain it nearly as well" in fit.message


def resting(terms, count=400, seed=0, even=True, at=0.0, sensor=0.0):
    """A log of modes with constant terms, and these modes; inputs are `at` a level on average."""
    plant, rng = stiffer(), np.random.default_rng(seed)
    with_terms = np.concatenate((plant.B, np.array(terms)[:, :, None]), axis=2)
    t = H * np.arange(count) if even else np.cumsum(H * rng.uniform(0.5, 1.5, count))
    mode = np.repeat(np.arange(count) % 2, rng.integers(10, 31, count))[:count]
    u = np.column_stack((at + rng.standard_normal(count), np.ones(count)))
    made_of = Plant(plant.A, with_terms, [0.312, 0.0], plant.W)
    y, u = made_of.log(t, u, rng, mode, sensor)
    return table(t, y, u[:, :1]), mode


SAME, APART, OPPOSITE = [[0.0, 40.0], [0.0, 120.0]], [[2.0, 9.0], [-1.0, 3.0]], [[0, 2.0], [0, -2]]


@pytest.mark.parametrize(
    ("terms", "even"),
    [
        (SAME, True),
        pytest.param(SAME, False, marks=pytest.mark.long),
        pytest.param(APART, True, marks=pytest.mark.long),
        pytest.param(APART, False, marks=pytest.mark.long),
        pytest.param(OPPOSITE, True, marks=pytest.mark.long),
    ],
)
def test_modes_that_rest_elsewhere_than_at_0_are_told_with_where_they_rest(terms, even):
    """Of an oscillator, ẋ₁ = x₂: all that is told of where it rests is A x₀ + B u₀ + c_i = 0."""
    log, mode = resting(terms, even=even)
    fit = found(log)
    share, order = matched(fit, mode)
    assert share > 0.95
    low, high = fit.interval("delay")
    assert low - 0.5 * (high - low) < 0.312 < high + 0.5 * (high - low)
    assert high - low < 5e-3
    rest = fit.operating_point
    assert rest is not None
    still = fit.plant.A @ rest.x + fit.plant.B @ rest.u - fit.offset
    np.testing.assert_allclose(-still, np.array(terms, float)[list(order)], atol=0.35)
    assert fit.tests.white


@pytest.mark.long
def test_modes_that_rest_elsewhere_are_told_behind_noisy_sensors():
    log, mode = resting(SAME, sensor=0.02, count=600)
    fit = found(log)
    assert matched(fit, mode)[0] > 0.75
    low, high = fit.interval("delay")
    assert low - 0.5 * (high - low) < 0.312 < high + 0.5 * (high - low)
    np.testing.assert_allclose(fit.noise, 0.02, rtol=0.3)
    assert fit.operating_point is not None
    still = fit.plant.A @ fit.operating_point.x + fit.plant.B @ fit.operating_point.u - fit.offset
    np.testing.assert_allclose(-still[:, 0], 0.0, atol=0.5)


@pytest.mark.parametrize("sensor", [0.0, pytest.param(0.02, marks=pytest.mark.long)])
def test_inputs_that_are_not_0_on_average_are_no_level(sensor):
    log, mode = resting(np.zeros((2, 2)), at=3.0, sensor=sensor)
    fit = found(log)
    assert matched(fit, mode)[0] > 0.75
    assert fit.operating_point is None
    low, high = fit.interval("delay")
    assert low - 0.5 * (high - low) < 0.312 < high + 0.5 * (high - low)
