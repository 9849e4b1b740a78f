"""Effect of the z of a `PlantSet`, [A B] + Σ z_i directions_i, |z| ≤ 1, on the rows E of steps.

On a cell E(p, z) = E(p, 0) + Σ z_i L_i, L_i the derivative by z_i somewhere on the cell and in the
ball; over both it is enclosed by way of the entries θ of A and B,

    L_i = Σ_θ (∂E/∂θ) (directions_i)_θ,
    ∂E/∂θ = Σ_k (pieces after) L(𝒜_k τ_k, ∂𝒜_k/∂θ τ_k) (before),

with every entry in its range Â ± radius. So δE = Σ z_i middle(L_i) + R, and entry by entry
|R| ≤ r = (Σ_i radius(L_i)²)^½, by Cauchy and Schwarz. For every η, y and ε > 0, with these middles,

    (ηᵀ δE y)² ≤ (1 + ε) Σ_i (ηᵀ L_i y)² + (1 + 1/ε) n k Σ_ab η_a² r_ab² y_b² = (η ⊗ y)ᵀ C (η ⊗ y),
    C = (1 + ε) Σ_i vec L_i vec L_iᵀ + (1 + 1/ε) n k diag r².

With any W (n, n) and X (k, k) such that W ⊗ X ⪰ C this is at most (ηᵀ W η) (yᵀ X y): q = δE y, the
only way in which δE enters a quadratic form, obeys yᵀ X y − qᵀ W⁻¹ q ≥ 0. That is one quadratic
inequality for any number of directions. For least squares on measured states
Σ_i vec L_i vec L_iᵀ is about a Kronecker product, and little is lost.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.certificates.proof import balls
from deadtime.certificates.proof.balls import congruent
from deadtime.plant.plant_set import PlantSet, norm_of_entries

ROUNDS = 60  # of fitting W and X in turn
FLOOR = 1e-9  # of W and X, in units in which their diagonals are about 1
Entry = tuple[int, int, int]  # mode, row and column of [A B]
ROOM = 0.02  # relative margin of W ⊗ X over C: a verifier's own W and X then suffice, too


def entries_of(plants: PlantSet, modes: tuple[int, ...]) -> list[Entry]:
    """The entries (mode, row, column) of [A B] in these modes that z moves."""
    _, _, n, both = plants.directions.shape
    places = product(sorted(set(modes)), range(n), range(both))
    return [place for place in places if np.any(plants.directions[:, *place])]


def unit_matrices(entries: list[Entry], shape: tuple[int, ...]) -> Float[np.ndarray, "entry n nm"]:
    """[A B] with a 1 at each entry, one matrix per entry."""
    result = np.zeros((len(entries), *shape))
    for at, (_, a, b) in enumerate(entries):
        result[at, a, b] = 1.0
    return result


def along_directions(by_entry: dict[Entry, Any], plants: PlantSet) -> Any:
    """(n k, d): L_i in the column i, row by row, from ∂E/∂θ."""
    from flint import arb_mat

    columns = [derivative.entries() for derivative in by_entry.values()]
    J = arb_mat([list(row) for row in zip(*columns, strict=True)])
    return J * balls.exact(np.array([plants.directions[:, *place] for place in by_entry]))


@dataclass(frozen=True, eq=False)
class Sway:
    """A bound of the change of E by z on a cell (immutable).

    Attributes
    ----------
    W : (n, n), X : (k, k)
        (ηᵀ δE y)² ≤ (ηᵀ W η) (yᵀ X y) for every z, proved.
    """

    W: Float[np.ndarray, "n n"]
    X: Float[np.ndarray, "k k"]

    @classmethod
    def of(cls, columns: Any, n: int) -> Sway | None:
        """From L_i in columns (n k, d); None if no W and X were proved."""
        from flint import arb, arb_mat

        middle, radius = balls.split(columns)
        if not (np.isfinite(middle).all() and np.isfinite(radius).all()):
            return None  # the set is too wide to be enclosed
        rest = norm_of_entries(radius.T) * np.sqrt(len(middle)) * (1.0 + 1e-12)
        sizes = [balls.norm_above(np.abs(each)) for each in (middle, rest)]
        # ε that balances the two parts of C; any ε > 0 is valid.
        part = float(np.clip(sizes[1] / max(sizes[0], 1e-300), 1e-9, 1.0))
        L = np.concatenate(
            (np.sqrt(1.0 + part) * middle, np.sqrt(1.0 + 1.0 / part) * np.diag(rest)), 1
        )
        try:
            W, X = kronecker(L.reshape(n, -1, L.shape[1]))
        except np.linalg.LinAlgError:
            return None
        C, D = balls.exact(middle), balls.exact(np.diag(rest))
        C, D = C * C.transpose() * (1 + arb(part)), D * D * (1 + 1 / arb(part))
        # W and X are floats found by iteration; this is the proof of W ⊗ X ⪰ C.
        both = W.tolist(), X.tolist()
        whole = arb_mat([[arb(w) * arb(x) for w in a for x in b] for a in both[0] for b in both[1]])
        return cls(W, X) if congruent(whole - C - D) is not None else None


def kronecker(L: Float[np.ndarray, "n k d"]) -> tuple[np.ndarray, np.ndarray]:
    """W and X with W ⊗ X ⪰ C in floats, of about the least determinant.

    By Lagrange: for a weight S ⪰ 0 on the axes W ⊗ X is fitted to Λ S Λᵀ, C = Λ Λᵀ, each factor in
    turn as the covariances of a matrix normal distribution; where Λᵀ (W ⊗ X)⁻¹ Λ is largest S
    grows in proportion, as the weights of a least ellipsoid do [Titterington, Appl. Statist. 27
    (1978) 227]. In the end W is scaled.
    """
    n, k, _ = L.shape
    rows, columns = _unit(L, (1, 2)), _unit(L, (0, 2))
    flat = (L / rows[:, None, None] / columns[:, None]).reshape(n * k, -1)
    # Λ only enters by Λ Λᵀ, so an economic factor of at most n k columns replaces all directions.
    left, sizes, _ = np.linalg.svd(flat, full_matrices=False)
    L = (left * sizes).reshape(n, k, -1)
    W, X, root = np.eye(n), np.eye(k), np.eye(len(sizes))
    for _ in range(ROUNDS):
        seen = L @ root
        X = _other(seen, W)
        W = _other(seen.transpose(1, 0, 2), X)
        inside = _whitened(L, W, X) @ root
        values, vectors = np.linalg.eigh(inside.T @ inside)
        root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        root = root / max(float(np.linalg.norm(root)), 1e-300) * np.sqrt(len(sizes))
    # The iteration may end short of feasibility; the scale makes W ⊗ X ⪰ (1 + ROOM) C.
    W = W * np.linalg.norm(_whitened(L, W, X), 2) ** 2 * (1.0 + ROOM)
    W, X = W * rows * rows[:, None], X * columns * columns[:, None]
    return 0.5 * (W + W.T), 0.5 * (X + X.T)


def _other(seen: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """The second factor of W ⊗ X by the first one, of a mean eigenvalue of 1."""
    count, size, _ = seen.shape
    first = np.linalg.solve(factor, seen.reshape(count, -1)).reshape(seen.shape)
    found = np.tensordot(seen, first, ((0, 2), (0, 2)))
    return found * (size / max(float(np.trace(found)), 1e-300)) + FLOOR * np.eye(size)


def _whitened(L: np.ndarray, W: np.ndarray, X: np.ndarray) -> np.ndarray:
    ways = np.linalg.inv(np.linalg.cholesky(W)), np.linalg.inv(np.linalg.cholesky(X))
    return np.tensordot(ways[0], ways[1] @ L, 1).reshape(-1, L.shape[2])


def _unit(L: np.ndarray, axis: tuple[int, ...]) -> np.ndarray:
    """The size of every row or column; never 0."""
    sizes = np.sqrt((L**2).sum(axis=axis))
    return np.maximum(sizes, max(1e-9 * float(sizes.max()), 1e-150))


def weight_of(form: np.ndarray, y: np.ndarray, W: np.ndarray, X: np.ndarray) -> float | None:
    """λ > 0 with form + λ (qᵀ W⁻¹ q − yᵀ X y) ≻ 0 by the largest margin, in floats; None if none.

    `form` is one in (v, q), y = `y` v. The margin is the least eigenvalue of the Schur complement
    after q is eliminated, in units in which the form in v alone is I. It is concave in λ.
    """
    v = y.shape[1]
    try:
        w = np.linalg.cholesky(W)
        T = np.linalg.inv(np.linalg.cholesky(form[:v, :v]))
    except np.linalg.LinAlgError:
        return None
    seen = y @ T.T
    pull = T @ form[:v, v:] @ w
    own, turn = np.linalg.eigh(w.T @ form[v:, v:] @ w)
    X, pull = seen.T @ X @ seen, pull @ turn
    most = 1.0 / max(float(np.linalg.eigvalsh(X)[-1]), 1e-300)
    least = max(-float(own[0]), 1e-12 * most, 0.0)
    if not least < most:
        return None

    def margin(log: float) -> float:
        weight = np.exp(log)
        left = np.eye(v) - weight * X - (pull / (weight + own)) @ pull.T
        return float(np.linalg.eigvalsh(left)[0])

    best, found = _highest(margin, np.log(least) + 1e-9, np.log(most))
    return float(np.exp(best)) if found > 0.0 else None


def _highest(value: Any, low: float, high: float) -> tuple[float, float]:
    """(argument, value) at the maximum of a unimodal function, by golden section."""
    part = 0.5 * (np.sqrt(5.0) - 1.0)
    a, b = high - part * (high - low), low + part * (high - low)
    at_a, at_b = value(a), value(b)
    for _ in range(40):
        if at_a < at_b:
            low, a, at_a = a, b, at_b
            b = low + part * (high - low)
            at_b = value(b)
        else:
            high, b, at_b = b, a, at_a
            a = high - part * (high - low)
            at_a = value(a)
    return (a, at_a) if at_a > at_b else (b, at_b)
