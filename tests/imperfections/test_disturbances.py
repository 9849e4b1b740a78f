"""Disturbances of the plant: exact in distribution, whatever the grid, the delay and the modes."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from scipy.linalg import expm

import deadtime as dt
import plants
import reference
from by_sample import by_sample
from deadtime.imperfections import (
    ColouredDisturbance,
    Jitter,
    MeasurementDelay,
    Noise,
    Sizes,
    StepDisturbance,
    WhiteDisturbance,
)
from deadtime.numerics.covariance import noise_covariance, square_root

MODEL = plants.generic()
# Not what the law believes: N = 3, φ = 0.051 and other matrices.
PLANT = dt.SwitchedSystem(1.03 * MODEL.A, 0.98 * MODEL.B, 0.251)
SIGNAL = plants.off_grid()
STEP, X0 = 0.1, np.array([1.0, -1.0, 0.5])
FORCE = np.array([0.4, -1.0, 0.7])
W = np.array([[0.5, 0.2, 0.0], [0.2, 0.3, 0.1], [0.0, 0.1, 0.1]])
SIZES = Sizes(3, 3, 2, STEP)
NODES, WEIGHTS = np.polynomial.legendre.leggauss(20)


def run(law="averaged", imperfections=(), horizon=2.0, signal=SIGNAL, plant=PLANT, **options):
    return dt.simulate(
        plant, plants.LAWS[law](MODEL), signal, X0, horizon, STEP,
        imperfections=imperfections, **options,
    )  # fmt: skip


def exact(fraction):
    return Fraction(str(fraction))


def free_flow(A, start, end):
    """Transition of the undriven plant from start to end, cut at the switches of SIGNAL."""
    Phi, cuts = np.eye(3), [t for t in SIGNAL.times if start < t < end]
    for a, b in zip([start, *cuts], [*cuts, end], strict=True):
        Phi = expm(A[SIGNAL(a)] * (b - a)) @ Phi
    return Phi


def quadrature(start, end, integrand):
    """∫ of a matrix, Gauss–Legendre between the switches of SIGNAL."""
    total, cuts = 0.0, [t for t in SIGNAL.times if start < t < end]
    for a, b in zip([start, *cuts], [*cuts, end], strict=True):
        half = (b - a) / 2.0
        total = total + sum(
            half * w * integrand(a + half * (1.0 + s)) for s, w in zip(NODES, WEIGHTS, strict=True)
        )
    return total


@pytest.mark.parametrize("law", plants.LAWS)
def test_a_constant_force_moves_the_plant_as_a_further_input_would(law):
    loop = run(law, [StepDisturbance(FORCE)])
    if law == "exact":
        assert np.isfinite(loop.states).all()
    B = np.concatenate((PLANT.B, np.tile(FORCE[None, :, None], (3, 1, 1))), axis=2)
    model = reference.Model(PLANT.A.astype(reference.LONG), B, Fraction("0.251"))
    times = [exact(t) for t in SIGNAL.times.tolist()]
    mode = reference.Signal(times, SIGNAL.modes.tolist())

    def acting(j):
        return np.append(loop.inputs[:, j] if j >= 0 else np.zeros(2), 1.0)

    x, held = X0.astype(reference.LONG), exact(STEP)
    between = run(law, [StepDisturbance(FORCE)], times=[0.05, 0.115, 0.18, 0.333, 1.87]).states
    for column, t in zip(between.T, ("0.05", "0.115", "0.18", "0.333", "1.87"), strict=True):
        there = reference.run_model(model, mode, times, acting, held, x, Fraction(0), exact(t))
        assert np.abs(column - there).max() <= 1e-11 * np.abs(loop.states).max()
    for k in range(loop.time.size - 1):
        x = reference.run_model(model, mode, times, acting, held, x, k * held, (k + 1) * held)
        assert np.abs(loop.states[:, k + 1] - x).max() <= 1e-12 * np.abs(loop.states).max()


def test_a_force_acts_from_its_start_to_its_end():
    plain, whole = run(), run(imperfections=[StepDisturbance(FORCE)])
    part = run(imperfections=[StepDisturbance(FORCE, 0.55, 1.2)])
    assert (part.states[:, :7] == plain.states[:, :7]).all()
    assert (part.states[:, 7] != plain.states[:, 7]).all()
    two = [StepDisturbance(FORCE, end=0.6), StepDisturbance(FORCE, 0.6)]
    plants.close(run(imperfections=two).states, whole.states, 1e-12)
    begun = run(imperfections=[StepDisturbance(FORCE, 0.6)]).states
    ended = run(imperfections=[StepDisturbance(FORCE, 0.0, 0.6)]).states
    # The loop is linear: what two forces add is what each adds.
    plants.close(begun + ended - plain.states, whole.states, 1e-11)


@pytest.mark.parametrize("disturbance", ["step", "white", "coloured"])
def test_compiled_and_step_by_step_runs_agree_under_disturbances(disturbance):
    kinds = {
        "step": StepDisturbance(FORCE, 0.3),
        "white": WhiteDisturbance(W),
        "coloured": ColouredDisturbance([0.4, 0.2], [0.3, 2.0], np.stack((FORCE, X0), axis=1)),
    }
    one = kinds[disturbance]
    fast, slow = run(imperfections=[one]), run(imperfections=[one, by_sample(Noise(0.0))])
    plants.close(slow.states, fast.states, 1e-12)
    for name, value in fast.metrics().items():
        assert slow.metrics()[name] == pytest.approx(value, rel=1e-9), name
    assert (fast.states != run().states).any(axis=0)[4:].all()
    assert fast.measured is None


def test_the_integral_of_a_disturbed_run_is_that_of_its_path():
    loop = run(imperfections=[WhiteDisturbance(W), StepDisturbance(FORCE)], seed=4)
    fine = np.sort(np.concatenate((np.linspace(0.0, 2.0, 20001), SIGNAL.times[1:-1])))
    path = run(
        imperfections=[WhiteDisturbance(W), StepDisturbance(FORCE)], seed=4, times=fine
    ).states
    ise = np.trapezoid((path**2).sum(axis=0), fine)
    assert loop.metrics()["ise"] == pytest.approx(ise, rel=1e-6)


@pytest.mark.parametrize(("start", "end"), [(0.0, 0.051), (0.151, 0.2), (0.3, 0.4)])
def test_white_noise_adds_its_covariance_through_switches(start, end):
    cuts = [t for t in SIGNAL.times if start < t < end]
    bounds = [start, *cuts, end]
    pieces = [(PLANT.A[SIGNAL(a)], b - a) for a, b in itertools.pairwise(bounds)]
    L = WhiteDisturbance(W).spread(SIZES, pieces)

    def integrand(t):
        Phi = free_flow(PLANT.A, t, end)
        return Phi @ W @ Phi.T

    plants.close(L @ L.T, quadrature(start, end, integrand), 1e-12)


@pytest.mark.long
def test_coloured_noise_and_what_it_adds_have_their_joint_covariance():
    E, std, T = np.stack((FORCE, X0), axis=1), np.array([0.4, 0.2]), np.array([0.3, 2.0])
    start, end = 0.3, 0.4
    bounds = [0.3, *[t for t in SIGNAL.times if start < t < end], 0.4]
    pieces = [(PLANT.A[SIGNAL(a)], b - a) for a, b in itertools.pairwise(bounds)]
    S = ColouredDisturbance(std, T, E).spread(SIZES, pieces)
    kept = np.exp(-(end - start) / T)
    # The numbers: c at the start and the end, correlated, and independent normal ones.
    C = np.eye(7)
    C[:2, :2] = C[2:4, 2:4] = np.diag(std**2)
    C[:2, 2:4] = C[2:4, :2] = np.diag(kept * std**2)

    def weight(t):
        return free_flow(PLANT.A, t, end) @ E

    def to_start(t):
        return weight(t) * (std**2 * np.exp(-(t - start) / T))

    def to_end(t):
        return weight(t) * (std**2 * np.exp(-(end - t) / T))

    def to_itself(t):
        def inner(s):
            return (weight(t) * (std**2 * np.exp(-(t - s) / T))) @ weight(s).T

        return quadrature(start, t, inner)

    own = quadrature(start, end, to_itself)
    plants.close(S @ C @ S.T, own + own.T, 1e-9)
    plants.close(S @ C[:, :2], quadrature(start, end, to_start), 1e-12)
    plants.close(S @ C[:, 2:4], quadrature(start, end, to_end), 1e-12)


def test_coloured_noise_keeps_its_deviation_and_forgets_at_its_rate():
    one = ColouredDisturbance([2.0, 0.5], [0.3, 0.05], np.zeros((3, 2)))
    draws = one.draws(SIZES, (0.051, 0.049), 40000, np.random.default_rng(0))
    c = draws[:, 0, :2]
    np.testing.assert_allclose(c.std(axis=0), [2.0, 0.5], rtol=0.04)
    kept = [np.corrcoef(c[1:, i], c[:-1, i])[0, 1] for i in (0, 1)]
    np.testing.assert_allclose(kept, np.exp([-0.1 / 0.3, -0.1 / 0.05]), atol=0.02)
    assert (draws[1:, 0, :2] == draws[:-1, 1, 2:4]).all()


def lifted_steps(steps, parts):
    """From (x, u_{k−1}, …) to x after fractions of step k and to u_k: columns of unit vectors."""
    model = reference.Model(PLANT.A.astype(reference.LONG), PLANT.B, Fraction("0.251"))
    own = reference.Model(MODEL.A.astype(reference.LONG), MODEL.B, Fraction("0.234"))
    mode = reference.Signal([exact(t) for t in SIGNAL.times.tolist()], SIGNAL.modes.tolist())
    law, held = reference.averaged(own, plants.gains(MODEL), np.full(3, 1 / 3)), exact(STEP)
    for k in range(steps):
        flows, inputs = np.zeros((parts + 1, 3, 9)), np.zeros((2, 9))
        for column in range(9):
            z = np.eye(9)[column]
            loop = reference.Loop(model, mode, held, np.zeros((0, 2)))
            loop.inputs = {
                k - j: z[1 + 2 * j : 3 + 2 * j].astype(reference.LONG) for j in (1, 2, 3)
            }
            u, _ = law(loop, k, z[:3].astype(reference.LONG))
            loop.inputs[k] = u
            inputs[:, column] = u
            for part in range(parts + 1):
                end = (k + Fraction(part, parts)) * held
                flows[part, :, column] = reference.run_model(
                    model, mode, mode.times, loop.held, held, z[:3].astype(reference.LONG),
                    k * held, end,
                )  # fmt: skip
        yield flows, inputs


def expected_cost(steps, noise):
    """E ∫|x|², E ∫|u|² and E|x(T)|² of the true stochastic loop, by the covariance recursion."""
    parts, fractions = 4, np.array([1.0, 4.0, 2.0, 4.0, 1.0]) / 12.0
    P = np.zeros((9, 9))
    P[:3, :3] = np.outer(X0, X0)
    ise = energy = 0.0
    for k, (flows, inputs) in enumerate(lifted_steps(steps, parts)):
        R = np.zeros((9, 9))
        R[:3, :3] = np.diag(np.full(3, noise**2))
        energy += STEP * np.trace(inputs @ (P + R) @ inputs.T)
        covariances = []
        for part in range(parts + 1):
            a, b = k * STEP, (k + part / parts) * STEP

            def integrand(t, b=b):
                Phi = free_flow(PLANT.A, t, b)
                return Phi @ W @ Phi.T

            Q = quadrature(a, b, integrand) if part else np.zeros((3, 3))
            # u_k does not act within the step: the measurement noise is in the input only.
            covariances.append(flows[part] @ P @ flows[part].T + Q)
        ise += STEP * fractions @ [np.trace(C) for C in covariances]
        M = np.zeros((9, 9))
        M[:3], M[3:5], M[5:9, 3:7] = flows[-1], inputs, np.eye(4)
        G = np.zeros((9, 9))
        G[3:5] = inputs
        P = M @ P @ M.T + G @ R @ G.T
        P[:3, :3] += Q
    return np.array([ise, energy, np.trace(P[:3, :3])])


@pytest.mark.long
def test_the_cost_under_additive_noise_is_that_of_the_covariance_recursion():
    steps, noise = 12, 0.2
    expected = expected_cost(steps, noise)
    # What the path between the ends of phases leaves out of ∫|x|².
    expected[0] -= steps * np.trace(W) * (0.051**2 + 0.049**2) / 6.0
    kinds = [WhiteDisturbance(W), Noise(noise)]
    found = []
    for seed in range(300):
        metrics = run(imperfections=kinds, seed=seed, horizon=steps * STEP).metrics()
        found.append([metrics["ise"], metrics["energy"], metrics["final_norm"] ** 2])
    mean, error = np.mean(found, axis=0), np.std(found, axis=0) / math.sqrt(len(found))
    assert (error <= 0.07 * mean).all()
    assert (np.abs(mean - expected) <= 3.5 * error).all()


def test_laws_of_a_scenario_meet_the_same_disturbance():
    laws = {name: plants.LAWS[name](MODEL) for name in ("averaged", "weighted")}
    data = dt.monte_carlo(
        PLANT, laws, [SIGNAL] * 3, X0, 0.2, STEP, imperfections=[WhiteDisturbance(W)], seed=2
    )
    # Before the first input arrives the laws cannot differ.
    assert (data.ise.sel(law="weighted") == data.ise.sel(law="averaged")).all()
    assert np.unique(data.ise.sel(law="weighted")).size == 3


def test_a_plant_that_switches_by_its_state_is_disturbed_too():
    rule = dt.HalfSpace([1.0, 0.0], 0.0)
    plant = dt.problems.paper().plant
    law = dt.StateDependentPredictor(plant, dt.place(plant, [-1.0, -2.0]), rule)
    options = {"x0": [-1.0, 1.0], "horizon": 3.0, "step": 0.05}
    force = [0.0, 0.1]
    loop = dt.simulate(plant, law, rule, imperfections=[StepDisturbance(force)], **options)
    fixed = dt.SwitchingSignal(loop.signal.times, loop.signal.modes)
    u = loop.inputs
    assert loop.signal.modes.size > 1
    # The same force and inputs along the signal that the rule made.
    x, whole = np.array([-1.0, 1.0]), 0.05
    cuts = np.union1d(np.arange(61) * whole, fixed.times[1:])
    for a, b in itertools.pairwise(cuts):
        mode, k = fixed(0.5 * (a + b)), round((0.5 * (a + b) - 1.0) / whole - 0.5)
        acting = np.append(u[:, k] if k >= 0 else [0.0], 1.0)
        B = np.column_stack((plant.B[mode], force))
        Phi, Gamma = plants.held(plant.A[mode], B, b - a)
        x = Phi @ x + Gamma @ acting
    plants.close(loop.states[:, -1], x, 1e-9)
    noisy = dt.simulate(plant, law, rule, imperfections=[WhiteDisturbance(1e-3)], **options)
    assert (noisy.states[:, 1:] != loop.states[:, 1:]).all()


def test_a_measurement_delay_moves_into_the_input_delay():
    # What is measured late lives in a loop of its own, whose input delay is longer.
    late = 0.0777
    model = dt.SwitchedSystem(MODEL.A, MODEL.B, 0.251 + late)
    law = dt.MeanPredictor(model, plants.mean_gain(MODEL))
    loop = dt.simulate(
        PLANT, law, SIGNAL, X0, 3.0, STEP, imperfections=[MeasurementDelay(late)]
    )  # fmt: skip
    assert np.isnan(loop.measured[:, 0]).all()
    seen = loop.measured[:, 1:]
    moved = dt.SwitchingSignal(
        [0.0, *(SIGNAL.times[1:] + late - STEP)], [SIGNAL.modes[0], *SIGNAL.modes[1:]]
    )
    longer = dt.SwitchedSystem(PLANT.A, PLANT.B, 0.251 + late)
    other = dt.simulate(longer, law, moved, seen[:, 0], 2.9, STEP)
    plants.close(seen, other.states, 1e-11)
    plants.close(loop.inputs[:, 1:], other.inputs, 1e-11)


def test_measurement_delays_add_up_and_whole_periods_need_no_interpolation():
    one = run(imperfections=[MeasurementDelay(0.2)])
    two = run(imperfections=[MeasurementDelay(0.13), MeasurementDelay(0.07)])
    assert (one.measured[:, 2:] == one.states[:, :-2]).all()
    plants.close(two.measured[:, 2:], one.measured[:, 2:], 1e-12)


def test_jitter_measures_earlier_by_up_to_its_most():
    loop = run(imperfections=[Jitter(0.06), StepDisturbance(FORCE)], seed=3)
    fine = run(imperfections=[Jitter(0.06), StepDisturbance(FORCE)], seed=3,
               times=np.linspace(0.0, 2.0, 20001)).states  # fmt: skip
    assert (loop.measured[:, 0] == X0).all()  # nothing is earlier than the start
    early = []
    for k in range(1, loop.time.size):
        near = np.arange(max(0, 1000 * k - 1000), 1000 * k + 1)
        gap = np.abs(fine[:, near] - loop.measured[:, [k]]).max(axis=0)
        assert gap.min() <= 1e-3 * np.abs(fine).max()
        early.append((1000 * k - near[gap.argmin()]) * 1e-4)
    assert max(early) <= 0.0601
    assert min(early) < 0.02 < 0.04 < max(early)


def test_covariances_and_their_roots_are_those_of_a_quadrature():
    A, tau = 30.0 * PLANT.A[0] - 20.0 * np.eye(3), 1.3
    Q = noise_covariance(A, W, tau)
    fine = np.linspace(0.0, tau, 60001)
    step = expm(A * (fine[1] - fine[0]))
    Phi, total = np.eye(3), np.zeros((3, 3))
    for i in range(fine.size):
        total += (Phi @ W @ Phi.T) * (1.0 if 0 < i < fine.size - 1 else 0.5)
        Phi = step @ Phi
    plants.close(Q, total * (fine[1] - fine[0]), 1e-4)
    units = np.diag([1e-8, 1.0, 1e6])
    L = square_root(units @ W @ units)
    plants.close(np.linalg.inv(units) @ L @ L.T @ np.linalg.inv(units), W, 1e-12)
    assert (noise_covariance(A, 0.0 * W, tau) == 0.0).all()


@pytest.mark.parametrize(
    ("imperfection", "message"),
    [
        (
            WhiteDisturbance([1e10, 1.0, -1.0]),
            "WhiteDisturbance.intensity must be positive semidef",
        ),
        (WhiteDisturbance(W + np.triu(W, 1)), "WhiteDisturbance.intensity must be symmetric"),
        (WhiteDisturbance(np.eye(2)), r"WhiteDisturbance.intensity must have shape \(n, n\)"),
        (ColouredDisturbance(1.0, 0.0, FORCE), "time_constant > 0"),
        (ColouredDisturbance(-1.0, 1.0, FORCE), "std ≥ 0"),
        (ColouredDisturbance(1.0, 1.0, [1.0]), r"ColouredDisturbance.force must have shape"),
        (ColouredDisturbance([1.0, 2.0], 1.0, FORCE), "ColouredDisturbance.std must have shape"),
        (StepDisturbance([1.0]), r"StepDisturbance.force must have shape \(n,\) = \(3,\)"),
        (StepDisturbance(FORCE, 2.0, 1.0), "0 ≤ start < end, got 2 and 1"),
        (StepDisturbance(FORCE, -1.0), "0 ≤ start < end"),
        (StepDisturbance(FORCE, 0.0, "noon"), "0 ≤ start < end, got 0 and noon"),
        (WhiteDisturbance("much"), "WhiteDisturbance.intensity must hold real numbers"),
        (ColouredDisturbance(1.0, 1.0, [[1.0], [1.0, 2.0]]), "ColouredDisturbance.force must hold"),
        (MeasurementDelay(0.0), "MeasurementDelay.delay must be positive"),
        (Jitter(-0.1), "Jitter.most must be positive"),
        (Jitter(0.11), "Jitter.most must be at most one period, 0.1 s, got 0.11: .* LateSamples"),
    ],
)
def test_malformed_disturbances_and_timings_are_refused_by_name(imperfection, message):
    with pytest.raises(dt.ArgumentError, match=message):
        run(imperfections=[imperfection])


def test_what_cannot_be_simulated_exactly_is_refused():
    rule = dt.HalfSpace([1.0, 0.0], 0.0)
    plant = dt.problems.paper().plant
    law = dt.StateDependentPredictor(plant, dt.place(plant, [-1.0, -2.0]), rule)
    with pytest.raises(dt.ArgumentError, match=r"delay a multiple of the step, 0\.1 s"):
        dt.simulate(plant, law, rule, [-1, 1], 1.0, 0.1, imperfections=[MeasurementDelay(0.05)])
    turn = 20.0 * np.pi * np.array([[[0.0, 1e3], [-1e-3, 0.0]]])
    fast = dt.SwitchedSystem(turn, [[[0.0], [1.0]]], 0.2)
    law = dt.DelayedStateFeedback(fast, [[[0.0, 0.0]]], allow_unstable=True)
    with pytest.raises(dt.ArgumentError, match=r"step = 0\.1 s is too long .* oscillates a whole"):
        dt.simulate(
            fast, law, dt.SwitchingSignal([0.0], [0]), [1, 0], 1.0, 0.1,
            imperfections=[WhiteDisturbance(1.0)],
        )  # fmt: skip
    with pytest.raises(dt.ArgumentError, match="the ideal loop has no samples"):
        dt.simulate(
            PLANT, plants.LAWS["averaged"](MODEL), SIGNAL, X0, 1.0, None,
            imperfections=[WhiteDisturbance(W)],
        )  # fmt: skip
