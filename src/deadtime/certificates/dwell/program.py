"""The small semidefinite program behind a certificate: Π, S and a margin t.

    maximise t
    −Y(z)* Π Y(z) ⪰ t (Ξ* Q₀ Ξ + I)            at chosen frequencies, Y = [V; I],
    [I; Δ]ᵀ (Π + S_{i,a} − Fᵀ S_{j,b} F/ρ²) [I; Δ] ⪰ t I   for sampled steps,
    −I ⪯ Π ⪯ I.

For an ellipsoid of plants the second is a form in (v, q), w_x = Δ v + q, less
λ (yᵀ X y − qᵀ W⁻¹ q), with a λ ≥ 0 for each sample (`proof.sway`).

Where the rows have a part outside R, w_u = T_c r + δ with |δ| ≤ |rest ξ|: κ |rest Ξ|² is added
on the right of the first, and κ |δ|² on the left of the second, which then holds for all (v, δ).
The unit of w is the largest Δ, that of v its peak response. The solver's answer is a proposal: the
frequencies between the chosen ones are checked next, and the proof does not depend on any of this.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from deadtime.certificates.dwell.centre import CentreFloats, ResponseForms
from deadtime.certificates.dwell.solvers import STOPPED, maximise, squares
from deadtime.certificates.proof.sway import Sway
from deadtime.certificates.proof.transitions import Transition, interpolation
from deadtime.numerics.lmi import pack, packing, unpack

LEAST_UNIT = 1e-6  # of v, relative to the largest


@dataclass(frozen=True, eq=False)
class Sample:
    """A step at one point of its parameters: its place in the graph, Δ (w, v), and the ellipsoid.

    Attributes
    ----------
    sway : Sway or None
        W and X there; None without an ellipsoid.
    """

    transition: Transition
    delta: np.ndarray
    sway: Sway | None = None

    @property
    def swayed(self) -> float:
        """The largest |w_x| by the ellipsoid, for a v of 1."""
        if self.sway is None:
            return 0.0
        return float(np.sqrt(np.linalg.norm(self.sway.W, 2) * np.linalg.norm(self.sway.X, 2)))


@dataclass(frozen=True, eq=False)
class Units:
    """Units of v and w, and of Ξ* Q₀ Ξ."""

    v: np.ndarray
    w: np.ndarray
    q: float

    @classmethod
    def of(cls, model: CentreFloats, found: ResponseForms, samples: list[Sample]) -> Units:
        """Units in which the entries of the program are about 1."""
        n = model.setting.states
        deltas = np.stack([sample.delta for sample in samples])
        w = np.empty(deltas.shape[1])
        for part in (slice(0, n), slice(n, None)):
            sizes = np.linalg.norm(deltas[:, part], axis=(1, 2))
            sizes = sizes + ([sample.swayed for sample in samples] if part.stop else 0.0)
            w[part] = max(sizes.max() if w[part].size else 0.0, 1e-9)
        v = np.sqrt((np.abs(found.V * w) ** 2).sum(axis=2)).max(axis=0)
        v = np.maximum(v, max(LEAST_UNIT * v.max(), 1e-300))  # an input that no w drives has v = 0
        q = np.linalg.norm(found.Q * w * w[:, None], axis=(1, 2)).max()
        return cls(v, w, max(float(q), 1e-300))

    def of_signals(self, found: ResponseForms) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(Y, weight, rest) of the frequencies, in these units; δ in the last one of w."""
        count, _, w = found.V.shape
        eye = np.broadcast_to(np.eye(w), (count, w, w))
        Y = np.concatenate((found.V * self.w / self.v[:, None], eye), axis=1)
        scale = self.w * self.w[:, None]
        return Y, found.Q * scale / self.q + np.eye(w), found.rest * scale / self.w[-1] ** 2


@dataclass(frozen=True, eq=False)
class Solution:
    """A proposal of the solver, in the units: the margin, κ, Π, S, and its status."""

    margin: float
    kappa: float
    Pi: np.ndarray
    S: np.ndarray
    status: str

    @property
    def rough(self) -> bool:
        """Whether the solver was stopped once the margin was certainly positive."""
        return self.status == STOPPED


def solve(
    model: CentreFloats,
    found: ResponseForms,
    samples: list[Sample],
    units: Units,
    knots: tuple[int, ...],
    rho: float,
    *,
    roughly: bool = False,
) -> Solution | None:
    """Solve the program; None if the solver has no answer.

    `roughly`: stop once the sign of the margin is certain.
    """
    from scipy.sparse import csr_matrix, vstack

    v, w = len(units.v), len(units.w)
    s = len(model.centre.Psi)
    pi_size, s_size = (v + w) * (v + w + 1) // 2, s * (s + 1) // 2
    places = model.setting.transitions.places
    of_S = places * len(knots) * s_size
    swayed = [k for k, sample in enumerate(samples) if sample.sway is not None]
    unknowns = pi_size + of_S + len(swayed) + 2
    blocks, cones = _at_frequencies(units.of_signals(found), pi_size, unknowns)
    blocks = [csr_matrix(block) for block in blocks]
    # The unknowns: | Π | S (place 0, knot 0) | S (0, 1) | … | λ of each sample with sway | κ | t |
    weights = {k: pi_size + of_S + at for at, k in enumerate(swayed)}
    for k, sample in enumerate(samples):  # sparse: each has the S of two nodes only
        block = _at_step(model, sample, units, knots, rho, unknowns)
        if sample.sway is not None:  # λ (qᵀ W⁻¹ q − yᵀ X y), q last in (v, q)
            X, W = _in_units(sample.sway, units)
            scale, unit, at = float(np.trace(X)), _reach(sample.sway, units), weights[k]
            block[at, : len(X), : len(X)] = -X / scale
            block[at, -len(W) :, -len(W) :] = np.linalg.inv(W) * (unit**2 / scale)
        blocks.append(csr_matrix(pack(block)))
        cones.append(block.shape[1])
    bounds = np.zeros((unknowns, v + w, v + w))
    bounds[:pi_size] = squares(np.eye(v + w))
    bound = pack(bounds)
    nonnegative = np.eye(unknowns)[[*weights.values(), -2]]
    ends = csr_matrix(np.concatenate([nonnegative, bound, -bound]))
    A: Any = vstack([*blocks, ends], format="csc")
    rows, columns, _ = packing(v + w)
    eye = (rows == columns).astype(float)
    b = np.concatenate([np.zeros(A.shape[0] - 2 * len(eye)), eye, eye])
    answer = maximise(-A, b, [*cones, *[1] * len(nonnegative), v + w, v + w], roughly=roughly)
    if answer is None:
        return None
    x, status = answer
    Pi = unpack(x[:pi_size], v + w)
    parts = x[pi_size : pi_size + of_S].reshape(places, len(knots), s_size)
    S = np.array([[unpack(part, s) for part in mode] for mode in parts])
    return Solution(float(x[-1]), float(x[-2]), Pi, S.reshape(*parts.shape[:2], s, s), status)


def _at_frequencies(
    signals: tuple[np.ndarray, np.ndarray, np.ndarray], pi_size: int, unknowns: int
) -> tuple[list[np.ndarray], list[int]]:
    """−Y* Π Y − κ rest − t weight ⪰ 0 as real matrices of twice the order, one per frequency."""
    blocks, w = [], signals[0].shape[2]
    for Y, weight, rest in zip(*signals, strict=True):
        M = np.zeros((unknowns, 2 * w, 2 * w))
        both: Any = np.concatenate((-squares(Y), -rest[None], -weight[None]))
        # A Hermitian matrix is definite if this real one of twice the order is.
        real = np.block([[both.real, -both.imag], [both.imag, both.real]])
        M[:pi_size], M[-2:] = real[:-2], real[-2:]
        blocks.append(pack(M))
    return blocks, [2 * w] * len(blocks)


def _at_step(
    model: CentreFloats,
    sample: Sample,
    units: Units,
    knots: tuple[int, ...],
    rho: float,
    unknowns: int,
) -> np.ndarray:
    """Coefficients (unknowns, k, k) of the small inequality of one step, k = v or (v, δ)."""
    v, w = len(units.v), len(units.w)
    s, n = len(model.centre.Psi), model.setting.states
    extra = w - n if len(model.rest) else 0
    free = extra if sample.sway is None else extra + n
    pi_size, s_size = (v + w) * (v + w + 1) // 2, s * (s + 1) // 2
    # (v, w) = T (v, δ, q):   v   [ I  0  0 ]
    #                         w_x [ Δ  0  I ]
    #                         w_u [ Δ  I  0 ]
    T = np.eye(v + w, v + free)
    T[v:, :v] = sample.delta * units.v / units.w[:, None]
    T[v:, v:] = np.eye(w)[:, [*range(n, n + extra), *range(free - extra)]]
    if sample.sway is not None:
        T[:, v + extra :] *= _reach(sample.sway, units)
    M = np.zeros((unknowns, v + free, v + free))
    M[:pi_size] = squares(T)
    M[-2, v : v + extra, v : v + extra] = np.eye(extra)
    M[-1, :v, :v] = -np.eye(v)
    if s:
        scale = np.concatenate((units.v, units.w))
        here = np.eye(v, v + free)[v - s :]
        there = model.centre.F * scale / units.v[v - s :, None] @ T / rho
        step = sample.transition
        place = model.setting.transitions.place
        for node, age, left, sign in (
            (place(step.mode, step.lost), step.age, here, 1.0),
            (place(step.after, step.next_lost), step.next_age, there, -1.0),
        ):
            products = squares(left)
            for knot, weight in interpolation(knots, age):
                at = pi_size + (node * len(knots) + knot) * s_size
                M[at : at + s_size] += sign * float(weight) * products
    return M


def _reach(sway: Sway, units: Units) -> float:
    """The unit of q: its largest size for a v of 1, so that a tiny ellipsoid is scaled up, too."""
    X, W = _in_units(sway, units)
    return float(np.sqrt(np.trace(X) * np.linalg.norm(W, 2)))


def _in_units(sway: Sway, units: Units) -> tuple[np.ndarray, np.ndarray]:
    n, k = len(sway.W), len(sway.X)
    return (sway.X * units.v[:k] * units.v[:k, None], sway.W / units.w[:n] / units.w[:n, None])
