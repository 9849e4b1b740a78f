"""Approximate characteristic roots: the ideal loop's generator on a Chebyshev grid.

The state of the loop is x(t) and u on [t − T, t], T the longest delay of plant and law. Shifting
it in time is a semigroup with the generator

    (x, u) ↦ (A x + Σ_j b_j u_j(−D_j), du/dθ)    where    u(0) = F x + ∫ w(τ) u(−τ) dτ.

A polynomial through u at Chebyshev points turns it into a matrix whose eigenvalues tend to the
roots, faster than any power of the degree since eigenfunctions are exponentials: for a degree of
a few more than |s| T/2. The others are of no meaning, so all are polished and counted
(`deadtime.spectrum.characteristic`). One polynomial serves unequal delays, too: the smooth
functions that matter do not break at any −D_j, nor where a window of the law ends.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex, Float

from deadtime.spectrum.ideal import IdealLoop
from deadtime.spectrum.input_windows import weights

_CENTRE = 1.618  # of the plant's rate: no root is there but by accident


def approximate_roots(loop: IdealLoop, degree: int) -> Complex[np.ndarray, " order"]:
    """Eigenvalues of the generator on polynomials of a degree, at most n + m·degree of them.

    Those of the plant's size are wanted to its digits, and the generator has entries of degree²/T,
    which may be any power of ten larger. So its inverse about a point σ of the plant's size is
    taken, of which they are the large eigenvalues 1/(s − σ).
    """
    G, E = generator(loop, degree)
    centre = _CENTRE * loop.rate
    inverse = np.linalg.eigvals(np.linalg.solve(G - centre * np.diag(E), np.diag(E)))
    return centre + 1.0 / inverse[inverse != 0.0].astype(complex)


def generator(
    loop: IdealLoop, degree: int
) -> tuple[Float[np.ndarray, "order order"], Float[np.ndarray, " order"]]:
    """G and the diagonal of E: the generator is E⁻¹G, of (x, u(θ_1), …, u(θ_degree)), u(0) gone."""
    n, m = loop.B.shape
    longest = loop.longest
    nodes, derivative, barycentric = _chebyshev(degree)
    tau, taps = weights(loop.windows, loop.near + 2.0 * degree / longest)
    delays, effects = zip(*loop.pipes, strict=True)
    at = _interpolation(nodes, barycentric, 1.0 - 2.0 * np.append(tau, delays) / longest)
    window = np.tensordot(taps, at[: tau.size], ([0], [0])).transpose(2, 0, 1)  # by node (m, m)
    now = np.zeros((m, n + m * degree))
    now[:, :n] = loop.F
    now[:, n:] = window[1:].transpose(1, 0, 2).reshape(m, m * degree)
    now = np.linalg.solve(np.eye(m) - window[0], now)
    G = np.zeros((n + m * degree, n + m * degree))
    for row, B in zip(at[tau.size :], effects, strict=True):
        G[:n] += row[0] * (B @ now)
        G[:n, n:] += np.kron(row[1:], B)
    G[:n, :n] += loop.A
    slope = derivative[1:]
    G[n:] = np.kron(slope[:, :1], now)
    G[n:, n:] += np.kron(slope[:, 1:], np.eye(m))
    return G, np.repeat((1.0, 0.5 * longest), (n, m * degree))


def _chebyshev(degree: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points cos(jπ/degree), the matrix that differentiates there, barycentric weights."""
    angle = np.arange(degree + 1) * (np.pi / degree)
    nodes = np.cos(angle)
    barycentric = (-1.0) ** np.arange(degree + 1)
    barycentric[[0, -1]] /= 2.0
    # x_i − x_j = −2 sin((a_i + a_j)/2) sin((a_i − a_j)/2) keeps its digits where points crowd.
    half = angle / 2.0
    apart = -2.0 * np.sin(half[:, None] + half) * np.sin(half[:, None] - half)
    np.fill_diagonal(apart, 1.0)
    derivative = barycentric / barycentric[:, None] / apart
    np.fill_diagonal(derivative, 0.0)
    np.fill_diagonal(derivative, -derivative.sum(axis=1))
    return nodes, derivative, barycentric


def _interpolation(nodes: np.ndarray, barycentric: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Rows that evaluate the polynomial through values at the nodes."""
    apart = at[:, None] - nodes
    hit = np.abs(apart) < 1e-15
    ratio = barycentric / np.where(hit, 1.0, apart)
    rows = ratio / ratio.sum(axis=1, keepdims=True)
    return np.where(hit.any(axis=1, keepdims=True), hit, rows).astype(float)
