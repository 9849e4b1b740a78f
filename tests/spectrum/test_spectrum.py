"""Growth rates: known figures, the characteristic equation, long runs, and both methods."""

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.plant.pieces import Period
from deadtime.spectrum import LiftedLoop, growth_rate, lifted, lifted_loop
from shares import mostly_long

DELAYS = [0.234, 0.3, 0.04, 1.75]
H = 0.1


def single(plant, mode=0):
    return dt.SingleModePredictor(plant, plants.gains(plant), mode)


# -- known figures -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "mode", "rate"),
    [("averaged", 0, 0.128), ("averaged", 1, 0.282), ("mean", 0, 0.090), ("mean", 1, 0.368)],
)
def test_without_switching_the_paper_s_laws_grow_at_the_known_rates(name, mode, rate):
    plant = plants.paper()
    assert growth_rate(plant, plants.LAWS[name](plant), mode) == pytest.approx(rate, abs=5e-4)


def test_the_three_mode_plant_s_laws_grow_at_the_known_rates():
    problem = dt.problems.three_mode()
    averaged = problem.laws["averaged"]
    mean = dt.MeanPredictor(problem.plant, dt.place(problem.plant.mean(), [-2.0, -3.0])[0])
    assert growth_rate(problem.plant, averaged, 0) == pytest.approx(0.222, abs=5e-4)
    assert growth_rate(problem.plant, mean, 0) == pytest.approx(0.182, abs=5e-4)


@pytest.mark.parametrize(("step", "rate"), [(0.1, -0.83), (0.05, -0.90), (0.01, -0.97)])
def test_the_exact_law_of_a_mode_decays_at_the_known_rates(step, rate):
    plant = plants.paper()
    assert growth_rate(plant, single(plant), 0, step) == pytest.approx(rate, abs=5e-3)


@pytest.mark.parametrize(
    ("delay", "rate"), [(1.01, -0.29), (0.99, -0.29), (1.02, 0.38), (1.05, 1.2), (1.1, 1.8)]
)
def test_a_wrong_delay_costs_the_known_rates(delay, rate):
    law = single(plants.paper())
    assert growth_rate(plants.paper(delay), law, 0) == pytest.approx(rate, rel=0.03)


def test_a_delay_wrong_by_1_35_percent_is_the_limit():
    law = single(plants.paper())
    assert (
        growth_rate(plants.paper(1.0134), law, 0) < 0.0 < growth_rate(plants.paper(1.0137), law, 0)
    )


def test_scaling_the_modes_difference_loses_stability_where_it_is_known_to():
    plant = plants.paper()

    def worst(scale, step):
        A = plant.A[0] + scale * (plant.A - plant.A[0])
        B = plant.B[0] + scale * (plant.B - plant.B[0])
        near = dt.SwitchedSystem(A, B, plant.delay)
        law = plants.LAWS["averaged"](near)
        return max(growth_rate(near, law, mode, step) for mode in (0, 1))

    assert worst(0.6385, 0.01) < 0.0 < worst(0.6395, 0.01)
    assert worst(0.656, 0.1) < 0.0 < worst(0.657, 0.1)


# -- a second method: the characteristic equation ----------------------------------------------


def characteristic(plant, feedback, mode, row):
    """λ → the matrix that is singular where z_k = λ^k z_0 solves the loop; from definitions."""
    A, B = plant.A[mode], plant.B[mode]
    h = feedback.step
    N = int(np.ceil(round(plant.delay / h, 9)))
    phase = plant.delay - (N - 1) * h
    Phi0, Gamma0 = plants.held(A, B, phase)
    Phi1, Gamma1 = plants.held(A, B, h - phase)
    F, G = feedback.state_gain[row], feedback.input_gain[row]
    n, m = B.shape

    def matrix(root):
        powers = root ** -np.arange(1.0, G.shape[0] + 1)
        pipe = Phi1 @ Gamma0 * root**-N + Gamma1 * root ** (1 - N)
        feed = np.eye(m) - np.tensordot(powers, G, 1)
        return np.block([[root * np.eye(n) - Phi1 @ Phi0, -pipe], [-F, feed]])

    return matrix


@pytest.mark.few(2)
@pytest.mark.parametrize("truth", mostly_long(DELAYS, 0.234))
@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("name", ["averaged", "delayed"])
def test_the_eigenvalues_of_the_lifted_loop_solve_the_characteristic_equation(name, delay, truth):
    model, plant = plants.generic(delay), plants.generic(truth, seed=4)
    feedback = plants.LAWS[name](model).digital(H)
    for mode in range(3):
        row = mode if name == "delayed" else 0
        L = lifted_loop(plant, feedback, mode)
        roots = np.linalg.eigvals(L)
        matrix = characteristic(plant, feedback, mode, row)
        for root in roots[np.abs(roots) > 0.5]:
            values = np.linalg.svd(matrix(root), compute_uv=False)
            assert values[-1] <= 1e-9 * values[0]
        # No root is missing: outside a circle, the determinant winds once for every eigenvalue.
        radius = 1.05 * np.abs(roots).max()
        circle = radius * np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 1001))
        turns = np.unwrap(np.angle([np.linalg.det(matrix(point)) for point in circle]))
        assert round((turns[-1] - turns[0]) / (2.0 * np.pi)) == plant.states


@pytest.mark.parametrize("name", ["averaged", "delayed"])
@pytest.mark.parametrize(("delay", "truth"), [(0.234, 0.234), (0.234, 0.31), (0.31, 0.234)])
def test_the_lifted_loop_is_one_period_of_the_simulation(name, delay, truth):
    plant, law = plants.generic(truth), plants.LAWS[name](plants.generic(delay))
    rng = np.random.default_rng(0)
    for mode in range(3):
        L = lifted_loop(plant, law.digital(H), mode)
        W = (L.shape[0] - 3) // 2
        x, past = rng.normal(size=3), rng.normal(size=(2, W))
        signal = dt.SwitchingSignal.constant(mode)
        run = dt.simulate(plant, law, signal, x, 1.0, step=H, u0=past)
        z = np.concatenate((x, past[:, ::-1].T.ravel()))
        for k in range(1, 11):
            z = L @ z
            plants.close(z[:3], run.states[:, k], 1e-11)
            plants.close(z[3:5], run.inputs[:, k - 1], 1e-11)


@pytest.mark.parametrize(("name", "mode"), [("averaged", 0), ("averaged", 1), ("delayed", 0)])
def test_a_long_run_grows_at_the_growth_rate(name, mode):
    plant = plants.paper(0.985)
    law = plants.LAWS[name](plants.paper())
    rate = growth_rate(plant, law, mode, 0.02)
    end = 150.0 / max(0.25, rate)
    signal = dt.SwitchingSignal.constant(mode)
    run = dt.simulate(plant, law, signal, [-1.0, 1.0], end, step=0.02)
    # The envelope of an oscillation: its largest value in one stretch and in a later one.
    norm = np.linalg.norm(run.states, axis=0)
    third = norm.size // 3
    first, last = norm[third : third + third // 2], norm[-third // 2 :]
    at = [np.argmax(first) + third, norm.size - last.size + np.argmax(last)]
    measured = np.log(last.max() / first.max()) / (0.02 * (at[1] - at[0]))
    assert not run.diverged
    assert measured == pytest.approx(rate, abs=2e-3 * (1.0 + abs(rate)))


# -- contexts ----------------------------------------------------------------------------------


def test_a_law_that_tells_modes_and_ages_apart_is_taken_at_its_oldest_row():
    plant = plants.generic()
    law = dt.AveragedPredictor(plant, plants.gains(plant), dwell_time=0.55)
    forgotten = dt.AveragedPredictor(plant, plants.gains(plant))
    for mode in range(3):  # after the dwell time it is the averaged law again
        rate = growth_rate(plant, law, mode, H)
        assert rate == pytest.approx(growth_rate(plant, forgotten, mode, H), abs=1e-9)
    never = dt.ExpectedPredictor(plant, plants.gains(plant), dt.Markov(np.zeros((3, 3))))
    oracle = dt.ExactPredictor(plant, plants.gains(plant))
    for mode in range(3):
        own = growth_rate(plant, single(plant, mode), mode, H)
        assert growth_rate(plant, never, mode, H) == pytest.approx(own, abs=1e-9)
        assert growth_rate(plant, oracle, mode, H) == pytest.approx(own, abs=1e-9)


def test_an_oracle_of_a_signal_that_never_switches_believes_in_its_mode():
    plant = plants.paper()
    oracle = dt.ExactPredictor(plant, plants.gains(plant), dt.SwitchingSignal.constant(1))
    rate = growth_rate(plant, single(plant, 1), 0, H)
    assert growth_rate(plant, oracle, 0, H) == pytest.approx(rate, abs=1e-9)


def test_any_row_can_be_lifted():
    plant = plants.generic()
    feedback = plants.LAWS["delayed"](plant).digital(H)
    assert np.array_equal(lifted_loop(plant, feedback, 1), lifted_loop(plant, feedback, 1, row=1))
    other = lifted_loop(plant, feedback, 1, row=2)
    assert np.array_equal(other[3:5, :3], plants.gains(plant)[2])


# -- scaling -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "delay", "step"),
    [
        (plants.LAWS["averaged"], 1.0, 0.01),
        (plants.LAWS["averaged"], 1.05, 0.01),
        (single, 1.0, 0.01),
        (single, 0.9815, 0.01),
        pytest.param(single, 1.02, 0.002, marks=pytest.mark.long),
    ],
)
def test_arnoldi_s_method_agrees_with_all_eigenvalues(monkeypatch, make, delay, step):
    plant, law = plants.paper(delay), make(plants.paper())
    monkeypatch.setattr(lifted, "DENSE", 10_000)
    dense = growth_rate(plant, law, 0, step)
    monkeypatch.setattr(lifted, "DENSE", 0)
    assert growth_rate(plant, law, 0, step) == pytest.approx(dense, abs=1e-8)


def test_where_all_roots_grow_alike_all_eigenvalues_are_computed(monkeypatch):
    # A delay wrong by one period leaves a hundred roots of one modulus: Arnoldi's method stalls.
    plant, law = plants.paper(1.01), single(plants.paper())
    dense = growth_rate(plant, law, 0)
    monkeypatch.setattr(lifted, "DENSE", 0)
    assert growth_rate(plant, law, 0) == dense


def test_several_inputs_run_through_arnoldi_s_method_too(monkeypatch):
    plant = plants.generic(0.51)
    feedback = plants.LAWS["averaged"](plants.generic(0.5)).digital(0.01)
    loop = LiftedLoop.of(plant, feedback, 0, 0)
    z = np.random.default_rng(0).normal(size=loop.order)
    plants.close(loop.after(z, 3), loop.matrix() @ (loop.matrix() @ (loop.matrix() @ z)), 1e-12)
    dense = loop.growth_rate(0.01)
    monkeypatch.setattr(lifted, "DENSE", 0)
    assert loop.growth_rate(0.01) == pytest.approx(dense, abs=1e-8)


def test_a_loop_that_comes_to_rest_grows_at_minus_infinity():
    nothing = np.zeros((1, 1))
    loop = LiftedLoop(Period(nothing, nothing[None], (1,)), nothing, nothing[None])
    assert loop.growth_rate(H) == -np.inf


# -- refused -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mode": 3}, r"mode must be in 0\.\.2, got 3"),
        ({"step": 0.0}, r"step must be positive, in s, got 0\."),
        ({"plant": plants.paper()}, r"law must be made for a plant with 2 modes, got a law for 3"),
        (
            {"law": dt.ExactPredictor(plants.generic(), plants.gains(plants.generic()),
                                      dt.SwitchingSignal([0.0, 1.0], [0, 1]))},
            r"law must not assume a signal of its own that switches",
        ),
    ],
)  # fmt: skip
def test_arguments_that_do_not_fit_are_refused(change, message):
    plant = plants.generic()
    arguments = {"plant": plant, "law": plants.LAWS["averaged"](plant), "mode": 0} | change
    with pytest.raises(dt.ArgumentError, match=message):
        growth_rate(**arguments)


def test_a_row_or_mode_that_does_not_exist_is_refused():
    plant = plants.generic()
    feedback = plants.LAWS["delayed"](plant).digital(H)
    with pytest.raises(dt.ArgumentError, match=r"row must be in 0\.\.2, got 3"):
        lifted_loop(plant, feedback, 0, row=3)
    with pytest.raises(dt.ArgumentError, match=r"mode must be in 0\.\.2, got -1"):
        lifted_loop(plant, feedback, -1)


# -- Arnoldi's method -----------------------------------------------------------------------------


def test_arnoldi_s_method_finds_the_largest_eigenvalue_of_an_operator_and_its_vector():
    M = np.random.default_rng(1).normal(size=(60, 60)) + 20.0 * np.eye(60)[::-1]
    start = np.ones(60)
    found = lifted.leading_eigenvalue(lambda z: M @ z, start, 1e-12)
    assert found is not None
    value, vector = found
    assert abs(value) == pytest.approx(np.abs(np.linalg.eigvals(M)).max(), rel=1e-11)
    plants.close(M @ vector, value * vector, 1e-9)


def test_arnoldi_s_method_says_nothing_of_eigenvalues_that_lie_too_close():
    turned = np.roll(np.eye(400), 1, axis=0)  # 400 of one modulus
    start = np.random.default_rng(0).normal(size=400)
    assert lifted.leading_eigenvalue(lambda z: turned @ z, start, 1e-11) is None
