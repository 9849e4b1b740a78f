"""The theorem with a delay per input: its formulas by quadrature, and no run contradicts them."""

import functools
import itertools

import numpy as np
import pytest

import deadtime as dt
from deadtime.certificates import theorem_bound
from deadtime.certificates.theorem.sharp import log_star
from shares import mostly_long

DELAYS = {"two": [0.5, 0.2], "three": [0.3, 0.1, 0.2], "pairs": [0.4, 0.1, 0.4]}


@functools.cache
def case(name, distance=0.3, seed=0):
    """Two or three modes near each other, with gains that decay."""
    rng = np.random.default_rng([seed, len(name)])
    m, n, modes = len(DELAYS[name]), 2 + seed % 2, 2 + seed % 2
    A, B = 0.5 * rng.normal(size=(n, n)), rng.normal(size=(n, m))
    nominal = dt.SwitchedSystem(A[None], B[None], DELAYS[name])
    K = dt.lqr(nominal, np.eye(n), 4.0 * np.eye(m))[0]

    def modes_of(M):
        ways = rng.normal(size=(modes, *M.shape))
        return M + 0.5 * distance * ways / np.linalg.norm(ways, 2, axis=(1, 2))[:, None, None]

    return dt.SwitchedSystem(modes_of(A), modes_of(B), DELAYS[name]), modes_of(K)


def pulled(name, seed=0, share=0.8):
    """Modes as far apart as the theorem allows, less a little, and the bound."""
    distance = 0.05
    for _ in range(30):
        plant, gains = case(name, distance, seed)
        bound = theorem_bound(plant, gains, 0.2, form="sharp")
        if share / 2.0 < bound.epsilon / bound.epsilon_star < 1.0:
            return plant, gains, bound
        distance *= share * bound.epsilon_star / bound.epsilon
    raise AssertionError("no such distance")


def integral(rate, length):
    points, weights = np.polynomial.legendre.leggauss(40)
    return length / 2.0 * weights @ np.exp(rate * length * (points + 1.0) / 2.0)


def log_norm(M):
    return np.linalg.eigvalsh((M + M.T) / 2.0)[-1]


def size(matrices):
    return max(np.linalg.norm(M, 2) for M in matrices)


class Sizes:
    """What the proof needs of a plant, in the norm of P."""

    def __init__(self, plant, gains, P):
        L = np.linalg.cholesky(P)
        D = plant.delays[0]
        self.d, order = np.unique(D), [np.flatnonzero(d == D) for d in np.unique(D)]
        self.M = np.array([size(gains[:, k]) for k in order])
        self.B = np.array([size(plant.B[:, :, k]) for k in order])
        stages = [np.concatenate([[], *order[:q]]).astype(int) for q in range(len(order))]
        self.a = max(
            log_norm(A + B[:, k] @ K[k])
            for A, B, K in zip(plant.A, plant.B, gains, strict=True)
            for k in stages
        )
        H = [A + B @ K for A, B, K in zip(plant.A, plant.B, gains, strict=True)]
        self.omega = -max(log_norm(L.T @ h @ np.linalg.inv(L).T) for h in H)
        self.eta = 1.0 / np.sqrt(np.linalg.eigvalsh(P)[0])
        self.beta = size(L.T @ plant.B)
        self.kappa = size(gains @ np.linalg.inv(L).T)
        self.M_B, self.share = size(plant.B), 1.0 - 1.0 / plant.modes
        self.order = order

    def inverse_star(self, xi):
        g, a = self.d.size, self.a + xi
        G, m = np.zeros((g, g)), np.zeros(g)
        for q in range(g):
            for p in range(q):
                G[q, p] = self.M[q] * self.B[p] * integral(a, self.d[q] - self.d[p])
            whole, late = integral(a, self.d[q]), integral(a, self.d[q] - self.d[0])
            x = self.M[q] * ((self.eta + self.kappa) * whole + self.M_B * self.eta * late)
            m[q] = (x + self.eta) * self.beta / (self.omega - xi) + self.M[q] * whole
        return self.share * np.linalg.norm(np.linalg.solve(np.eye(g) - G, m))


@pytest.mark.parametrize("name", DELAYS)
def test_epsilon_star_is_that_of_the_proof_by_quadrature(name):
    plant, gains = case(name, 0.05)
    pair = dt.common_lyapunov(plant, gains)
    bound = theorem_bound(plant, gains, 0.2, pair, "sharp")
    sizes = Sizes(plant, gains, pair.P)
    groups, norm = bound.constants.groups, bound.constants.norm
    if norm.euclid > 1.0 + 1e-12:  # the norm of P, not |x|
        for share in (0.0, 0.3, 0.9):
            xi = share * sizes.omega
            star = np.exp(log_star(groups, norm, xi))
            assert star == pytest.approx(1.0 / sizes.inverse_star(xi), rel=1e-10)
        assert bound.epsilon_star == pytest.approx(1.0 / sizes.inverse_star(0.0), rel=1e-10)
    assert bound.epsilon_star >= (1.0 - 1e-10) / sizes.inverse_star(0.0)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", DELAYS)
def test_what_arrives_is_within_the_inequality_of_the_proof(name):
    # With modes far apart: nothing in it needs them close.
    for seed in range(3):
        plant, gains = case(name, 0.25, seed)
        sizes = Sizes(plant, gains, np.eye(plant.states))
        epsilon = theorem_bound(plant, gains, 0.2, form="sharp").epsilon
        law = dt.AveragedPredictor(plant, gains)
        signal = dt.SwitchingSignal.random(plant.modes, 4.0, dwell_time=0.1, seed=seed)
        x0 = np.random.default_rng(seed).normal(size=plant.states)
        times, step = np.linspace(0.0, 2.0, 2001, retstep=True)
        run = dt.simulate(plant, law, signal, x0, 2.0, None, times=times)
        x = np.linalg.norm(run.states, axis=0)
        y = np.zeros((sizes.d.size, times.size))  # as it arrives; 0 acts before
        for q, k in enumerate(sizes.order):
            lag = round(sizes.d[q] / step)
            y[q, lag:] = np.linalg.norm(run.mismatch[k][:, : times.size - lag], axis=0)
            before = [gains[i][k] @ z for i, z in zip(run.mode, run.states.T, strict=True)]
            y[q, :lag] = np.linalg.norm(before[:lag], axis=1)
        assert not np.isnan(y[:, :1500]).any()
        both, worst = np.linalg.norm(y, axis=0), 0.0
        for q in range(sizes.d.size):
            lag = round(sizes.d[q] / step)
            r = np.arange(lag + 1) * step
            kernel = np.exp(sizes.a * r)
            late = sizes.M_B * (r <= sizes.d[q] - sizes.d[0] + 1e-9)
            for s in range(lag, 1500, 13):
                back = slice(s - lag, s + 1)
                then_x, then_y = x[back][::-1], both[back][::-1]
                inside = (1.0 + sizes.kappa + late) * then_x + then_y
                allowed = sizes.M[q] * np.trapezoid(kernel * inside, dx=step) + x[s]
                allowed *= sizes.share * epsilon
                for p in range(q):
                    short = round((sizes.d[q] - sizes.d[p]) / step) + 1
                    arrived = kernel[:short] * y[p, back][::-1][:short]
                    allowed += sizes.M[q] * sizes.B[p] * np.trapezoid(arrived, dx=step)
                worst = max(worst, y[q, s] / allowed)
        assert 0.02 < worst <= 1.0


@pytest.mark.few(2)
@pytest.mark.parametrize("name", DELAYS)
@pytest.mark.parametrize("seed", range(2))
def test_runs_stay_below_the_envelope(name, seed):
    plant, gains, bound = pulled(name, seed)
    assert bound.holds
    assert bound.rho is not None
    assert bound.xi is not None
    law, D, step = dt.AveragedPredictor(plant, gains), plant.longest_delay, 0.01
    n = round(D / step)
    for draw in range(3):
        rng = np.random.default_rng([seed, draw])
        signal = dt.SwitchingSignal.random(plant.modes, 12.0, dwell_time=0.05, seed=draw)
        past = rng.normal(size=(plant.inputs, n)) * rng.choice([0.0, 1.0, 30.0])
        x0 = rng.normal(size=plant.states)
        run = dt.simulate(plant, law, signal, x0, 8.0, step, u0=past)
        squares = np.sum(np.hstack([past, run.inputs]) ** 2, axis=0) * step
        total = np.concatenate([[0.0], np.cumsum(squares)])
        energy = np.sqrt(np.maximum(total[n : n + run.time.size] - total[: run.time.size], 0.0))
        reached = np.linalg.norm(run.states, axis=0) + energy
        assert (reached <= bound.rho * np.exp(-bound.xi * run.time) * reached[0]).all()


# Two modes and two inputs; three modes, and inputs of which two have one delay.
@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("name", "seed"),
    mostly_long(itertools.product(DELAYS, range(2)), ("two", 0), ("pairs", 1)),
)
def test_no_constant_signal_and_no_attack_grows_where_the_theorem_holds(name, seed):
    plant, gains, bound = pulled(name, seed, share=0.99)
    assert bound.holds
    law = dt.AveragedPredictor(plant, gains)
    for mode in range(plant.modes):
        # It decays, and no more slowly than the theorem says.
        assert dt.growth_rate(plant, law, mode, None) <= -bound.xi
    assert dt.falsify(plant, law, 0.2, 0.05, budget=20_000).growth_rate < 0.0


def test_delays_that_nearly_agree_allow_about_as_much_as_one():
    for seed in range(4):
        plant, gains = case("two", 0.05, seed)
        one = dt.SwitchedSystem(plant.A, plant.B, 0.3)
        near = dt.SwitchedSystem(plant.A, plant.B, [0.3, 0.3 + 1e-7])
        bounds = [theorem_bound(each, gains, 0.2, form="sharp") for each in (one, near)]
        assert 0.5 < bounds[1].epsilon_star / bounds[0].epsilon_star < 2.0
        assert bounds[1].nu1 is bounds[1].kappa is bounds[1].b is None


def test_modes_that_are_alike_need_no_distance():
    plant, gains = case("two")
    single = dt.SwitchedSystem(plant.A[:1], plant.B[:1], plant.delays[:1])
    bound = theorem_bound(single, gains[:1], 0.2, form="sharp")
    assert bound.holds
    assert bound.epsilon_star == np.inf
    assert bound.rho is not None
    assert np.isfinite(bound.rho)


@pytest.mark.parametrize(
    ("number", "shorter", "expected"), [(1, 0.98, ("0.027", "0.078")), (0, 0.95, ("0.45", "0.56"))]
)
def test_modes_of_the_same_matrices_grow_where_their_delays_differ(number, shorter, expected):
    problem = dt.problems.paper()
    A, B, K = (
        np.stack([part[number]] * 2) for part in (problem.plant.A, problem.plant.B, problem.gains)
    )

    def rates(delay):
        plant = dt.SwitchedSystem(A, B, delay)
        law = dt.AveragedPredictor(plant, K)
        return [dt.growth_rate(plant, law, mode, step=None) for mode in range(2)]

    assert max(rates(1.0)) < 0.0
    assert tuple(f"{rate:.2g}" for rate in rates([[1.0], [shorter]])) == expected


def test_what_is_not_stated_is_refused():
    plant, gains = case("two")
    with pytest.raises(dt.ArgumentError, match=r"form must be 'sharp' where.*got 'corrected'"):
        theorem_bound(plant, gains, 0.2)
    own = dt.SwitchedSystem(plant.A, plant.B, [[0.5, 0.2], [0.4, 0.2]])
    with pytest.raises(
        dt.ArgumentError, match=r"same delays in all modes.*Use certify for this loop"
    ):
        theorem_bound(own, gains, 0.2, form="sharp")
