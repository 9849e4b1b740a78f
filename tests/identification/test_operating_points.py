"""Plants that rest elsewhere than at 0: what a log tells of where, and what a file keeps of it."""

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.problems import load_problem
from synthetic_logs import Plant

H = 0.05
SLOW, FAST = [[0.0, 1.0], [-2.0, -1.0]], [[0.0, 1.0], [-3.0, -0.5]]
TWO = Plant([SLOW, FAST], [[[0.0], [1.0]]] * 2, 0.312, 1e-3 * np.eye(2))


def logged(x0=(0.0, 0.0), u0=0.0, jitter=0.0, sensor=0.0, count=400):
    rng = np.random.default_rng(3)
    t = H * (np.arange(count) + jitter * rng.uniform(-1.0, 1.0, count))
    mode = (np.arange(count) // 25) % 2
    y, u = TWO.log(t, rng.standard_normal((count, 1)), rng, mode, sensor=sensor)
    columns = {"t": t, "mode": mode, "x1": y[:, 0] + x0[0], "x2": y[:, 1] + x0[1]}
    return pd.DataFrame({**columns, "u1": u[:, 0] + u0})


@pytest.mark.parametrize("jitter", [0.0, 0.3], ids=["even", "uneven"])
def test_the_point_that_all_modes_rest_at_is_found_and_the_plant_is_that_about_it(jitter):
    plain = dt.identify(logged(jitter=jitter), delay=(0.0, 1.0))
    assert plain.operating_point is None
    fit = dt.identify(logged((30.0, -4.0), 45.0, jitter), delay=(0.0, 1.0))
    assert fit.operating_point.x == pytest.approx([30.0, -4.0], abs=0.1)
    assert fit.operating_point.u == pytest.approx([45.0], abs=0.2)
    assert not fit.offset.any()
    assert fit.delays == pytest.approx(plain.delays, abs=2e-3)
    np.testing.assert_allclose(fit.plant.A, plain.plant.A, atol=0.1)
    assert len(fit.uncertain.covariance) == len(plain.uncertain.covariance)


@pytest.mark.long
def test_noisy_sensors_tell_the_operating_point_too():
    fit = dt.identify(logged((30.0, -4.0), 45.0, sensor=0.02), delay=(0.0, 1.0))
    assert fit.noise.any()
    assert fit.operating_point.x == pytest.approx([30.0, -4.0], abs=0.2)


def test_a_saved_file_keeps_the_operating_point_and_what_modes_add_there(tmp_path):
    log = logged((30.0, -4.0), 45.0)
    fit = dt.identify(log, delay=(0.0, 1.0))
    fit.save(tmp_path / "found.toml")
    problem = load_problem(tmp_path / "found.toml")
    np.testing.assert_allclose(problem.operating_point.x, fit.operating_point.x)
    np.testing.assert_allclose(problem.operating_point.u, fit.operating_point.u)
    assert np.abs(problem.x0).max() < 10.0  # deviations


def test_modes_that_rest_apart_have_offsets():
    """A force on the position in one mode alone: there the speed rests elsewhere."""
    force = np.array([[0.0, 0.0], [0.5, 2.0]])
    B = [[[0.0, a], [1.0, b]] for a, b in force]
    mode, rng = logged()["mode"].to_numpy(), np.random.default_rng(3)
    u = np.column_stack((rng.standard_normal(mode.size), np.ones(mode.size)))
    t = H * np.arange(mode.size)
    y, u = Plant([SLOW, FAST], B, [0.312, 0.3], TWO.W).log(t, u, rng, mode)
    table = {"t": t, "mode": mode, "x1": y[:, 0] + 5.0, "x2": y[:, 1], "u1": u[:, 0]}
    fit = dt.identify(pd.DataFrame(table).iloc[20:], delay=(0.0, 1.0))
    point = fit.operating_point
    for i, A in enumerate(np.array([SLOW, FAST])):
        rest = np.array([5.0, 0.0]) - np.linalg.solve(A, force[i])
        added = fit.offset[i] - fit.plant.B[i] @ point.u
        found = point.x - np.linalg.solve(fit.plant.A[i], added)
        assert found == pytest.approx(rest, abs=0.2)
    assert "modes rest apart" in fit.message


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("x = [1.0]\nu = [0.0]", r"\[operating_point\].*x must have shape \(n,\) = \(2,\)"),
        (
            "x = [1.0, 2.0]\nu = [0.0, 1.0]",
            r"\[operating_point\].*u must have shape \(m,\) = \(1,\)",
        ),
        ("x = [1.0, nan]\nu = [0.0]", r"\[operating_point\]: x\[1\] must be finite"),
    ],
)
def test_an_operating_point_of_other_sizes_is_refused_by_its_section(tmp_path, lines, message):
    path = tmp_path / "found.toml"
    path.write_text(
        f"""[plant]
delay = 0.3
A = [[[0.0, 1.0], [-1.0, -1.0]], [[0.0, 1.0], [-2.0, -1.0]]]
B = [[[0.0], [1.0]], [[0.0], [1.0]]]
[operating_point]
{lines}
[gains]
poles = [-1.0, -2.0]
[signal]
kind = "constant"
mode = 0
[run]
x0 = [1.0, 0.0]
horizon = 2.0
""",
        encoding="utf-8",
    )
    with pytest.raises(dt.ArgumentError, match=message):
        load_problem(path)


def weak(seed, x0, u0, sensor=0.0, count=300):
    """A slow lag, moved a little: its log hardly contradicts that it rests at 0."""
    rng, plant = (
        np.random.default_rng(seed),
        Plant([[[-1 / 3]]], [[[0.8 / 3]]], 0.73, 0.02 * np.eye(1)),
    )
    u = 2.0 * np.repeat(rng.choice([-1.0, 1.0], count // 10), 10)[:, None]
    t = 0.1 * np.arange(count)
    y, u = plant.log(t, u, rng, sensor=sensor)
    return pd.DataFrame({"t": t, "x1": y[:, 0] + x0, "u1": u[:, 0] + u0})


@pytest.mark.parametrize(
    ("seed", "x0", "u0", "sensor"),
    [
        (1, 21.0, 40.0, 0.0),
        (2, 294.15, 0.4, 0.0),
        pytest.param(3, -21.0, 40.0, 0.05, marks=pytest.mark.long),
        pytest.param(4, 21.0, 40.0, 0.05, marks=pytest.mark.long),
    ],
)
def test_matrices_are_the_same_whatever_level_a_log_is_about(seed, x0, u0, sensor):
    """As far from 0 as it moves little: that it rests at 0 would give A x̄ = −B ū for certain."""
    plain = dt.identify(weak(seed, 0.0, 0.0, sensor), modes=None)
    fit = dt.identify(weak(seed, x0, u0, sensor), modes=None)
    assert plain.operating_point is None
    assert fit.operating_point is not None
    half = np.diff(plain.interval("A[0][0,0]"))[0] / 2.0
    assert abs(fit.plant.A - plain.plant.A) < 0.5 * half
    assert fit.interval("A[0][0,0]")[0] < -1 / 3 < fit.interval("A[0][0,0]")[1]
    assert fit.delays == pytest.approx(plain.delays, abs=0.02)


def test_modes_whose_rests_hardly_differ_rest_within_the_log():
    """Their equilibria are nearly parallel and meet far off, where nothing was logged."""
    rng, count = np.random.default_rng(0), 400
    plant = Plant(
        [[[-0.2]], [[-0.5]]], [[[0.21, 3.0]], [[0.5, 9.0]]], [0.31, 0.0], 1e-4 * np.eye(1)
    )
    mode = (np.arange(count) // 20) % 2
    u = np.column_stack((4.0 + rng.standard_normal(count), np.ones(count)))
    y, u = plant.log(H * np.arange(count), u, rng, mode)
    table = {"t": H * np.arange(count), "mode": mode, "x1": y[:, 0], "u1": u[:, 0]}
    log = pd.DataFrame(table).iloc[100:]
    fit = dt.identify(log, delay=(0.0, 1.0))
    point = fit.operating_point
    for value, column in ((point.x[0], log["x1"]), (point.u[0], log["u1"])):
        beside = 0.11 * np.ptp(column)
        assert column.min() - beside <= value <= column.max() + beside
    still = fit.plant.A @ point.x + fit.plant.B @ point.u - fit.offset
    np.testing.assert_allclose(still[:, 0], [-3.0, -9.0], rtol=0.15)
