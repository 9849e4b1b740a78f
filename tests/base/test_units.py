"""Units do not matter: a change of units of states, inputs or time changes no answer."""

import mpmath
import numpy as np
import pytest

import deadtime as dt
from deadtime.numerics.exponential import discretise, gramian

# A hydraulic axis in pascals, a two-mass drive, a rotation with far-apart units.
BADLY_SCALED = {
    "hydraulic axis": (
        np.array([[0.0, 1.0, 0.0], [0.0, -5.0, 1e-4], [0.0, -2e9, -40.0]]),
        np.array([[0.0], [0.0], [5e8]]),
        0.01,
    ),
    "two-mass drive": (
        np.array([[0.0, 1, 0, 0], [-1e8, -100, 1e8, 100], [0, 0, 0, 1], [1e6, 1, -1e6, -1]]),
        np.array([[0.0], [1e4], [0.0], [0.0]]),
        0.01,
    ),
    "rotation": (np.array([[0.0, 1e9], [-1e-9, 0.0]]), np.array([[0.0], [1.0]]), 1.0),
}


@pytest.mark.parametrize("name", BADLY_SCALED)
def test_transition_is_accurate_entry_by_entry_on_badly_scaled_plants(name):
    A, B, tau = BADLY_SCALED[name]
    n = A.shape[0]
    block = np.block([[A, B], [np.zeros((1, n + 1))]])
    with mpmath.workdps(60):
        exact = mpmath.expm(mpmath.matrix(block.tolist()) * mpmath.mpf(tau), method="taylor")
        exact = np.array(exact.tolist(), dtype=float)
    Phi, Gamma = discretise(A, B, tau)
    computed = np.hstack((Phi, Gamma))
    assert (np.abs(computed - exact[:n]) <= 1e-12 * np.abs(exact[:n])).all()


@pytest.mark.parametrize("name", BADLY_SCALED)
def test_gramian_transforms_as_the_units_of_the_input_do(name):
    A, B, tau = BADLY_SCALED[name]
    Q, c = gramian(A, B, tau, np.eye(len(A))), 2.0**20
    scaled = gramian(A, B * c, tau, np.eye(len(A)))
    n = A.shape[0]
    np.testing.assert_allclose(scaled[:n, n:], c * Q[:n, n:], rtol=1e-13)
    np.testing.assert_allclose(scaled[n:, n:], c * c * Q[n:, n:], rtol=1e-13)
    np.testing.assert_allclose(scaled[:n, :n], Q[:n, :n], rtol=1e-13)


@pytest.mark.parametrize("name", BADLY_SCALED)
def test_controllable_plants_are_placed_in_any_units(name):
    A, B, _ = BADLY_SCALED[name]
    n = A.shape[0]
    size = 20.0 if name != "rotation" else 1.0
    poles = -size * (1.0 + 0.3 * np.arange(n))
    t = 10.0 ** np.array([4.0, -3.0, 2.0, -5.0])[:n]
    K = dt.place(dt.SwitchedSystem(A[None], B[None], 0.1), poles)
    scaled = dt.SwitchedSystem((A * t / t[:, None])[None], (1e-3 * B / t[:, None])[None], 0.1)
    L = dt.place(scaled, poles)
    np.testing.assert_allclose(L / t * 1e-3, K, rtol=1e-6)


def test_hydraulic_run_is_the_same_in_pascals_and_in_bar():
    A, B, _ = BADLY_SCALED["hydraulic axis"]
    poles, t = [-30.0, -35.0, -40.0], np.array([1.0, 1.0, 1e5])
    runs = []
    for unit in (np.ones(3), t):
        plant = dt.SwitchedSystem((A * unit / unit[:, None])[None], (B / unit[:, None])[None], 0.05)
        law = dt.AveragedPredictor(plant, dt.place(plant, poles))
        x0 = np.array([0.1, 0.0, 1e5]) / unit
        runs.append(dt.simulate(plant, law, dt.SwitchingSignal.constant(0), x0, 0.3, step=1e-3))
    states = runs[1].states * t[:, None]
    np.testing.assert_allclose(
        states, runs[0].states, rtol=0, atol=1e-9 * np.abs(runs[0].states).max()
    )


def test_poles_that_nearly_coincide_are_placed():
    plant = dt.problems.paper().plant
    K = dt.place(plant, [-1.0, -1.0 - 1e-12])
    for i in range(2):
        np.testing.assert_allclose(np.poly(plant.A[i] + plant.B[i] @ K[i]), [1, 2, 1], rtol=1e-9)


def test_ideal_run_of_a_badly_scaled_plant_is_the_limit_of_digital_ones_in_any_units():
    A, B, _ = BADLY_SCALED["hydraulic axis"]
    signal, runs = dt.SwitchingSignal.constant(0), []
    for unit in (np.ones(3), np.array([1.0, 1.0, 1e5])):
        plant = dt.SwitchedSystem((A * unit / unit[:, None])[None], (B / unit[:, None])[None], 0.05)
        law = dt.AveragedPredictor(plant, dt.place(plant, [-30.0, -35.0, -40.0]))
        x0 = np.array([0.1, 0.0, 1e5]) / unit
        ideal = dt.simulate(plant, law, signal, x0, 0.3, step=None)
        runs.append(ideal.states * unit[:, None])
        errors = []
        for step in (1e-4, 5e-5):
            digital = dt.simulate(plant, law, signal, x0, 0.3, step=step, times=ideal.time)
            errors.append(np.abs(digital.states - ideal.states).max(axis=1))
        np.testing.assert_allclose(errors[0] / errors[1], 2.0, rtol=0.05)
    size = np.abs(runs[0]).max(axis=1)
    assert (np.abs(runs[1] - runs[0]).max(axis=1) <= 1e-6 * size).all()


def test_an_ideal_run_of_too_many_segments_is_refused():
    problem = dt.problems.paper()
    with pytest.raises(dt.ArgumentError, match="horizon is too long for the ideal loop"):
        dt.simulate(
            problem.plant,
            problem.laws["averaged"],
            dt.SwitchingSignal.constant(0),
            [1, 1],
            1e9,
            None,
        )
