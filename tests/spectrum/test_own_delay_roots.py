"""Characteristic roots where inputs and modes have delays of their own.

Two second methods, neither of which knows of windows: Δ(s) from predictions marched along motions
e^{st} by exponentials alone, and the delay equation's generator on Chebyshev points.
"""

from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.polynomial.chebyshev import chebder, chebvander
from scipy.linalg import block_diag, eigvals, expm

import deadtime as dt
import plants
from deadtime.spectrum.characteristic import count_right_of, rightmost
from deadtime.spectrum.ideal import IdealLoop
from shares import mostly_long

LONGEST = 0.8


def random_plant(rng, modes, delays=None):
    n, m = rng.integers(1, 5), rng.integers(2, 4)
    A, B = rng.normal(size=(modes, n, n)), rng.normal(size=(modes, n, m))
    delays = rng.uniform(0.1, LONGEST, (modes, m)) if delays is None else delays
    return dt.SwitchedSystem(A, B, delays)


def random_loop(name, seed):
    """A plant, a law whose model has other delays and matrices where the seed is odd, a mode."""
    rng = np.random.default_rng(seed)
    plant = model = random_plant(rng, 2)
    K = 0.6 * rng.normal(size=(2, plant.inputs, plant.states))
    if seed % 2:
        A = plant.A + 0.1 * rng.normal(size=plant.A.shape)
        model = dt.SwitchedSystem(A, plant.B, plant.delays * rng.uniform(0.8, 1.2, (2, 1)))
    if name == "one delay for all":
        model = dt.SwitchedSystem(plant.A, plant.B, 0.4)
    return plant, LAWS[name](model, K), seed % 4 // 2


LAWS = {
    "averaged": lambda model, K: dt.AveragedPredictor(model, K, [0.3, 0.7], allow_unstable=True),
    "single": lambda model, K: dt.SingleModePredictor(model, K, 1, allow_unstable=True),
    "mean": lambda model, K: dt.MeanPredictor(model, K.mean(axis=0), allow_unstable=True),
    "delay ignored": lambda model, K: dt.DelayedStateFeedback(model, K, allow_unstable=True),
    "one delay for all": lambda model, K: dt.AveragedPredictor(model, K, allow_unstable=True),
}


class Believed(NamedTuple):
    """A mode that a law predicts along."""

    weight: float
    A: np.ndarray
    B: np.ndarray
    delays: np.ndarray
    K: np.ndarray


def believed(law, mode):
    """The modes that a law predicts along."""
    model = law.plant
    if isinstance(law, dt.MeanPredictor):
        return [Believed(1.0, *law.mean, model.delays.mean(axis=0), law.gain)]
    if isinstance(law, dt.DelayedStateFeedback):
        none = np.zeros(model.inputs)
        return [Believed(1.0, model.A[mode], model.B[mode], none, law.gains[mode])]
    single = isinstance(law, dt.SingleModePredictor)
    weights = np.eye(model.modes)[law.mode] if single else law.weights
    return [
        Believed(weights[i], model.A[i], model.B[i], model.delays[i], law.gains[i])
        for i in range(model.modes)
    ]


def sent(law, mode, start, propagate):
    """Rows of u_j = Σ w K_j x̂(D_j); `propagate` takes a prediction through one stage."""
    rows = np.zeros((law.plant.inputs, start.shape[1]), start.dtype)
    for weight, A, B, delays, K in believed(law, mode):
        x, ends = start, np.unique(delays)
        for begin, end in zip(np.append(0.0, ends[:-1]), ends, strict=True):
            open_inputs = delays >= end
            closed = A + B[:, ~open_inputs] @ K[~open_inputs]
            x = propagate(closed, np.where(open_inputs, B, 0.0), delays, begin, end, x)
            arrived = delays == end
            rows[arrived] += weight * (K[arrived] @ x)
    return rows


def matrix_by_motions(plant, law, mode, s):
    """Δ(s): what a law sends if x = X e^{st} and u = U e^{st} for t ≤ 0."""
    n, m = plant.B.shape[1:]

    def propagate(S, B, delays, begin, end, x):
        # dx̂/dθ = S x̂ + B v,  dv/dθ = s v,  v_k = U_k e^{s(θ − D_k)}.
        both = np.block([[S, B], [np.zeros((m, n)), s * np.eye(m)]]).astype(complex)
        v = np.hstack((np.zeros((m, n)), np.diag(np.exp(s * (begin - delays)))))
        return (expm(both * (end - begin)) @ np.vstack((x, v)))[:n]

    row = sent(law, mode, np.eye(n, n + m).astype(complex), propagate)
    A, B = plant.A[mode], plant.B[mode] * np.exp(-s * plant.delays[mode])
    return np.block([[s * np.eye(n) - A, -B], [-row[:, :n], np.eye(m) - row[:, n:]]])


def matrix_by_moments(plant, law, mode, s):
    """Δ(s) under the expected law: the moments of x in every mode along a motion."""
    A, B, K, delays = law.plant.A, law.plant.B, law.gains, law.plant.delays[0]
    (modes, n, m), flow = B.shape, law.model.generator.T
    here = np.eye(modes)[:, [mode]]
    X = np.kron(here, np.eye(n, n + m)).astype(complex)
    forced, rows, begin = block_diag(*B), np.zeros((m, n + m), complex), 0.0
    for end in np.unique(delays):
        flying = delays >= end
        own = [A[i] + B[i][:, ~flying] @ K[i][~flying] for i in range(modes)]
        # dX/dθ = 𝒮 X + ℬ V,  V = p ⊗ v,  v_k = U_k e^{s(θ − D_k)}.
        moved = np.kron(flow, np.eye(m)) + s * np.eye(modes * m)
        fed = forced * np.tile(flying, modes)
        S = block_diag(*own) + np.kron(flow, np.eye(n))
        both = np.block([[S, fed], [np.zeros((modes * m, modes * n)), moved]])
        v = np.hstack((np.zeros((m, n)), np.diag(np.exp(s * (begin - delays)))))
        V = np.kron(expm(flow * begin) @ here, v)
        X = (expm(both * (end - begin)) @ np.vstack((X, V)))[: modes * n]
        read = delays == end
        rows[read] = (K.transpose(1, 0, 2).reshape(m, modes * n) @ X)[read]
        begin = end
    late = plant.B[mode] * np.exp(-s * plant.delays[mode])
    own = s * np.eye(n) - plant.A[mode]
    return np.block([[own, -late], [-rows[:, :n], np.eye(m) - rows[:, n:]]])


def roots_by_chebyshev(plant, law, mode, degree=50):
    """All eigenvalues of the generator on (x, u at Chebyshev points of [−T, 0]), u(0) algebraic."""
    n, m = plant.B.shape[1:]
    longest = max(plant.delays.max(), law.plant.delays.max())
    points = np.cos(np.pi * np.arange(degree + 1) / degree)
    from_values = np.linalg.inv(chebvander(points, degree))
    slopes = chebvander(points, degree - 1) @ chebder(from_values) * 2.0 / longest
    gauss, weight = np.polynomial.legendre.leggauss(24)
    size = n + m * (degree + 1)

    def input_at(k, times):
        rows = np.zeros((len(times), size))
        rows[:, n + k :: m] = chebvander(1.0 + 2.0 * times / longest, degree) @ from_values
        return rows

    def propagate(S, B, delays, begin, end, x):
        half = 0.5 * (end - begin)
        times = begin + half * (gauss + 1.0)
        x = expm(S * (end - begin)) @ x
        ahead = half * weight[:, None, None] * (expm((end - times)[:, None, None] * S) @ B)
        for k in range(m):
            x = x + np.einsum("gi,gp->ip", ahead[:, :, k], input_at(k, times - delays[k]))
        return x

    G, E = np.zeros((size, size)), np.eye(size)
    G[:n, :n] = plant.A[mode]
    for j, delay in enumerate(plant.delays[mode]):
        G[:n] += np.outer(plant.B[mode][:, j], input_at(j, np.array([-delay]))[0])
        G[n + j :: m, n + j :: m] = slopes
    G[n : n + m] = sent(law, mode, np.eye(n, size), propagate) - np.eye(m, size, n)
    E[n : n + m] = 0.0
    pairs: Any = eigvals(G, E, homogeneous_eigvals=True)
    alpha, beta = pairs
    finite = beta != 0.0
    return alpha[finite] / beta[finite]


# -- known roots -------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", mostly_long(range(50), *range(12)))
def test_the_exact_law_leaves_the_n_eigenvalues_of_the_closed_loop_and_no_other_root(seed):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, 1)
    K = 0.6 * rng.normal(size=(1, plant.inputs, plant.states))
    law = dt.SingleModePredictor(plant, K, 0, allow_unstable=True)
    found = dt.characteristic_roots(plant, law, 0, count=8)
    placed = np.linalg.eigvals(plant.A[0] + plant.B[0] @ K[0]).astype(complex)
    assert found.complete
    assert found.roots.shape == placed.shape
    plants.close(np.sort_complex(found.roots), np.sort_complex(placed), 1e-12)


def test_the_design_s_example_keeps_its_poles_with_either_input_late_and_one_horizon_does_not():
    A, B = np.array([[1.0, 1.0], [0.0, 0.5]]), np.array([[1.0, 0.0], [0.2, 1.0]])
    K = np.linalg.inv(B) @ (np.diag([-1.0, -1.5]) - A)
    for delays, of_longest in (([1.2, 0.7], -0.15), ([0.7, 1.2], 1.26)):
        plant = dt.SwitchedSystem([A], [B], delays)
        law = dt.SingleModePredictor(plant, [K], 0)
        roots = dt.characteristic_roots(plant, law, 0).roots
        plants.close(np.sort_complex(roots), np.array([-1.5, -1.0 + 0j]), 1e-11)
        both = dt.SingleModePredictor(dt.SwitchedSystem([A], [B], 1.2), [K], 0)
        # Digital, with h = 0.05; of the ideal loop within the step's share.
        assert dt.growth_rate(plant, both, 0, 0.05) == pytest.approx(of_longest, abs=0.01)
        assert dt.growth_rate(plant, both, 0, None) == pytest.approx(of_longest, abs=0.1)


# -- second methods ----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", mostly_long(range(8), 0, 1, 2))
@pytest.mark.parametrize("name", LAWS)
def test_roots_make_motions_of_the_law_s_definition_singular(name, seed):
    plant, law, mode = random_loop(name, seed)
    found = dt.characteristic_roots(plant, law, mode, count=5)
    assert found.complete
    for root, error in zip(found.roots, found.errors, strict=True):
        step = 1e-5
        near = [
            np.linalg.det(matrix_by_motions(plant, law, mode, root + d)) for d in (0.0, step, -step)
        ]
        correction = abs(2.0 * step * near[0] / (near[1] - near[2]))
        assert error < 1e-9
        assert correction <= 1e-11 * (1.0 + abs(root)) + 10.0 * error


@pytest.mark.parametrize("seed", mostly_long(range(8), 0, 1, 3))
@pytest.mark.parametrize("name", LAWS)
def test_the_delay_equation_on_chebyshev_points_has_these_roots_and_no_others(name, seed):
    plant, law, mode = random_loop(name, seed)
    found = dt.characteristic_roots(plant, law, mode, count=4)
    other = roots_by_chebyshev(plant, law, mode)
    other = other[other.real > found.line]
    assert found.complete
    assert other.size == found.roots.size
    for root in found.roots:
        assert np.abs(other - root).min() < 1e-8 * (1.0 + abs(root))


@pytest.mark.parametrize("seed", mostly_long(range(8), 1))
def test_roots_under_the_expected_law_make_its_moments_along_motions_singular(seed):
    rng = np.random.default_rng(seed)
    random = random_plant(rng, 2)
    model = dt.SwitchedSystem(random.A, random.B, random.delays[0])
    plant = dt.SwitchedSystem(model.A, model.B, model.delays * (0.9 if seed % 2 else 1.0))
    K = 0.6 * rng.normal(size=(2, plant.inputs, plant.states))
    rates = dt.Markov([[0.0, 1.5], [2.5, 0.0]])
    law = dt.ExpectedPredictor(model, K, rates, allow_unstable=True)
    for mode in (0, 1):
        found = dt.characteristic_roots(plant, law, mode, count=4)
        assert found.complete
        for root in found.roots:
            near = [
                np.linalg.det(matrix_by_moments(plant, law, mode, root + d))
                for d in (0.0, 1e-5, -1e-5)
            ]
            assert abs(2e-5 * near[0] / (near[1] - near[2])) <= 1e-10 * (1.0 + abs(root))


# -- bounds ------------------------------------------------------------------------------------


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", mostly_long(range(4), 1))
@pytest.mark.parametrize("name", LAWS)
def test_beyond_the_radius_what_goes_round_the_loop_is_less_than_one(name, seed):
    plant, law, mode = random_loop(name, seed)
    loop = IdealLoop.of(plant, law, mode)
    n = plant.states
    for line, any_delay in ((-1.5, False), (0.0, False), (0.0, True)):
        radius = loop.radius(line, any_delay)
        far = radius * np.array([1.0, 3.0])
        angle = np.linspace(0.0, 1.0, 4) * np.arccos(max(-1.0, line / radius))
        for s in np.outer(far, np.exp(1j * angle)).ravel():
            if s.real < line:
                continue
            Delta = matrix_by_motions(plant, law, mode, s)
            inner = np.linalg.solve(Delta[:n, :n], -Delta[:n, n:])
            gain = np.eye(plant.inputs) - Delta[n:, n:] - Delta[n:, :n] @ inner
            assert np.linalg.norm(gain, 2) <= 0.99 * (1.0 + 1e-9)
    found = rightmost(loop, 12)
    assert np.abs(found.roots).max() < loop.radius(found.line)


@pytest.mark.parametrize("seed", range(4))
def test_lines_between_roots_have_the_right_number_to_their_right(seed):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, 1)
    K = 0.6 * rng.normal(size=(1, plant.inputs, plant.states))
    loop = IdealLoop.of(plant, dt.SingleModePredictor(plant, K, 0, allow_unstable=True), 0)
    reals = np.linalg.eigvals(plant.A[0] + plant.B[0] @ K[0]).real
    for line in (reals.min() - 1.0, reals.min() - 1e-6, reals.max() - 1e-6, reals.max() + 1e-6):
        assert count_right_of(loop, float(line)) == np.sum(reals > line)


@pytest.mark.parametrize("name", LAWS)
def test_both_ways_to_compute_the_memory_agree_and_slopes_are_slopes(name):
    loop = IdealLoop.of(*random_loop(name, 3))
    inside = loop.near * np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 17)) * (1.0 - 1e-14)
    outside = inside * (1.0 + 2e-14)
    assert (np.abs(outside) > loop.near).all()
    for one, other in zip(loop.memory(inside)[0], loop.memory(outside)[0], strict=True):
        plants.close(one, other, 1e-12, max(np.abs(one).max(), 1.0))
    s, step = np.concatenate((inside * 0.3, inside * 3.0)), 1e-6
    difference = (loop.matrix(s + step)[0] - loop.matrix(s - step)[0]) / (2.0 * step)
    plants.close(loop.matrix(s)[1], difference, 1e-7)


# -- relations and runs ------------------------------------------------------------------------


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", mostly_long(range(4), 1))
@pytest.mark.parametrize("name", LAWS)
def test_the_digital_rate_tends_to_the_ideal_one_with_order_one(name, seed):
    plant, law, mode = random_loop(name, seed)
    limit = dt.growth_rate(plant, law, mode, step=None)
    coarse, fine = (abs(dt.growth_rate(plant, law, mode, h) - limit) for h in (0.004, 0.002))
    assert fine < 0.05 * (1.0 + abs(limit))
    assert 0.85 < np.log2(coarse / fine) < 1.15


@pytest.mark.few(1)
@pytest.mark.parametrize("name", LAWS)
def test_a_run_of_the_ideal_loop_becomes_a_sum_of_the_rightmost_motions(name):
    plant, law, mode = random_loop(name, 1)
    found = dt.characteristic_roots(plant, law, mode, 4)
    # Motions of these roots obey one recurrence over τ; the next one has died out.
    count, tau, late = found.roots.size, 0.17, 6.0
    recurrence = np.poly(np.exp(found.roots * tau)).real
    signal, times = dt.SwitchingSignal.constant(mode), late + tau * np.arange(count + 1)
    x0 = np.array([-1.0, 1.0, 0.5, 0.2])[: plant.states]
    run = dt.simulate(plant, law, signal, x0, times[-1], step=None, times=times)
    terms = run.states[:, ::-1] * recurrence
    following = dt.characteristic_roots(plant, law, mode, count + 1).roots
    gap = following[count].real - following[0].real if following.size > count else -np.inf
    rest = np.exp(gap * late)
    assert rest < 0.05
    assert (np.abs(terms.sum(axis=1)) <= (10.0 * rest + 1e-9) * np.abs(terms).max(axis=1)).all()


@pytest.mark.parametrize("name", LAWS)
def test_inputs_in_another_order_have_the_same_roots(name):
    plant, law, mode = random_loop(name, 4)
    order = np.roll(np.arange(plant.inputs), 1)
    model = law.plant
    turned, believed_now = (
        dt.SwitchedSystem(p.A, p.B[:, :, order], p.delays[:, order]) for p in (plant, model)
    )
    K = law.gains[:, order] if law.gains is not None else None
    if isinstance(law, dt.MeanPredictor):
        other = dt.MeanPredictor(believed_now, law.gain[order], allow_unstable=True)
    else:
        other = LAWS[name](believed_now, K)
    own = dt.characteristic_roots(plant, law, mode, 4).roots
    plants.close(
        np.sort_complex(dt.characteristic_roots(turned, other, mode, 4).roots),
        np.sort_complex(own),
        1e-10,
    )


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", ["averaged", "mean"])
def test_a_dwell_time_long_past_changes_nothing(kind):
    plant, plain, mode = random_loop(kind, 2)
    if isinstance(plain, dt.MeanPredictor):
        aware = dt.MeanPredictor(plain.plant, plain.gain, None, 0.3, allow_unstable=True)
    else:
        aware = dt.AveragedPredictor(
            plain.plant, plain.gains, plain.weights, 0.3, allow_unstable=True
        )
    known, found = (dt.characteristic_roots(plant, law, mode).roots for law in (plain, aware))
    assert np.array_equal(found, known)
    limit = dt.growth_rate(plant, aware, mode, None)
    coarse, fine = (abs(dt.growth_rate(plant, aware, mode, h) - limit) for h in (0.004, 0.002))
    assert 0.85 < np.log2(coarse / fine) < 1.15


def test_an_oracle_of_a_mode_that_lasts_is_the_law_of_that_mode():
    plant, single, _ = random_loop("single", 2)
    oracle = dt.ExactPredictor(plant, single.gains, allow_unstable=True)
    placed = np.linalg.eigvals(plant.A[1] + plant.B[1] @ single.gains[1]).astype(complex)
    found = dt.characteristic_roots(plant, oracle, 1, count=8)
    plants.close(np.sort_complex(found.roots), np.sort_complex(placed), 1e-12)
    other = dt.ExactPredictor(
        plant, single.gains, dt.SwitchingSignal.constant(1), allow_unstable=True
    )
    known = dt.characteristic_roots(plant, single, 0).roots
    assert np.array_equal(dt.characteristic_roots(plant, other, 0).roots, known)


def test_a_delay_that_is_hardly_another_hardly_moves_the_roots():
    rng = np.random.default_rng(2)
    one = random_plant(rng, 2, 0.3)
    delays = np.full(one.delays.shape, 0.3)
    delays[:, 0] *= 1.0 + 1e-9
    K = 0.6 * rng.normal(size=(2, one.inputs, one.states))
    known, near = (
        dt.characteristic_roots(plant, LAWS["averaged"](plant, K), 0, 4).roots
        for plant in (one, dt.SwitchedSystem(one.A, one.B, delays))
    )
    plants.close(near, known, 1e-7)
