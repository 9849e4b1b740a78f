"""Beliefs by summing over every path of modes: no filter, no recursion, no chain of ages.

Model of the second method: SciPy's exponentials over stretches cut at each input's own fraction of
a period, SciPy's normal densities, probabilities of paths from rates or from survival functions.
"""

import itertools

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.stats import multivariate_normal

import plants


def ahead(plant, step, mode, x, inputs, k, start=0.0, stop=None):
    """x_{k+1} with a mode held over period k; `inputs[s]` is u_s, negative s by a dict.

    Or over a part of the period, from `start` to `stop`.
    """
    stop = step if stop is None else stop
    counts = np.ceil(np.round(plant.delays[mode] / step, 9)).astype(int)
    phases = plant.delays[mode] - (counts - 1) * step
    inside = {round(phase, 12) for phase in phases if start + 1e-10 < phase < stop - 1e-10}
    for end in sorted(inside | {stop}):
        sample = k - counts + (start >= phases - 1e-10)
        u = np.array([inputs[s][j] for j, s in enumerate(sample)])
        Phi, Gamma = plants.held(plant.A[mode], plant.B[mode], end - start)
        x, start = Phi @ x + Gamma @ u, end
    return x


def covariance(plant, step, i, j, W, std):
    """Of x_{k+1} about what mode i makes of x_k as measured, where the period ends in j.

    One W is taken to act as in i all along; of one per mode each acts in its own.
    """
    R = np.diag(np.broadcast_to(std, plant.states) ** 2)
    moved = sum(expm(A * step) @ R @ expm(A * step).T for A in plant.A) / plant.modes
    if W.ndim == 2 or i == j:
        own = W if W.ndim == 2 else W[i]
        return plants.gramian_by_quadrature(plant.A[i], own, step) + R + moved
    return switched(plant, step, i, j, W) + R + moved


def switched(plant, step, i, j, W):
    """The mean of Cov x after a period with a change from i to j at an instant spread evenly.

    By differential equations: `still` is Cov x if no change was yet, `gone` is E[Cov x 1{in j}],
    to which still dt/h is added in every dt, and t/h of the noise of j.
    """
    n = plant.states
    A, B = plant.A[i], plant.A[j]

    def rate(t, flat):
        still, gone = flat.reshape(2, n, n)
        held = A @ still + still @ A.T + W[i]
        own = B @ gone + gone @ B.T + t / step * W[j] + still / step
        return np.concatenate((held.ravel(), own.ravel()))

    options = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-15}
    return solve_ivp(rate, (0.0, step), np.zeros(2 * n * n), **options).y[n * n :, -1].reshape(n, n)


def densities(plant, step, states, inputs, W, std, within):
    """log p of every period for every pair of modes, (periods, modes, modes)."""
    modes, periods = plant.modes, len(states) - 1
    result = np.empty((periods, modes, modes))
    pairs = [(i, j if within else i) for i, j in np.ndindex(modes, modes)]
    noise = {pair: covariance(plant, step, *pair, W, std) for pair in set(pairs)}
    for k in range(periods):
        means = [ahead(plant, step, i, states[k], inputs, k) for i in range(modes)]
        for i, j in np.ndindex(modes, modes):
            d, S = means[j] - means[i], noise[i, j if within else i]
            mean = means[i] + 0.5 * d if within else means[i]
            if within:
                S = S + np.outer(d, d) / 12.0
                S = S + bend(plant, step, i, j, states[k], inputs, k, mean)
            result[k, i, j] = multivariate_normal(mean, S).logpdf(states[k + 1])
    return result


def bend(plant, step, i, j, x, inputs, k, middle):
    """Mean squares of what a parabola through x_{k+1} of switches at 0, h/2, h is off its chord."""
    half = ahead(plant, step, i, x, inputs, k, 0.0, 0.5 * step)
    half = ahead(plant, step, j, half, inputs, k, 0.5 * step, step)
    nodes, weights = np.polynomial.legendre.leggauss(3)  # exact up to degree 5
    off = np.outer(1.0 - nodes**2, half - middle)
    return np.diag(0.5 * weights @ off**2) if i != j else np.zeros((x.size, x.size))


def beliefs(density, log_prior):
    """P(mode at the last sample) from the probability of every path (modes)^(samples)."""
    periods, modes, _ = density.shape
    rest = np.array(list(itertools.product(range(modes), repeat=periods)), np.int8)
    along = np.empty((modes, len(rest)))
    for first in range(modes):
        paths = np.insert(rest, 0, first, axis=1)
        along[first] = log_prior(paths)
        for k in range(periods):
            along[first] += density[k, paths[:, k], paths[:, k + 1]]
    weight = np.exp(along - along.max()).sum(axis=0)
    return np.bincount(rest[:, -1], weight, modes) / weight.sum()


def markov_prior(rates, step):
    """log P of paths under a Markov process, its first mode drawn evenly."""
    generator = rates - np.diag(rates.sum(axis=1))
    log = np.log(expm(step * generator))
    return lambda paths: sum(
        (log[paths[:, k - 1], paths[:, k]] for k in range(1, paths.shape[1])),
        start=np.full(len(paths), -np.log(len(rates))),
    )


def semi_markov_prior(sojourns, transition, step):
    """log P of paths, sojourn by sojourn; the first begins at sample 0, the last goes on."""
    outlast = np.array([sojourn.sf(np.arange(16) * step) for sojourn in sojourns])

    def one(path):
        total, begun = -np.log(len(sojourns)), 0
        for k in range(1, len(path)):
            if path[k] != path[k - 1]:
                i, length = path[k - 1], k - begun
                ends = outlast[i, length - 1] - outlast[i, length]
                total += np.log(ends) + np.log(transition[i][path[k]])
                begun = k
        last = len(path) - 1 - begun
        return total + np.log(outlast[path[-1], last])

    def prior(paths):
        with np.errstate(divide="ignore"):
            return np.array([one(path) for path in paths])

    return prior
