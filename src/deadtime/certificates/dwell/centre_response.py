"""The frequency response of the centre: v and ξ that a signal w on |z| = ρ gives rise to.

    z x = E₀ y + w_x,    (z w, u) = row₀ ξ + w_u,    u_{k−j} = z^{−j} u:

a small system at each z, W m² operations to set up, so that no matrix of the loop's order is
ever inverted.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.certificates.dwell.centre import CentreFloats


class ResponseForms(NamedTuple):
    """V (f, v, w) = v(z); Q (f, w, w) = Ξ* Q₀ Ξ with Q₀ = diag(I, h I), Ξ = ξ(z); and rest
    (f, w, w) = |rest Ξ|², what is left of the rows."""

    V: np.ndarray
    Q: np.ndarray
    rest: np.ndarray


def frequencies(count: int, held: int, step: float, delay: float) -> np.ndarray:
    """Angles to start from: dense where the loop lives, 0 and π included."""
    low = min(1e-3 / delay * step, 1e-2)
    return np.unique(np.concatenate([[0.0], np.geomspace(low, np.pi, count)]))


def fine_frequencies(held: int, step: float, delay: float) -> np.ndarray:
    """Angles to look for violations at: eight to a wave of z^{−W}, and more where slow."""
    low = min(1e-4 / delay * step, 1e-3)
    return np.unique(
        np.concatenate([np.linspace(0.0, np.pi, 8 * held + 65), np.geomspace(low, np.pi, 2000)])
    )


def response(model: CentreFloats, angles: np.ndarray, rho: float) -> ResponseForms:
    """V and Q at z = ρ e^{iω}, ω the angles."""
    chunk = max(1, int(4e7 / (16 * model.setting.past)))
    parts = [
        _response(model, rho * np.exp(1j * angles[at : at + chunk]))
        for at in range(0, len(angles), chunk)
    ]
    return ResponseForms(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _response(model: CentreFloats, z: np.ndarray) -> ResponseForms:
    setting, centre, channels = model.setting, model.centre, model.channels
    n, m, W, q = setting.states, setting.inputs, setting.past, setting.memory
    w, s = channels.D.shape[1], n + q
    powers = z[:, None] ** -np.arange(1.0, W + 1.0)
    late = np.concatenate((np.ones((len(z), 1)), powers), axis=1)
    G = centre.row[:, s:].reshape(q + m, W, m)
    system = np.zeros((len(z), s + m, s + m), complex)
    system[:, :s, :s] = z[:, None, None] * np.eye(s)
    system[:, :n, :n] -= centre.E[:, :n]
    for place, (lag, j) in enumerate(setting.family.reads, n):
        system[:, :n, s + j] -= centre.E[:, place] * late[:, lag, None]
    system[:, n:, :s] -= centre.row[:, :s]
    g = powers @ G.transpose(1, 0, 2).reshape(W, (q + m) * m)
    system[:, n:, s:] = np.eye(q + m, m, -q) - g.reshape(len(z), q + m, m)
    inputs = np.eye(s + m)[:, :w]
    both = np.linalg.solve(system, np.broadcast_to(inputs, (len(z), *inputs.shape)))
    X, U = both[:, :s], both[:, s:]
    C = np.concatenate((channels.C, model.rest))
    taps = C[:, s:].reshape(len(C), W, m).transpose(1, 0, 2).reshape(W, -1)
    from_inputs = (powers @ taps).reshape(len(z), len(C), m)
    seen = C[:, :s] @ X + from_inputs @ U
    V, left = seen[:, : len(channels.C)] + channels.D, seen[:, len(channels.C) :]
    Q = _square(X) + setting.step * (np.abs(powers) ** 2).sum(axis=1)[:, None, None] * _square(U)
    return ResponseForms(V, Q, _square(left))


def _square(X: np.ndarray) -> np.ndarray:
    return X.conj().transpose(0, 2, 1) @ X
