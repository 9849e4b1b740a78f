"""The steps of a box of delays, enclosed, input by input: E at a point, and its slopes on a cell.

The generator X of a piece commutes with its exponential, so

    E = e^{X_K (h − t_{K−1})} … e^{X_2 (t_2 − t_1)} e^{X_1 t_1},
    ∂E/∂p = Σ_k ∂t_k/∂p (the pieces after t_k) (X_k − X_{k+1}) (the pieces before it).
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from deadtime.certificates.proof import balls
from deadtime.certificates.proof.box import (
    FIRST,
    POLYTOPE,
    Box,
    DelayInterval,
    InputPiece,
    TimeNumbers,
    U,
)
from deadtime.certificates.proof.ellipsoid import (
    along_axes,
    entries_of,
    radius_of,
    swelled,
    unit_matrices,
)
from deadtime.certificates.proof.step_enclosure import (
    Enclosure,
    ParameterCell,
    by_entries,
    combine,
    frechet,
    hull_of,
    product_of,
)


class _Chain(NamedTuple):
    """Over a cell: the pieces of an input, their exponentials, and their generators at every
    corner of the polytope."""

    pieces: list[InputPiece]
    factors: list[Any]
    corners: list[list[Any]]


class BoxEnclosures:
    """Encloses cells of a box; generators are made once."""

    def __init__(self, family: Box) -> None:
        from flint import arb

        self.family = family
        step = balls.decimal_number(family.step)

        def phases(one: DelayInterval) -> tuple[Any, Any]:
            late = step * (one.count - 1)
            low, high = (balls.decimal_number(delay) - late for delay in one.delays)
            low = arb(0) if one.low == 0.0 else step if one.low == family.step else low
            return low, step if one.high == family.step else high

        self.clock = TimeNumbers(arb, phases, step, _room)
        self.generators: dict[tuple[int, int, int], list[Any]] = {}

    def of(self, cell: ParameterCell) -> Enclosure:
        """Enclose one cell; E may be split by `ParameterCell.halves` until the slopes are small."""
        family, n = self.family, self.family.A.shape[2]
        parts = [self._of_input(cell, c) for c in range(family.B.shape[3])]
        together: list[tuple[int, Any]] = []
        for at, (k, _) in enumerate(parts[0].slopes):
            together.append((k, self._joined([part.slopes[at][1] for part in parts], n)))
        sway = None if family.axes is None else self._sway(cell, family.axes)
        return Enclosure(self._joined([part.centre for part in parts], n), together, sway)

    def _sway(self, cell: ParameterCell, axes: np.ndarray) -> Any:
        """L_i on the cell, everywhere in the ellipsoid; each input's columns by its own pieces."""
        family = self.family
        n, radius = family.A.shape[2], radius_of(axes)
        u, *f = (balls.interval(*pair) for pair in (cell.u, *cell.f))
        entries = entries_of(axes, (cell.order.mode, cell.order.after))
        if not entries:
            return None
        found = []
        for c in range(family.B.shape[3]):
            pieces = family.pieces(cell.order, c, self.clock, u, f)
            X, moves = [], []
            for piece, tau in zip(pieces, self._durations(pieces), strict=True):
                (room,) = family.laid_out(radius[piece.mode][None], c, piece.lag)
                X.append(swelled(self._corners(piece, c)[0], room) * tau)
                own = [place for place in entries if place[0] == piece.mode]
                units = family.laid_out(unit_matrices(own, radius.shape[1:]), c, piece.lag)
                moves.append({at: balls.exact(U) * tau for at, U in zip(own, units, strict=True)})
            found.append(by_entries(X, moves, n))
        joined = {at: self._joined([each[at] for each in found], n) for at in entries}
        return along_axes(joined, axes)

    def _joined(self, parts: list[Any], n: int) -> Any:
        """Rows over (x, all reads) from those over x and the reads of each input."""
        from flint import arb_mat

        result = arb_mat(n, n + len(self.family.reads))
        for c, part in enumerate(parts):
            places = [*range(n), *self.family.columns(c)]
            for i, row in enumerate(part.tolist()):
                for place, x in zip(places, row, strict=True):
                    result[i, place] = x
        return result

    def _of_input(self, cell: ParameterCell, c: int) -> Enclosure:
        """The columns of x and of one input."""
        from flint import arb

        ends = (cell.u, *cell.f)
        middle_u, *middles = (arb(0.5) * (arb(a) + arb(b)) for a, b in ends)
        u, *f = (balls.interval(*pair) for pair in ends)
        weights, n = cell.corners.mean(axis=0), self.family.A.shape[2]
        hull = None if len(cell.corners) == 1 else cell.corners
        pieces = self.family.pieces(cell.order, c, self.clock, middle_u, middles)
        centre = product_of([X.exp() for X in self._exponents(pieces, c, weights, None)])
        slopes: list[tuple[int, Any]] = []
        moving = self._moving(cell)
        if moving or hull is not None:
            pieces = self.family.pieces(cell.order, c, self.clock, u, f)
            factors = [X.exp() for X in self._exponents(pieces, c, weights, hull)]
            chain = _Chain(pieces, factors, [self._corners(piece, c) for piece in pieces])
            for k, half in moving:
                slope = self._slope(chain, weights, hull, k)
                slopes.append((k, balls.top(slope, n) * arb(half)))
            for corner in cell.corners if hull is not None else ():
                slope = self._towards(chain, weights, hull, corner)
                slopes.append((POLYTOPE, balls.top(slope, n)))
        return Enclosure(balls.top(centre, n), slopes)

    def _moving(self, cell: ParameterCell) -> list[tuple[int, float]]:
        """The directions in which the cell is not a point, and half of its width."""
        full = cell.order.mode == cell.order.after
        ends = [(U, cell.u)] * (not full) + list(enumerate(cell.f, FIRST))
        return [(k, math.nextafter(0.5 * (b - a), math.inf)) for k, (a, b) in ends if b > a]

    def _corners(self, piece: InputPiece, c: int) -> list[Any]:
        """The generator of a piece at every corner of the polytope."""
        key = piece.mode, c, piece.lag
        if key not in self.generators:
            self.generators[key] = [balls.decimal(X) for X in self.family.generator(*key)]
        return self.generators[key]

    def _durations(self, pieces: list[InputPiece]) -> list[Any]:
        ends = [*(piece.end for piece in pieces[:-1]), self.clock.step]
        return [ends[0], *(b - a for a, b in pairwise(ends))]

    def _exponents(
        self, pieces: list[InputPiece], c: int, weights: np.ndarray, hull: np.ndarray | None
    ) -> list[Any]:
        """𝒜 τ of every piece."""
        return [
            hull_of(self._corners(piece, c), weights, hull) * tau
            for piece, tau in zip(pieces, self._durations(pieces), strict=True)
        ]

    def _slope(
        self, chain: _Chain, weights: np.ndarray, hull: np.ndarray | None, direction: int
    ) -> Any:
        """∂E/∂p of u or a delay."""
        X = [hull_of(corners, weights, hull) for corners in chain.corners]
        size = X[0].nrows()
        total = balls.zeros(size, size)
        for k, piece in enumerate(chain.pieces[:-1]):
            if direction in piece.moves:
                before = product_of(chain.factors[: k + 1])
                after = product_of(chain.factors[k + 1 :])
                total = total + after * (X[k] - X[k + 1]) * before * piece.moves[direction]
        return total

    def _towards(
        self, chain: _Chain, weights: np.ndarray, hull: np.ndarray | None, corner: np.ndarray
    ) -> Any:
        """The derivative from the weights towards a corner of the polytope."""
        total, durations = None, self._durations(chain.pieces)
        for k, (corners, tau) in enumerate(zip(chain.corners, durations, strict=True)):
            away = combine(corners, corner) - combine(corners, weights)
            inner = frechet(hull_of(corners, weights, hull) * tau, away * tau)
            term = product_of([*chain.factors[:k], inner, *chain.factors[k + 1 :]])
            total = term if total is None else total + term
        return total


def _room(amount: Any, sign: int) -> Any:
    """From 0 to max(0, a), or to its negative."""
    from flint import arb

    most = amount.upper()
    return arb(0).union(most * sign) if most > 0 else arb(0)
