"""The cost ∫ xᵀQx + uᵀRu of every run is that integral; what is no weight is refused."""

import itertools
import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import deadtime as dt
from deadtime.imperfections import Noise, Saturation, WhiteDisturbance
from deadtime.numerics.exponential import gramian
from deadtime.plant.weight import weight_of
from deadtime.switching import HalfSpace
from shares import mostly_long
from weighted import GAINS, LAWS, MODEL, SIGNAL, TRUTH, WEIGHT, X0, Q, R


def quadrature(run, plant, signal, step):
    """∫ xᵀQx + uᵀRu of a digital run's inputs, the plant integrated by SciPy between events."""
    end = run.end
    samples = np.arange(0.0, end, step)
    arrivals = np.concatenate((samples, samples + plant.delay, signal.times[1:], [end]))
    events = np.unique(np.round(arrivals[arrivals <= end], 12))
    u = run.inputs.T

    def held(t):
        return u[int(np.floor(t / step + 1e-9))] if t >= 0.0 else np.zeros(plant.inputs)

    z = np.append(run.states[:, 0], 0.0)
    for a, b in itertools.pairwise(events):
        middle = 0.5 * (a + b)
        mode, late, now = signal(middle), held(middle - plant.delay), held(middle)

        def field(t, z, mode=int(mode), late=late, now=now):
            x = z[:-1]
            return np.append(plant.A[mode] @ x + plant.B[mode] @ late, x @ Q @ x + now @ R @ now)

        z = solve_ivp(field, (a, b), z, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return z[-1]


@pytest.mark.parametrize("name", LAWS)
def test_the_cost_of_a_run_is_that_of_an_integration_by_scipy(name):
    run = dt.simulate(TRUTH, LAWS[name], SIGNAL, X0, 3.03, 0.1)
    cost = run.metrics(WEIGHT)["cost"]
    assert cost == pytest.approx(quadrature(run, TRUTH, SIGNAL, 0.1), rel=1e-9)


def test_without_a_weight_or_with_the_identity_figures_are_the_same_to_the_last_bit():
    run = dt.simulate(TRUTH, LAWS["averaged"], SIGNAL, X0, 3.03, 0.1)
    plain = run.metrics()
    assert plain["cost"] == plain["ise"] + plain["energy"]
    assert run.metrics(dt.Weight()) == run.metrics(dt.Weight(np.eye(3), [1, 1])) == plain


def test_a_weight_changes_the_cost_and_nothing_else():
    run = dt.simulate(TRUTH, LAWS["averaged"], SIGNAL, X0, 3.03, 0.1)
    plain, weighed = run.metrics(), run.metrics(WEIGHT)
    assert weighed.pop("cost") != plain.pop("cost")
    assert weighed == plain


def sliding():
    """Two modes that push to x₁ = 0 from both sides, where the plant slides."""
    A = np.zeros((2, 3, 3))
    A[0, :2, 2], A[1, :2, 2] = [1.0, 1.0], [-1.0, 2.0]
    plant = dt.SwitchedSystem(A, np.zeros((2, 3, 1)), 0.25)
    law = dt.DelayedStateFeedback(plant, np.zeros((2, 1, 3)), allow_unstable=True)
    return dt.simulate(plant, law, HalfSpace([1.0, 0.0, 0.0]), [-0.5, 0.0, 1.0], 1.93, 0.1)


RUNS = {
    "ideal": lambda: dt.simulate(TRUTH, LAWS["averaged"], SIGNAL, X0, 3.03, None),
    "sliding": sliding,
    "disturbed": lambda: dt.simulate(
        TRUTH, LAWS["averaged"], SIGNAL, X0, 3.03, 0.1, imperfections=[WhiteDisturbance(0.1)]
    ),
    "noisy": lambda: dt.simulate(
        TRUTH, LAWS["averaged"], SIGNAL, X0, 3.03, 0.1, imperfections=[Noise(0.1)]
    ),
}


@pytest.mark.few(1)
@pytest.mark.parametrize("name", RUNS)
def test_the_cost_of_every_kind_of_run_is_the_integral_of_its_states_and_inputs(name):
    run = RUNS[name]()
    R = 0.7 if run.plant.inputs == 1 else globals()["R"]
    weight = dt.Weight(Q, R)
    states = dt.Weight(Q, 0.0)
    edges = np.linspace(0.0, run.end, 6001)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    width = np.diff(edges)[:, None] / 2.0
    time = (edges[:-1, None] + width * (1.0 + nodes)).ravel()
    x, u = run.record.states_at(time), run.record.inputs_at(time)
    density = np.einsum("ki,ij,kj->k", x, Q, x)
    parts = (width * weights).ravel()
    assert run.metrics(states)["cost"] == pytest.approx(parts @ density, rel=1e-4)
    density += np.einsum("ki,ij,kj->k", u, weight.of(run.plant).R, u)
    assert run.metrics(weight)["cost"] == pytest.approx(parts @ density, rel=1e-3)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "limited"),
    mostly_long(itertools.product(LAWS, (False, True)), ("averaged", False)),
)
def test_a_batch_has_the_costs_of_runs_one_by_one(name, limited):
    laws, actuators = {name: LAWS[name]}, [Saturation(-0.8, 0.8)] if limited else []
    model = dt.Markov(2.0 * (np.ones((3, 3)) - np.eye(3)))
    signals = dt.draw_signals(model, 3.03 + TRUTH.delay, 7, 0, 11)
    data = dt.monte_carlo(
        TRUTH, laws, signals, X0, 3.03, 0.1, imperfections=actuators, weight=WEIGHT
    )
    assert data.attrs["one_by_one"] == []
    plain = dt.monte_carlo(TRUTH, laws, signals, X0, 3.03, 0.1, imperfections=actuators)
    for metric in set(plain) - {"cost"}:
        assert data[metric].equals(plain[metric])
    for i in (0, 4, 10):
        run = dt.simulate(TRUTH, laws[name], signals[i], X0, 3.03, 0.1, imperfections=actuators)
        cost = data.cost.sel(law=name).values[i]
        assert cost == pytest.approx(run.metrics(WEIGHT)["cost"], rel=1e-11)


@pytest.mark.parametrize("name", mostly_long(LAWS, "averaged"))
def test_a_batch_with_the_identity_is_one_without_a_weight(name):
    laws = {name: LAWS[name]}
    data = [
        dt.monte_carlo(TRUTH, laws, [SIGNAL], X0, 3.0, 0.1, weight=weight)
        for weight in (None, dt.Weight(1.0, 1.0))
    ]
    assert data[0].identical(data[1])


@pytest.mark.parametrize("name", mostly_long(LAWS, "averaged"))
def test_trajectories_come_with_a_weight_as_without(name):
    laws = {name: LAWS[name]}
    data = dt.monte_carlo(TRUTH, laws, [SIGNAL], X0, 3.0, 0.1, trajectories=True, weight=WEIGHT)
    plain = dt.monte_carlo(TRUTH, laws, [SIGNAL], X0, 3.0, 0.1, trajectories=True)
    assert data.x.equals(plain.x)
    assert data.u.equals(plain.u)


@pytest.mark.parametrize("tau", [1e-3, 0.3, 4.0])
def test_the_gramian_with_q_is_van_loan_s_of_an_exponential(tau):
    A, B = MODEL.A[0], MODEL.B[0]
    Z, E = np.zeros((2, 5, 5))
    Z[:3, :3], Z[:3, 3:], E[:3, :3] = A, B, Q
    whole = expm(tau * np.block([[-Z.T, E], [np.zeros((5, 5)), Z]]))
    assert gramian(A, B, tau, Q) == pytest.approx(whole[5:, 5:].T @ whole[:5, 5:], rel=1e-9)


def test_cost_does_not_depend_on_the_units_of_states_and_inputs():
    T, S = np.diag([10.0, 0.2, 3.0]), np.diag([4.0, 0.5])
    inverse, back = np.linalg.inv(T), np.linalg.inv(S)
    plant = dt.SwitchedSystem(T @ MODEL.A @ inverse, T @ MODEL.B @ back, MODEL.delay)
    law = dt.AveragedPredictor(plant, S @ GAINS @ inverse)
    weight = dt.Weight(inverse.T @ Q @ inverse, back.T @ R @ back)
    run = dt.simulate(plant, law, SIGNAL, T @ X0, 3.03, 0.1)
    other = dt.simulate(MODEL, LAWS["averaged"], SIGNAL, X0, 3.03, 0.1)
    assert run.metrics(weight)["cost"] == pytest.approx(other.metrics(WEIGHT)["cost"], rel=1e-10)


# --- weights with round-off


@pytest.mark.parametrize(
    "Q",
    [
        [[1, 1e-17], [1e-17, 0]],
        [[1e6, 0], [0, -1e-12]],
        [[1, 2e-17], [-1e-17, -1e-17]],
        [[1, 0, 0], [0, 3e-17, 5e-17], [0, 5e-17, 1e-17]],
    ],
)
def test_the_round_off_of_a_computed_weight_becomes_0(Q):
    used = dt.Weight(Q, 1).Q
    assert used[0, 0] == Q[0][0]
    assert used.sum() == used[0, 0]
    disturbance = dt.imperfections.WhiteDisturbance(Q)
    plant = dt.SwitchedSystem([-np.eye(len(Q))], [np.ones((len(Q), 1))], 0.1)
    law = dt.SingleModePredictor(plant, np.zeros((1, 1, len(Q))), 0)
    signal = dt.SwitchingSignal.constant(0)
    run = dt.simulate(plant, law, signal, np.ones(len(Q)), 1.0, imperfections=[disturbance])
    assert np.isfinite(run.states).all()


def test_a_weight_of_two_outputs_of_five_states_is_accepted_in_any_basis():
    rng = np.random.default_rng(1)
    for _ in range(50):
        C = rng.standard_normal((2, 5)) @ np.diag([1, 1, 0, 0, 0])
        T, _ = np.linalg.qr(rng.standard_normal((5, 5)))
        Q = T.T @ (T @ C.T @ C @ T.T) @ T
        used = dt.Weight((Q + Q.T) / 2, 1).Q
        assert used == pytest.approx(C.T @ C, abs=1e-13)


def test_a_definite_weight_has_no_round_off():
    with pytest.raises(dt.ArgumentError, match="R must be positive definite, got -1e-12 on its"):
        dt.lqr(MODEL, 1.0, [1e6, -1e-12])


def test_small_entries_in_other_units_stay():
    assert dt.Weight([[1e20, 5e9], [5e9, 1]], 1).Q.tolist() == [[1e20, 5e9], [5e9, 1]]


# --- bad weights


@pytest.mark.parametrize(
    ("Q", "R", "message"),
    [
        ([[1, 2], [3, 4]], 1, "Q must be symmetric"),
        ([[1, 0], [0, -1]], 1, "Q must be positive semidefinite, got -1 on its diagonal"),
        (1, -2, "R must be positive semidefinite, got -2 on its diagonal"),
        ([1e10, -1], 1, "Q must be positive semidefinite, got -1 on its diagonal"),
        ([[1e20, 2e10], [2e10, 1]], 1, "semidefinite, got an eigenvalue -1 when scaled"),
        ([[1e20, 1], [0, 1e-20]], 1, "Q must be symmetric"),
        ([[1, 1], [0, 0]], 1, "Q must be symmetric"),
        ([[1e6, 1], [1, 0]], 1, "got an entry other than 0 beside a 0 on its diagonal"),
        ([[1, 1e-6], [1e-6, -1e-17]], 1, "got an entry other than 0 beside a 0"),
        ([1, float("nan")], 1, "Q[1] must be finite, got nan"),
        (np.zeros((2, 3)), 1, "Q must have shape (n, n) = (2, 2), got (2, 3)"),
        (1, np.ones((1, 1, 1)), "R must have shape (m, m), (m,) or (), got (1, 1, 1)"),
        (1, [], "R must have shape (m, m), (m,) or (), got the empty shape (0,)"),
        ("much", 1, "Q must hold real numbers"),
        (0, 0, "Q and R must not both be 0"),
    ],
)
def test_a_weight_that_is_none_is_refused(Q, R, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        dt.Weight(Q, R)


def test_a_weight_for_another_plant_is_refused_by_name():
    run = dt.simulate(TRUTH, LAWS["averaged"], SIGNAL, X0, 1.0, 0.1)
    with pytest.raises(
        dt.ArgumentError, match=re.escape("weight.Q must have shape (n, n) = (3, 3), got (2, 2)")
    ):
        run.metrics(dt.Weight(np.eye(2), 1.0))
    with pytest.raises(
        dt.ArgumentError, match=re.escape("weight.R must have shape (m, m) = (2, 2), got (1, 1)")
    ):
        dt.monte_carlo(TRUTH, LAWS, [SIGNAL], X0, 1.0, 0.1, weight=dt.Weight(1.0, [[1.0]]))


def test_what_is_no_weight_is_refused():
    with pytest.raises(
        dt.ArgumentError, match=r"weight must be a Weight\(Q, R\), got 3.0, a float"
    ):
        weight_of(3.0, TRUTH)
