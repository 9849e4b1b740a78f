"""How large inputs become, beside runs of exponentials, closed forms, and a quadrature."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.special import erf, erfinv

import deadtime as dt
from deadtime.synthesis import input_peak

A, B, K = np.array([[0.0, 1.0], [2.0, -0.4]]), np.array([[0.0], [1.0]]), np.array([[-3.04, 0.0]])
H, N = 0.05, 6  # the delay holds six periods
PLANT = dt.SwitchedSystem(A[None], B[None], N * H)
LAW = dt.SingleModePredictor(PLANT, K[None], 0)


def rows_by_exponentials(count=700):
    """u_k = M_k x(0), from the predictor's formula and the plant's, by matrix exponentials."""
    block = np.zeros((3, 3))
    block[:2, :2], block[:2, 2:] = A * H, B * H
    Phi, Gamma = expm(block)[:2, :2], expm(block)[:2, 2:]
    x, line, rows = np.eye(2), [np.zeros((1, 2))] * N, []
    for _ in range(count):
        ahead = expm(A * N * H) @ x
        for j, u in enumerate(line):  # the latest first
            ahead = ahead + np.linalg.matrix_power(Phi, j) @ Gamma @ u
        u = K @ ahead
        x = Phi @ x + Gamma @ line[-1]
        line = [u, *line[:-1]]
        rows.append(u[0])
    return np.array(rows)


ROWS = rows_by_exponentials()
X = np.array([[0.5, -0.2], [-0.2, 0.3]])


@pytest.mark.parametrize(
    ("initial", "sizes", "worst"),
    [
        (
            dt.InitialStates.ball(2.0),
            2.0 * np.linalg.norm(ROWS, axis=1),
            lambda row: 2.0 * row / np.linalg.norm(row),
        ),
        (
            dt.InitialStates.box([0.3, 1.5]),
            np.abs(ROWS) @ [0.3, 1.5],
            lambda row: np.sign(row) * [0.3, 1.5],
        ),
    ],
)
def test_the_worst_case_is_that_of_exponentials_and_a_run_from_there_attains_it(
    initial, sizes, worst
):
    found = input_peak(PLANT, LAW, H, initial)
    assert found.level[0, 0] == pytest.approx(sizes.max(), rel=1e-10)
    assert found.time[0, 0] == pytest.approx(H * sizes.argmax())
    assert (found.least == found.level).all()
    start = worst(ROWS[sizes.argmax()])
    run = dt.simulate(PLANT, LAW, dt.SwitchingSignal.constant(0), start, 5.0, H)
    assert np.abs(run.inputs).max() == pytest.approx(found.level[0, 0], rel=1e-9)


def test_fractional_delays_of_two_inputs_are_those_of_runs_in_every_mode():
    rng = np.random.default_rng(3)
    plant = dt.SwitchedSystem(
        rng.normal(size=(2, 2, 2)) / 2.0, np.eye(2) + 0.1 * rng.normal(size=(2, 2, 2)), [0.13, 0.27]
    )
    law = dt.DelayedStateFeedback(plant, np.tile(-1.2 * np.eye(2), (2, 1, 1)))
    found = input_peak(plant, law, H, dt.InitialStates.box([1.0, 0.5]))
    for mode in range(2):
        signal = dt.SwitchingSignal.constant(mode)
        runs = [
            dt.simulate(plant, law, signal, x0, 12.0, H).inputs for x0 in ([1.0, 0.0], [0.0, 0.5])
        ]
        sizes = np.abs(runs).sum(axis=0)
        assert found.level[mode] == pytest.approx(sizes.max(axis=1), rel=1e-9)
        assert found.time[mode] == pytest.approx(H * sizes.argmax(axis=1))


def kept(level):
    """The probability that no |u_k| exceeds a level, of x(0) ~ N(0, X): by angles of two states."""
    theta = np.linspace(0.0, np.pi, 4001)[:-1]
    directions = np.linalg.cholesky(X) @ np.stack([np.cos(theta), np.sin(theta)])
    reach = np.abs(ROWS @ directions).max(axis=0)
    return float(np.mean(1.0 - np.exp(-0.5 * (level / reach) ** 2)))


@pytest.mark.few(1)
@pytest.mark.parametrize("part", [0.5, 0.9, 0.999])
def test_the_level_of_a_normal_start_is_kept_as_often_as_it_says_and_no_lower_one_than_least(part):
    found = input_peak(PLANT, LAW, H, dt.InitialStates.normal(X, part))
    level, least = found.level[0, 0], found.least[0, 0]
    assert kept(level) >= part >= kept(least)
    assert least < level
    draws = np.random.default_rng(1).multivariate_normal([0.0, 0.0], X, 20_000)
    share = np.mean(np.abs(draws @ ROWS.T).max(axis=1) <= level)
    assert share == pytest.approx(kept(level), abs=4.0 * np.sqrt(0.25 / 20_000))


def test_of_one_state_the_level_is_a_quantile():
    plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], 0.2)
    law = dt.SingleModePredictor(plant, [[[-2.0]]], 0)
    found = input_peak(plant, law, H, dt.InitialStates.normal([0.25], 0.95))
    expected = 2.0 * np.exp(0.2) * 0.5 * np.sqrt(2.0) * erfinv(0.95)
    assert found.level[0, 0] == pytest.approx(expected, rel=1e-9)
    assert found.least[0, 0] == pytest.approx(expected, rel=1e-9)
    assert erf(found.level[0, 0] / (np.sqrt(2.0) * np.exp(0.2))) == pytest.approx(0.95)


def test_a_loop_that_grows_has_no_largest_input():
    law = dt.SingleModePredictor(PLANT, 0.01 * K[None], 0, allow_unstable=True)
    found = input_peak(PLANT, law, H)
    assert np.isinf(found.level).all()
    assert np.isnan(found.time).all()


def test_so_has_one_whose_inputs_are_small_before_it_grows_or_never_come():
    hidden = dt.SwitchedSystem([np.diag([-60.0, 0.02])], [[[1e-9], [0.0]]], 0.1)
    late = dt.DelayedStateFeedback(hidden, [[[-1e8, -1e-3]]], allow_unstable=True)
    idle = dt.AveragedPredictor(PLANT, 0.0 * K[None], allow_unstable=True)
    for law in (late, idle):
        found = input_peak(law.plant, law, H)
        assert np.isinf(found.level).all()
        assert np.isnan(found.time).all()
    resting = dt.SwitchedSystem([[[-1.0]]], [[[1.0]]], 0.1)
    assert input_peak(resting, dt.DelayedStateFeedback(resting, [[[0.0]]]), H).level == 0.0


SETS = dt.InitialStates


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SETS.ball(0.0), "radius must be positive"),
        (lambda: SETS.box([1.0, -1.0]), "half_widths must be 0 or more and not all 0"),
        (lambda: SETS.normal([[1.0, 2.0], [2.0, 1.0]]), "covariance must be positive semidefinite"),
        (lambda: SETS.normal([0.0, 0.0]), "covariance must not be 0"),
        (lambda: SETS.normal([1.0], 1.0), "probability must be above 0 and below 1, got 1"),
        (
            lambda: input_peak(PLANT, LAW, H, SETS.box([1.0])),
            "initial must be of n = 2 states, got a box of 1",
        ),
        (
            lambda: input_peak(PLANT, dt.ExactPredictor(PLANT, K[None]), H),
            "law must be a table that can run, got ExactPredictor",
        ),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(make, message):
    with pytest.raises(dt.ArgumentError, match=message):
        make()
