"""The centre around which the loop is written, in floats, and its frequency response.

E₀ is the mean of the modes' steps and row₀ of the table's rows, so that Δ is small. R are
leading singular directions of the rows' differences; with all of them T_c R is exact, with a
few the search is quick. Ψ are dominant left eigenvectors of each mode's loop and form a filter:
where Ψ_i M_i = Λ_i Ψ_i and M_i is the loop with w = Δ_i v,

    Ψ_i ξ⁺ = Λ_i Ψ_i ξ + Ψ_i B (w − w_i),

w_i the value of w in mode i, a function of v and w. So a Lyapunov function that weighs Ψξ by mode
and age depends on (v, w) alone.

The response of v and ξ to a signal w on |z| = ρ follows from

    z x = E₀ y + w_x,    (z w, u) = row₀ ξ + w_u,    u_{k−j} = z^{−j} u:

a small system at each z, W m² operations to set up, so that no matrix of the loop's order is
ever inverted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from deadtime.certificates.proof.evidence import Centre, Channels, Setting

DENSE = 1500  # order up to which all eigenvectors are computed


@dataclass(frozen=True, eq=False)
class CentreFloats:
    """A centre with its matrices in floats, for the search.

    Attributes
    ----------
    eigenvectors : int
        The number requested per mode.
    M : (d, d), B : (d, w)
        ξ⁺ = M ξ + B w.
    rest : (q, d)
        The part of the rows outside R: |(row_c − row₀ − T_c R) ξ| ≤ |rest ξ| for every c.
    """

    setting: Setting
    centre: Centre
    channels: Channels
    eigenvectors: int
    M: np.ndarray
    B: np.ndarray
    rest: np.ndarray

    @classmethod
    def of(cls, setting: Setting, eigenvectors: int, rank: int) -> CentreFloats:
        """The centre with this many left eigenvectors per mode and directions of the rows."""
        family: Any = setting.family
        full = [family.sample(family.orders(i, i)[0], 0.0, 0.5) for i in range(setting.modes)]
        E, rows = np.mean(full, axis=0), setting.rows
        row = rows.mean(axis=0) if setting.rows_differ else rows[0].copy()
        R, T, rest = _directions(setting, rows - row, rank)
        d = setting.order
        bare = Centre(E, row, R, T, np.zeros((0, d)), np.zeros((0, 0)))
        # Without Ψ first: F needs B of the bare centre.
        model = cls._lay_out(setting, bare, eigenvectors, rest)
        if not eigenvectors:
            return model
        blocks = [
            _dominant(loop_matrix(setting, full[i], row), eigenvectors)
            for i, row in _oldest(setting)
        ]
        Psi = np.concatenate([block for block, _ in blocks])
        channels = Channels.of(setting, Centre(E, row, R, T, Psi, np.zeros((len(Psi), 0))))
        F = _filter(setting, model, channels, blocks, full)
        return cls._lay_out(setting, Centre(E, row, R, T, Psi, F), eigenvectors, rest)

    @classmethod
    def _lay_out(
        cls, setting: Setting, centre: Centre, eigenvectors: int, rest: np.ndarray
    ) -> CentreFloats:
        channels = Channels.of(setting, centre)
        whole = channels.shift(setting.inputs)
        d = setting.order
        if not centre.F.size:
            centre = replace(centre, F=np.zeros((0, sum(channels.D.shape))))
        return cls(setting, centre, channels, eigenvectors, whole[:, :d], whole[:, d:], rest)

    def delta(self, E: np.ndarray, row: int) -> np.ndarray:
        """Δ (w, v) of plant rows and a table's row, in floats."""
        v, w = self.channels.D.shape
        n, y = self.centre.E.shape
        result = np.zeros((w, v))
        result[:n, :y] = E - self.centre.E
        if self.setting.rows_differ:
            result[n:, : y + len(self.centre.R)] = self.centre.T[row]
        return result


def _oldest(setting: Setting) -> list[tuple[int, int]]:
    """Every mode with its row at its last age; with lost samples, the row of a lost one, too."""
    graph = setting.transitions
    pairs = [(i, graph.row(i, clock.last)) for i, clock in enumerate(graph.clocks)]
    if setting.signals.lost_samples:
        pairs += [(i, graph.measured + row) for i, row in pairs]
    return pairs


def loop_matrix(setting: Setting, E: np.ndarray, row: int) -> np.ndarray:
    """M of ξ⁺ = M ξ in a period of plant rows E under one row of the table."""
    seen, rest = setting.period(setting.rows[row])
    return np.concatenate((E @ seen, rest))


def _directions(
    setting: Setting, differences: np.ndarray, rank: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """R (r, d), T (rows, m, y + r) and `rest` (q, d) with differences ≈ T (y, R).

    The entries of ξ that are in y come through y. For the others R contains the rows at the last
    ages exactly, since the filter of Ψ needs them, and `rank` leading singular directions.
    """
    count, m, d = differences.shape
    n, reads = setting.states, setting.family.reads
    y = n + len(reads)
    if not setting.rows_differ:
        return np.zeros((0, d)), np.zeros((count, m, y)), np.zeros((0, d))
    others, T = differences.copy(), np.zeros((count, m, y))
    T[:, :, :n], others[:, :, :n] = differences[:, :, :n], 0.0
    for place, (lag, j) in enumerate(reads, n):
        if lag:
            there = setting.input_at(lag, j)
            T[:, :, place], others[:, :, there] = differences[:, :, there], 0.0
    lasts = [row for _, row in _oldest(setting)]
    size = max(float(np.abs(differences).max()), 1e-300) * count
    first = _singular(others[lasts].reshape(-1, d), size)[1]
    left = others.reshape(count * m, d)
    left = left - left @ first.T @ first
    values, right = _singular(left, size)
    keep = min(rank, len(values))
    R = np.linalg.qr(np.concatenate((first, right[:keep])).T)[0].T
    T = np.concatenate((T, (others.reshape(count * m, d) @ R.T).reshape(count, m, len(R))), axis=2)
    return R, T, values[keep:, None] * right[keep:]


def _singular(rows: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Singular values above the round-off of entries of this size, and right singular vectors."""
    _, values, right = np.linalg.svd(rows, full_matrices=False)
    there = values > 4e-15 * size
    return values[there], right[there]


def _dominant(M: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(Ψ, Λ) with Ψ M = Λ Ψ for the `count` largest eigenvalues; complex pairs stay together."""
    from scipy.linalg import block_diag, eig

    pair: Any = eig(M.T)
    values, vectors = pair
    chosen, blocks = [], []
    for k in np.argsort(-np.abs(values), kind="stable"):
        if len(chosen) >= count:
            break
        value, y = values[k], vectors[:, k] / np.abs(vectors[:, k]).max()
        if value.imag < 0.0:  # its conjugate brings both real rows
            continue
        if value.imag == 0.0:
            chosen.append(y.real)
            blocks.append(np.array([[value.real]]))
        else:
            chosen += [y.real, y.imag]
            a, b = value.real, value.imag
            blocks.append(np.array([[a, -b], [b, a]]))
    return np.array(chosen).reshape(len(chosen), len(M)), np.asarray(block_diag(*blocks))


def _filter(
    setting: Setting,
    model: CentreFloats,
    channels: Channels,
    blocks: list[tuple[np.ndarray, np.ndarray]],
    full: list[np.ndarray],
) -> np.ndarray:
    v, w = channels.D.shape
    n, y = model.centre.E.shape
    r, s = len(model.centre.R), v - y - len(model.centre.R)
    #        y   r   ψ (mode 0, mode 1, …)   w_x  w_u
    # F  = [         Λ_0                   |          ]
    #      [                   Λ_1         |          ]  + Ψ_i B (w − w_i)
    F = np.zeros((s, v + w))
    at = 0
    # w_i(v, w): w_u = T_i (y, r), y_i = y − D w + D w_u, then w_x = (E_i − E₀) y_i.
    D = channels.D[:y]
    for (i, row), (Psi, Lambda) in zip(_oldest(setting), blocks, strict=True):
        rows = slice(at, at + len(Psi))
        would = np.zeros((w, v + w))
        difference = full[i] - model.centre.E
        would[:n, :y] = difference
        if setting.rows_differ:
            T = model.centre.T[row]
            would[n:, : y + r] = T
            would[:n, : y + r] += difference @ D[:, n:] @ T
            would[:n, v:] = -difference @ D
        PsiB = Psi @ model.B
        # ψ comes after y and r in v, the blocks of the modes one after the other.
        F[rows, y + r + at : y + r + at + len(Psi)] = Lambda
        F[rows, v:] += PsiB
        F[rows] -= PsiB @ would
        at += len(Psi)
    return F


class ResponseForms(NamedTuple):
    """The response at f frequencies.

    V (f, v, w) = v(z); Q (f, w, w) = Ξ* Q₀ Ξ with Q₀ = diag(I, h I), Ξ = ξ(z); and rest
    (f, w, w) = |rest Ξ|², by the part of the rows outside R.
    """

    V: np.ndarray
    Q: np.ndarray
    rest: np.ndarray


def frequencies(count: int, step: float, delay: float) -> np.ndarray:
    """Initial angles: dense at low frequencies, 0 and π included."""
    low = min(1e-3 / delay * step, 1e-2)
    return np.unique(np.concatenate([[0.0], np.geomspace(low, np.pi, count)]))


def fine_frequencies(held: int, step: float, delay: float) -> np.ndarray:
    """Angles to check for violations: eight per period of z^{−W}, and more at low frequencies."""
    low = min(1e-4 / delay * step, 1e-3)
    return np.unique(
        np.concatenate([np.linspace(0.0, np.pi, 8 * held + 65), np.geomspace(low, np.pi, 2000)])
    )


def response(model: CentreFloats, angles: np.ndarray, rho: float) -> ResponseForms:
    """The response at z = ρ e^{iω}, ω the angles."""
    # `powers` has an entry per angle and past input: at most some 40 MB at a time.
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
    # The unknowns are (x, w, u) at a sample: every past input is u times a power of z.
    system = np.zeros((len(z), s + m, s + m), complex)
    system[:, :s, :s] = z[:, None, None] * np.eye(s)
    system[:, :n, :n] -= centre.E[:, :n]
    for place, (lag, j) in enumerate(setting.family.reads, n):
        system[:, :n, s + j] -= centre.E[:, place] * late[:, lag, None]
    system[:, n:, :s] -= centre.row[:, :s]
    g = powers @ G.transpose(1, 0, 2).reshape(W, (q + m) * m)
    # The law's outputs are (w⁺, u): only the last m rows have u on the left.
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
