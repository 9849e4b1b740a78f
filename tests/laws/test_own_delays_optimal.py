"""Optimal and minimax laws where inputs and modes have delays of their own, by their definition.

The lifted loop is worked out by `delay_reference` with SciPy's exponential, sums over a period by
Gauss's nodes. A law is optimal if improving on the cost of its own policy gives it back.
"""

import numpy as np
import pytest
from scipy.linalg import expm

import deadtime as dt
from delay_reference import Reference
from shares import mostly_long

STEP = 0.1
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)


class Lifted:
    """Of ξ = (x, u_{k−1}, …, u_{k−N}) and u_k: what a mode makes of it, and ∫xᵀQx over a period."""

    def __init__(self, plant, Q):
        self.plant, self.Q = plant, Q
        self.model = Reference(plant.A, plant.B, plant.delays, STEP)
        self.lags = int(np.ceil(plant.longest_delay / STEP - 1e-9))
        self.n, self.m = plant.B.shape[1:]
        self.size = self.n + self.lags * self.m
        modes = range(plant.modes)
        self.moves, self.costs = map(np.array, zip(*map(self.period, modes), strict=True))

    def period(self, mode):
        """(size, size + m): ξ a period later; and the form of (ξ, u_k) that is the cost."""
        n, m, width = self.n, self.m, self.size + self.m
        x, cost = np.eye(n, width), np.zeros((width, width))
        for a, b in self.model.parts(0.0, STEP, []):
            u = np.zeros((m, width))
            for j, k in enumerate(self.model.read(mode, 0.5 * (a + b))):
                u[j, self.size + j if k == 0 else n + (-k - 1) * m + j] = 1.0
            for node, weight in zip(NODES, WEIGHTS, strict=True):
                then = self.model.move(x, mode, u, 0.5 * (node + 1.0) * (b - a))
                cost += 0.5 * weight * (b - a) * then.T @ self.Q @ then
            x = self.model.move(x, mode, u, b - a)
        move = np.zeros((self.size, width))
        move[:n], move[n : n + m, self.size :] = x, np.eye(m)
        move[n + m :, n : self.size - m] = np.eye(self.size - n - m)
        return move, cost

    def policy(self, table, mode):
        """u_k = row ξ."""
        taps = table.input_gain[mode].transpose(1, 0, 2).reshape(self.m, -1)
        return np.hstack((table.state_gain[mode], taps))

    def improve(self, rows, R, chain):
        """The best rows against the cost of going on with these."""
        modes, d = len(rows), self.size
        cost = self.costs.copy()
        cost[:, d:, d:] += STEP * R
        closed = [np.vstack((np.eye(d), row)) for row in rows]
        loops = [move @ own for move, own in zip(self.moves, closed, strict=True)]
        own = np.array([z.T @ c @ z for z, c in zip(closed, cost, strict=True)])
        step = np.zeros((modes * d * d, modes * d * d))
        for i, loop in enumerate(loops):
            rows_of = slice(i * d * d, (i + 1) * d * d)
            step[rows_of] = np.kron(chain[i], np.kron(loop.T, loop.T))
        assert np.abs(np.linalg.eigvals(step)).max() < 1.0  # a finite cost
        P = np.linalg.solve(np.eye(len(step)) - step, own.ravel()).reshape(modes, d, d)
        better = []
        for i, move in enumerate(self.moves):
            W = cost[i] + move.T @ np.tensordot(chain[i], P, 1) @ move
            better.append(-np.linalg.solve(W[d:, d:], W[d:, :d]))
        return np.array(better), P


def random_plant(seed):
    rng = np.random.default_rng(seed)
    modes, n, m = 2, int(rng.integers(1, 3)), int(rng.integers(1, 3))
    A, B = 0.6 * rng.normal(size=(modes, n, n)), rng.normal(size=(modes, n, m))
    # Not so unstable that no causal law has a finite cost.
    fastest = np.linalg.eigvals(A).real.max(axis=1)[:, None, None]
    A -= np.maximum(fastest - 0.1, 0.0) * np.eye(n)
    delays = rng.uniform(0.02, (3.5 if m == 1 else 2.5) * STEP, size=(modes, m))
    return dt.SwitchedSystem(A, B, delays), rng


@pytest.mark.parametrize("seed", mostly_long(range(40), 0, 1, 2, 3))
def test_the_optimal_law_cannot_be_improved_and_costs_what_it_says(seed):
    plant, rng = random_plant(seed)
    n, m = plant.B.shape[1:]
    Q, R = np.diag(rng.uniform(0.5, 2.0, n)), np.diag(rng.uniform(0.5, 2.0, m))
    rates = rng.uniform(0.2, 3.0, (2, 2)) * (1.0 - np.eye(2))
    law = dt.OptimalPredictor(plant, dt.Markov(rates), Q, R)
    table, lifted = law.digital(STEP), Lifted(plant, Q)
    rows = np.array([lifted.policy(table, i) for i in range(2)])
    chain = expm(STEP * (rates - np.diag(rates.sum(axis=1))))
    better, P = lifted.improve(rows, R, chain)
    assert np.abs(better - rows).max() <= 1e-9 * max(1.0, np.abs(rows).max())
    x0 = rng.normal(size=n)
    for mode in range(2):
        assert law.least_cost(x0, mode, STEP) == pytest.approx(x0 @ P[mode, :n, :n] @ x0, rel=1e-8)
    # And the run sends these.
    signal = dt.SwitchingSignal.random(2, 2.0, dwell_time=0.23, seed=seed)
    run = dt.simulate(plant, law, signal, x0, 1.0, STEP)
    xi = np.zeros(lifted.size)
    for k in range(10):
        xi[:n] = run.states[:, k]
        u = better[int(signal(np.array([k * STEP]))[0])] @ xi
        assert np.abs(run.inputs[:, k] - u).max() <= 1e-9 * max(1.0, np.abs(run.inputs).max())
        xi[n + m :], xi[n : n + m] = xi[n : lifted.size - m].copy(), run.inputs[:, k]


@pytest.mark.parametrize("seed", mostly_long(range(8), 2))
def test_no_weights_on_a_lattice_leave_less_growth_than_the_minimax_law(seed):
    plant, rng = random_plant(seed)
    K = dt.lqr(plant, np.eye(plant.states), np.eye(plant.inputs))
    law = dt.AveragedPredictor.minimax(plant, K, STEP)
    lifted = Lifted(plant, np.eye(plant.states))

    def worst(weights):
        own = dt.AveragedPredictor(plant, law.gains, weights, allow_unstable=True).digital(STEP)
        found = []
        for move in lifted.moves:
            closed = move @ np.vstack((np.eye(lifted.size), lifted.policy(own, 0)))
            found.append(np.log(np.abs(np.linalg.eigvals(closed)).max()) / STEP)
        return max(found)

    best = worst(law.weights)
    for share in np.linspace(0.0, 1.0, 41):
        assert best <= worst([share, 1.0 - share]) + 1e-6
    # By definition of the averaged law, from the model's predictions.
    x, past = rng.normal(size=plant.states), rng.normal(size=(lifted.lags, plant.inputs))
    modes = range(plant.modes)
    u = sum(
        law.weights[i]
        * lifted.model.feedback(
            0, x, [], lambda t, i=i: i, [law.gains[i]] * 2, lambda j, k: past[-k - 1, j]
        )
        for i in modes
    )
    own = lifted.policy(law.digital(STEP), 0) @ np.concatenate((x, past.ravel()))
    assert np.abs(own - u).max() <= 1e-12 * max(1.0, np.abs(u).max())
