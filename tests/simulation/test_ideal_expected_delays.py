"""The ideal loop of the expected law where every input has its own delay.

A run is put back into the plant's equation and the law's, the law worked out twice: by the moments
of x in every mode, marched by Gauss sums, and, where the model switches once and for ever, as the
mean of the exact feedback over the instant of the switch.
"""

import itertools

import numpy as np
import pytest
from scipy.linalg import block_diag

import deadtime as dt
import ideal_residual
from shares import mostly_long

TIMES = (0.0, 0.07, 0.31, 0.62, 0.83, 1.17, 1.6)
RATES = {2: [[0.0, 1.5], [2.5, 0.0]], 3: [[0, 1.0, 2.0], [0.5, 0, 1.5], [3.0, 0.0, 0]]}


def random_loop(rng, modes=None, truth=False):
    """A model and a plant, with other delays and matrices if asked, and gains."""
    modes, n, m = modes or int(rng.integers(2, 4)), int(rng.integers(1, 4)), int(rng.integers(2, 4))
    A, B = rng.normal(size=(modes, n, n)), rng.normal(size=(modes, n, m))
    delays = rng.uniform(0.15, 0.5, m)
    model = plant = dt.SwitchedSystem(A, B, delays)
    if truth:
        plant = dt.SwitchedSystem(
            0.9 * A, 1.1 * B, np.tile(delays, (modes, 1)) * rng.uniform(0.8, 1.2, (modes, m))
        )
    return plant, model, 0.6 * rng.normal(size=(modes, m, n))


def run_of(rng, plant, law):
    times = np.append(0.0, np.cumsum(rng.uniform(0.15, 0.6, 3)))
    signal = dt.SwitchingSignal(times, np.arange(4) % plant.modes)
    x0, u0 = rng.normal(size=plant.states), rng.normal(size=plant.inputs)
    run = dt.simulate(plant, law, signal, x0, 1.6, step=None, u0=u0)
    assert not run.diverged
    return run, ideal_residual.rough(run, [plant.delays, law.plant.delays])


def by_moments(law, run, t, bends):
    """u(t) by the moments E[x 1{σ = i}], marched from delay to delay."""
    A, B, delays, K = law.plant.A, law.plant.B, law.plant.delays[0], law.gains
    generator, (modes, n, m) = law.model.generator, B.shape
    mode = int(run.signal(np.array([t]))[0])
    values, vectors = np.linalg.eig(generator.T)
    start = np.linalg.solve(vectors, np.eye(modes)[mode])
    X = np.kron(np.eye(modes)[mode], ideal_residual.state(run, t)).astype(float)
    breaks = np.concatenate([bends + d for d in delays])
    answer, begin = np.empty(m), 0.0
    for end in np.unique(delays):
        flying, landed = np.flatnonzero(delays >= end), np.flatnonzero(delays < end)
        own = [A[i] + B[i][:, landed] @ K[i][landed] for i in range(modes)]

        def forcing(s, flying=flying):
            p = (np.exp((s - t)[:, None] * values) * start @ vectors.T).real
            sent = ideal_residual.arriving(run, s, delays, flying)
            return np.einsum("tc,cnk,tk->tcn", p, B[:, :, flying], sent).reshape(s.size, -1)

        S = block_diag(*own) + np.kron(generator.T, np.eye(n))
        X = ideal_residual.integrate(S, forcing, X, t + begin, t + end, breaks)
        read = delays == end
        answer[read] = np.einsum("cjn,cn->j", K, X.reshape(modes, n))[read]
        begin = end
    return answer


def check(run, plant, law, bends, feedback):
    size, largest = np.abs(run.states).max(), np.abs(run.inputs).max()
    for begin, end in ((0.0, 0.4), (0.4, 1.1), (1.1, 1.6)):
        assert ideal_residual.plant_defect(run, plant, begin, end, bends) < 1e-10 * size
    for t in TIMES:
        u = run.record.inputs_at(np.array([t]))[0]
        assert np.abs(u - feedback(law, run, t, bends)).max() < 1e-10 * largest


@pytest.mark.parametrize("seed", mostly_long(range(8), 1, 2))
def test_a_run_solves_the_plants_equation_and_the_moments(seed):
    rng = np.random.default_rng(seed)
    plant, model, K = random_loop(rng, truth=seed % 2 == 1)
    law = dt.ExpectedPredictor(model, K, dt.Markov(RATES[model.modes]), allow_unstable=True)
    run, bends = run_of(rng, plant, law)
    check(run, plant, law, bends, by_moments)


RATE = 1.7


def over_the_instant(law, run, t, bends):
    """u(t) where mode 0 is left for mode 1 at RATE and mode 1 is never left."""
    model = law.plant
    system = model.A, model.B, model.delays
    mode = int(run.signal(np.array([t]))[0])
    if mode == 1:
        return ideal_residual.previewed(run, t, [(-1.0, 1)], system, law.gains, bends)
    last = model.longest_delay
    answer = np.exp(-RATE * last) * ideal_residual.previewed(
        run, t, [(-1.0, 0)], system, law.gains, bends
    )
    # The integrand is not smooth where what acts first after the switch is a jump or bend of u.
    jumps = ideal_residual.rough(run, [model.delays], deep=1)
    bent = np.concatenate([jumps + d - t for d in model.delays[0]])
    edges = np.unique(
        np.concatenate(([0.0, last], model.delays[0], bent[(bent > 0) & (bent < last)]))
    )
    edges = edges[np.append(True, np.diff(edges) > 1e-9)]
    nodes, weights = np.polynomial.legendre.leggauss(6)
    for begin, end in itertools.pairwise(edges):
        for z, w in zip(nodes, weights, strict=True):
            s = begin + 0.5 * (end - begin) * (z + 1.0)
            density = 0.5 * (end - begin) * w * RATE * np.exp(-RATE * s)
            believed = [(-1.0, 0), (t + s, 1)]
            answer += density * ideal_residual.previewed(run, t, believed, system, law.gains, bends)
    return answer


@pytest.mark.parametrize("seed", mostly_long(range(6), 0))
def test_it_is_the_mean_of_the_exact_feedback_over_the_instant_of_the_switch(seed):
    rng = np.random.default_rng(50 + seed)
    plant, model, K = random_loop(rng, modes=2, truth=seed % 2 == 1)
    once = dt.Markov([[0.0, RATE], [0.0, 0.0]])
    law = dt.ExpectedPredictor(model, K, once, allow_unstable=True)
    run, bends = run_of(rng, plant, law)
    largest = np.abs(run.inputs).max()
    for t in (0.02, 0.62):
        u = run.record.inputs_at(np.array([t]))[0]
        assert np.abs(u - over_the_instant(law, run, t, bends)).max() < 1e-10 * largest


def test_the_digital_loop_tends_to_it_with_order_one():
    rng = np.random.default_rng(1)
    A, B = rng.normal(size=(2, 2, 2)), rng.normal(size=(2, 2, 2))
    plant = dt.SwitchedSystem(A, B, [0.3, 0.2])
    K = 0.6 * rng.normal(size=(2, 2, 2))
    law = dt.ExpectedPredictor(plant, K, dt.Markov(RATES[2]), allow_unstable=True)
    signal, x0 = dt.SwitchingSignal([0.0, 0.55, 1.15], [0, 1, 0]), [1.0, -0.5]
    ends = [
        dt.simulate(plant, law, signal, x0, 2.0, step=step).states[:, -1]
        for step in (0.01, 0.005, 0.0025)
    ]
    ideal = dt.simulate(plant, law, signal, x0, 2.0, step=None).states[:, -1]
    wrong = [np.linalg.norm(end - ideal) for end in ends]
    assert np.log2(wrong[:-1]) - np.log2(wrong[1:]) == pytest.approx([1.0, 1.0], abs=0.05)


def test_a_mode_that_is_never_left_is_the_single_mode_law():
    rng = np.random.default_rng(6)
    plant, _, K = random_loop(rng, modes=2)
    laws = (
        dt.ExpectedPredictor(plant, K, dt.Markov([[0, RATE], [0, 0]]), allow_unstable=True),
        dt.SingleModePredictor(plant, K, 1, allow_unstable=True),
    )
    held, x0 = dt.SwitchingSignal.constant(1), rng.normal(size=plant.states)
    one, other = (dt.simulate(plant, law, held, x0, 2.0, step=None).states for law in laws)
    assert np.abs(one - other).max() < 1e-12 * np.abs(other).max()


def test_switching_many_times_per_delay_is_refused_by_name():
    plant = dt.SwitchedSystem(np.zeros((2, 1, 1)), np.ones((2, 1, 2)), [0.3, 0.2])
    fast = dt.Markov([[0, 200.0], [100.0, 0]])
    law = dt.ExpectedPredictor(plant, np.full((2, 2, 1), -0.5), fast)
    constant = dt.SwitchingSignal.constant(0)
    with pytest.raises(dt.ArgumentError, match=r"rates up to 200 1/s and a delay of 0.3 s"):
        dt.simulate(plant, law, constant, [1.0], 1.0, step=None)
