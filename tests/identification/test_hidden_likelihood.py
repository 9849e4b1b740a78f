"""The likelihood of hidden modes against all paths of another's densities, and its derivatives."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh, expm
from scipy.stats import multivariate_normal

from deadtime.identification.hidden_estimate import clipped, information_of
from deadtime.identification.likelihoods.hidden_chain import Jumps, Periods
from deadtime.identification.likelihoods.hidden_log import HiddenLog
from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import Layout, cells_of
from deadtime.identification.sampling import nodes_for, sampling_of
from synthetic_logs import Plant, oscillator

H = 0.05
CHAIN = np.array([[0.9, 0.1], [0.2, 0.8]])


def likelihood(plant, count, last, per_mode=False, seed=0):
    """The likelihood of a log of a plant, at its own noise, and where the truth lies."""
    rng, (modes, n, m) = np.random.default_rng(seed), plant.B.shape
    t, mode = H * np.arange(count), (np.arange(count) // 6) % modes
    y, u = plant.log(t, rng.standard_normal((count, m)), rng, mode)
    part = Part(t, y, u, np.zeros(count, np.int64))
    record = Recording((part,), H, True, ("x",) * n, ("u",) * m, ("0", "1"), False)
    layout, S = Layout(modes, n, m, per_mode), [plant.covariance(i, H) for i in range(modes)]
    nodes = nodes_for((part,), plant.A)
    window = 1e-8, last * H
    periods = Periods.of(sampling_of(record, nodes), (part,), window, None, constant=False)
    given = record, layout, False, window, nodes, periods
    log = HiddenLog(*given, np.array(S), Jumps(CHAIN, H, rates=False))
    theta = layout.join(plant.A, plant.B, plant.D)
    return log, theta, cells_of(theta[layout.at_delays], H)


def test_the_likelihood_is_the_sum_over_all_paths():
    """2^10 paths of ten usable periods; two inputs with delays of their own in every mode."""
    A = [[[-1.0, 0.5], [0.0, -2.0]], [[-0.2, 1.0], [-3.0, -0.1]]]
    B = [[[1.0, 0.2], [0.3, -1.0]], [[0.5, 0.0], [1.0, 1.0]]]
    plant = Plant(A, B, [[0.112, 0.174], [0.05, 0.033]], 1e-2 * np.eye(2))
    log, theta, cells = likelihood(plant, 15, 4, per_mode=True)
    part, (k,) = log.periods.parts[0], log.periods.usable
    assert k.size == 10
    density = np.empty((k.size, 2))
    for row, place in enumerate(k):
        for i in (0, 1):
            mode = np.full(part.time.size, i)
            Phi, moved = plant.period(part.time, part.input, mode, place)
            normal = multivariate_normal(Phi @ part.output[place] + moved, plant.covariance(i, H))
            density[row, i] = normal.logpdf(part.output[place + 1])
    start = np.array([0.5, 0.5]) @ np.linalg.matrix_power(CHAIN, int(k[0]))
    total = 0.0
    for path in itertools.product((0, 1), repeat=k.size):
        chance = start[path[0]] * np.prod(CHAIN[path[:-1], path[1:]])
        total += chance * np.exp(density[np.arange(k.size), path].sum() - density.sum() / 2)
    value = np.log(total) + density.sum() / 2
    assert log.posterior(theta, cells).value == pytest.approx(value, abs=1e-8)


def test_the_score_is_the_slope_of_the_likelihood():
    log, theta, cells = likelihood(oscillator(W=3e-3), 120, 8)
    theta = theta * (1.0 + 1e-3 * np.arange(theta.size))
    score = log.evaluate(theta, cells).score
    for a in range(theta.size):
        step = np.zeros(theta.size)
        step[a] = 1e-6
        ends = [log.evaluate(theta + sign * step, cells).value for sign in (1, -1)]
        assert (ends[0] - ends[1]) / 2e-6 == pytest.approx(score[a], rel=1e-4, abs=1e-3)


def test_the_information_is_what_second_differences_of_the_likelihood_say():
    """Of one state: θ (5), two variances, two odds. No score is used here."""
    plant = Plant([[[0.3]], [[-1.5]]], [[[1.0]], [[0.6]]], 0.112, np.array([[2e-3]]))
    log, theta, cells = likelihood(plant, 400, 4, seed=1)
    found = information_of(log, theta, cells)

    def value(z):
        odds = log.jumps.matrix * np.array([[1.0, np.exp(z[7])], [np.exp(z[8]), 1.0]])
        odds /= odds.sum(axis=1, keepdims=True)
        S = log.S * (1.0 + z[5:7])[:, None, None]
        moved = replace(log, S=S, jumps=Jumps(odds, H, rates=False))
        return moved.posterior(z[:5], cells).value

    z = np.concatenate((theta, np.zeros(4)))
    unit = np.concatenate((1e-2 / np.sqrt(np.diagonal(found.known)), np.full(4, 1e-3)))
    J, E = np.empty((9, 9)), np.diag(unit)
    for a, b in itertools.product(range(9), repeat=2):
        ends = [value(z + p * E[a] + q * E[b]) * p * q for p in (1, -1) for q in (1, -1)]
        J[a, b] = -sum(ends) / (4.0 * unit[a] * unit[b])
    fixed = J[:5, :5]
    left = fixed - J[:5, 5:] @ np.linalg.solve(J[5:, 5:], J[5:, :5])
    scale = np.sqrt(np.diagonal(found.known))
    for ours, theirs in ((found.fixed, fixed), (found.left, left)):
        theirs = clipped(theirs, found.known)  # no more than known modes would tell
        assert np.abs((ours - theirs) / scale / scale[:, None]).max() < 2e-3
    assert 0.05 < eigh(left, found.known, eigvals_only=True)[0] < 0.9


def test_uneven_rows_have_the_sum_over_all_paths_and_rates_are_scored_by_its_slope():
    """Of e^{Λτ} by SciPy, with the noise of a period as long as it is."""
    A = [[[-1.0, 0.5], [0.0, -2.0]], [[-0.2, 1.0], [-3.0, -0.1]]]
    plant = Plant(A, [[[1.0], [0.3]], [[0.5], [1.0]]], 0.112, 1e-2 * np.eye(2))
    rng, rates = np.random.default_rng(2), np.array([[-2.0, 2.0], [3.0, -3.0]])
    t = np.cumsum(H * rng.uniform(0.5, 1.5, 13))
    y, u = plant.log(t, rng.standard_normal((13, 1)), rng, (np.arange(13) // 5) % 2)
    part = Part(t, y, u, np.zeros(13, np.int64))
    record = Recording((part,), H, False, ("x",) * 2, ("u",), ("0", "1"), False)
    layout, S = Layout(2, 2, 1, False), np.array([plant.covariance(i, H) for i in (0, 1)])
    nodes = nodes_for((part,), plant.A)
    sampling = sampling_of(record, nodes)
    periods = Periods.of(sampling, (part,), (0.1, 0.12), None, constant=False)
    jumps = Jumps(rates, H, rates=True)
    log = HiddenLog(record, layout, False, (1e-8, 0.2), nodes, periods, S, jumps)
    theta = layout.join(plant.A, plant.B, plant.D)
    (k,), length = periods.usable, np.diff(t)
    density = np.empty((k.size, 2))
    for row, place in enumerate(k):
        for i in (0, 1):
            Phi, moved = plant.period(t, u, np.full(13, i), place)
            scaled = (y[place + 1] - Phi @ y[place] - moved) / np.sqrt(length[place] / H)
            density[row, i] = multivariate_normal(np.zeros(2), S[i]).logpdf(scaled)

    def value(rates):
        start, total = np.array([0.5, 0.5]) @ expm(rates * (t[k[0]] - t[0])), 0.0
        steps = [expm(rates * length[place]) for place in k[:-1]]
        for path in itertools.product((0, 1), repeat=k.size):
            chance = start[path[0]] * np.prod(
                [P[i, j] for P, i, j in zip(steps, path, path[1:], strict=False)]
            )
            total += chance * np.exp(density[np.arange(k.size), path].sum())
        return np.log(total)

    found = log.posterior(theta, log.cells(theta))
    assert found.value == pytest.approx(value(rates), abs=1e-8)
    slope = jumps.slope(found.counts)
    for i, j in ((0, 1), (1, 0)):
        step = 1e-4 * rates[i, j] * (np.eye(2)[[i]].T @ (np.eye(2)[[j]] - np.eye(2)[[i]]))
        ends = value(rates + step) - value(rates - step)
        assert ends / 2e-4 == pytest.approx(slope[i, j], rel=1e-5, abs=1e-7)
