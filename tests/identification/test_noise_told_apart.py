"""Noise of which some is missing, or is another one's; and what is saved of noise by mode."""

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.imperfections import WhiteDisturbance
from deadtime.problems import load_problem
from synthetic_logs import Plant

STEP, DELAYS = 0.05, (0.12, 0.185)
A = [
    [[0.0, 1.0, 0.0], [0.0, -0.4, 1.0], [0.0, 0.0, -3.0]],
    [[0.0, 1.0, 0.0], [-1.0, -1.1, 1.0], [0.0, 0.3, -2.0]],
    [[0.0, 1.0, 0.0], [-4.0, -0.2, 0.8], [0.2, 0.0, -4.0]],
]
B = [
    [[0.0, 0.3], [0.5, 0.0], [3.0, 1.0]],
    [[0.0, 0.3], [0.5, 0.0], [2.0, 1.5]],
    [[0.0, 0.3], [0.0, 0.6], [3.0, 1.0]],
]
SPEEDS, NOISY = np.diag([0.0, 0.04, 0.01]), np.diag([1e-4, 0.04, 0.01])
PLANTS = {
    "white on speeds alone": Plant(A, B, DELAYS, SPEEDS),
    "a state without any": Plant(A, B, DELAYS, added=[[0.0, 0.0], [0.05, 0.0], [0.0, 0.1]]),
    "one in all states": Plant(A, B, DELAYS, added=[[0.02], [-0.05], [0.1]]),
    "none at all": Plant(A, B, DELAYS),
}


def log_of(plant, lasts, count=900, seed=2):
    """A table of a log in which the modes take turns, so many samples each."""
    rng, t = np.random.default_rng(seed), STEP * np.arange(count)
    mode = np.repeat(np.arange(len(lasts)) % 3, lasts)[:count]
    y, u = plant.log(t, rng.standard_normal((count, 2)), rng, mode)
    columns = {f"x{i + 1}": x for i, x in enumerate(y.T)}
    return pd.DataFrame({"t": t, "u1": u[:, 0], "u2": u[:, 1], "mode": mode} | columns)


def share_within(fit, plant):
    """Of all entries and delays, how many lie in their intervals."""
    true = {f"A[{i}][{a},{b}]": plant.A[i, a, b] for i, a, b in np.ndindex(plant.A.shape)}
    true |= {f"B[{i}][{a},{b}]": plant.B[i, a, b] for i, a, b in np.ndindex(plant.B.shape)}
    true |= {f"delay[{j}]": D for j, D in enumerate(DELAYS)}
    ends = {name: fit.interval(name) for name in true}
    return np.mean([low <= true[name] <= high for name, (low, high) in ends.items()])


@pytest.mark.parametrize("case", PLANTS)
def test_noise_that_is_singular_leaves_every_unknown_told(case):
    plant = PLANTS[case]
    log = log_of(plant, [15] * 60)
    fit = dt.identify(log, delay=(0.0, 0.4), noise=False, switches="samples")
    assert share_within(fit, plant) > 0.85
    assert np.abs(fit.delays - DELAYS).max() < 0.01
    if case == "none at all":
        np.testing.assert_allclose(fit.plant.A, plant.A, atol=1e-8)
    if case == "white on speeds alone":
        np.testing.assert_allclose(fit.disturbance, np.tile(plant.W, (3, 1, 1)), atol=0.012)
        lows = [fit.interval(f"disturbance[{i}][0,0]")[0] for i in range(3)]
        assert sorted(lows)[1] == 0.0  # a position's own noise may be none, in two modes of three
    if plant.added is not None:  # in a short period W is what it adds, by its length
        S = plant.added @ plant.added.T / STEP
        np.testing.assert_allclose(fit.disturbance, np.tile(S, (3, 1, 1)), atol=0.3 * S.max())


def test_modes_that_nobody_logged_are_told_where_a_state_has_no_noise():
    plant = Plant(np.array(A)[:2], np.array(B)[:2], DELAYS, added=[[0.0], [0.05], [0.0]])
    log = log_of(plant, [0, 0, 0] + [40, 40, 0] * 12)
    fit = dt.identify(log, modes=2, delay=(0.0, 0.4), switches="samples")
    assert np.mean(fit.hidden.mode == log["mode"]) > 0.95
    assert np.abs(fit.delays - DELAYS).max() < 0.01


def test_what_is_saved_has_the_noise_of_every_mode_to_the_last_bit(tmp_path):
    W = np.multiply.outer([1.0, 16.0, 0.25], NOISY + 0.005)
    lasts = np.random.default_rng(1).integers(8, 18, 120)
    fit = dt.identify(log_of(Plant(A, B, DELAYS, W), lasts), delay=(0.0, 0.4), noise=False)
    assert fit.disturbance[1, 1, 1] > 10.0 * fit.disturbance[0, 1, 1]
    fit.save(tmp_path / "mine.toml")
    problem = load_problem(tmp_path / "mine.toml")
    (white,) = [one for one in problem.imperfections if isinstance(one, WhiteDisturbance)]
    assert np.array_equal(white.intensity, fit.disturbance)
    law = problem.law("belief")
    assert np.array_equal(law.filter.disturbance, fit.disturbance)
    assert np.isfinite(problem.simulate("belief").states).all()
