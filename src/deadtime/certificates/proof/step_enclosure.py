"""Enclosures of the steps of a family: E at a point of the parameters, derivatives on a cell.

A cell is one order of events with u in [u₀, u₁], f in [f₀, f₁] and λ in a simplex of the
polytope. The derivative of the product e^{𝒜_K τ_K} … e^{𝒜_1 τ_1} with respect to a parameter
is, segment by segment,

    … e^{𝒜_k τ_k} 𝒜_k (∂τ_k/∂θ) …    (instants and the delay),
    … L(𝒜_k τ_k, 𝒟_k τ_k) …          (the polytope, 𝒟 = 𝒜^corner − 𝒜^centre),

L the Fréchet derivative of the exponential, the top right block of exp [[X, Y], [0, X]].

This mean-value form is tight to second order in the size of a cell; exponentials of wide balls
alone would be so to first order, and would need far more cells.

Steps of a box of delays are enclosed input by input. The generator X of a piece commutes with its
exponential, so

    E = e^{X_K (h − t_{K−1})} … e^{X_2 (t_2 − t_1)} e^{X_1 t_1},
    ∂E/∂p = Σ_k ∂t_k/∂p (the pieces after t_k) (X_k − X_{k+1}) (the pieces before it).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

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
from deadtime.certificates.proof.family import Family, Lags, Segment
from deadtime.certificates.proof.sway import (
    Entry,
    along_directions,
    entries_of,
    unit_matrices,
)
from deadtime.plant.plant_set import PlantSet

SHARES = {"all": (1.0, 0.0), "before": (0.0, 1.0), "after": (1.0, -1.0)}  # a + b u


@dataclass(frozen=True, eq=False)
class ParameterCell:
    """A part of the parameters: `f` of every delay, `corners` (k, vertices) the simplex in λ."""

    order: Any
    u: tuple[float, float]
    f: tuple[tuple[float, float], ...]
    corners: np.ndarray

    def halves(self, direction: int) -> tuple[ParameterCell, ParameterCell]:
        """Bisect along u, an f, or the longest edge of the simplex (`POLYTOPE`)."""
        if direction == U:
            (low, high), middle = self.u, 0.5 * sum(self.u)
            return replace(self, u=(low, middle)), replace(self, u=(middle, high))
        if direction >= FIRST:
            k = direction - FIRST
            (low, high), middle = self.f[k], 0.5 * sum(self.f[k])
            before, after = self.f[:k], self.f[k + 1 :]
            return (
                replace(self, f=(*before, (low, middle), *after)),
                replace(self, f=(*before, (middle, high), *after)),
            )
        distance = np.linalg.norm(self.corners[:, None] - self.corners, axis=2)
        a, b = np.unravel_index(np.argmax(distance), distance.shape)
        between = 0.5 * (self.corners[a] + self.corners[b])
        first, second = self.corners.copy(), self.corners.copy()
        first[b] = second[a] = between
        return replace(self, corners=first), replace(self, corners=second)


@dataclass(frozen=True, eq=False)
class Enclosure:
    """E (n, k) at the centre of a cell, and slopes (direction, D), which enclose E over the cell.

    E(cell) lies in E + Σ [−1, 1] D over all directions but `POLYTOPE`, plus the convex hull of the
    D of `POLYTOPE`, plus Σ z_i L_i over |z| ≤ 1. L_i is a column of `sway` (n k, directions), row
    by row; `sway` is None if z has no effect.
    """

    centre: Any
    slopes: list[tuple[int, Any]]
    sway: Any = None


def cells_of(
    family: Family | Box, mode: int, after: int, instants: tuple[float, float] = (0.0, 1.0)
) -> list[ParameterCell]:
    """The cells that cover every step from `mode` to `after` with a switch at these instants."""
    corners, cells = np.eye(len(family.plants.A)), []
    orders: list[Any] = list(family.orders(mode, after))
    for order in orders:
        shares = family.shares(order, instants)
        if shares is not None:
            whole = ((0.0, 1.0),) * len(family.moving(order))
            cells.append(ParameterCell(order, shares, whole, corners))
    return cells


class Enclosures:
    """Encloses cells of a family; generators are made once."""

    def __init__(self, family: Family) -> None:
        self.family = family
        from flint import arb

        step = balls.decimal_number(family.step)
        # φ = D − (N − 1) h of the decimals differs from that of the floats by a few units in the
        # last place of N h, much more than half a unit in its own.
        slack = arb(0.0, 4.0 * float(np.spacing(family.step * (family.count + 1))))

        def ball(mark: float) -> Any:
            return step if mark == family.step else balls.decimal_number(mark) + slack

        self.marks = [(arb(0), arb(0))]
        self.marks += [(ball(low), ball(high)) for low, high in family.marks[1:]]
        self.generators: dict[tuple[int, Lags], list[Any]] = {}

    def of(self, cell: ParameterCell) -> Enclosure:
        """Enclose one cell."""
        from flint import arb

        pairs = (cell.u, *cell.f)
        u, f = (balls.interval(*pair) for pair in pairs)
        middle = [arb(0.5) * (arb(a) + arb(b)) for a, b in pairs]
        generators = [self._corners(part) for part in cell.order]
        ends = [(U, cell.u)] * self.family.switches(cell.order)
        ends += [(FIRST, cell.f[0])] * self.family.ranges

        def slope(k: int, factors: list[Any], X: list[Any]) -> Any:
            rates = [self._rate(part, k, u, f) for part in cell.order]
            each = zip(X, factors, rates, strict=True)
            return _sum(factors, [G * factor * rate for G, factor, rate in each])

        middle, wide = (
            [self._duration(part, *at) for part in cell.order] for at in (middle, (u, f))
        )
        n = self.family.states
        centre, slopes = enclosed(cell, n, generators, middle, wide, ends, slope)
        return Enclosure(centre, slopes, self.sway(cell))

    def sway(self, cell: ParameterCell) -> Any:
        """L_i on the cell, for every z; None without an ellipsoid."""
        plants, order = self.family.plants, cell.order
        entries = entries_of(plants, tuple(part.mode for part in order))
        if not entries:
            return None
        u, f = (balls.interval(*pair) for pair in (cell.u, *cell.f))
        X = [(part.mode, self._corners(part)[0], self._duration(part, u, f)) for part in order]
        layouts = [partial(self.family.arranged, lags=part.lags) for part in order]
        return along_directions(by_entries(plants, entries, X, layouts), plants)

    def _duration(self, part: Segment, u: Any, f: Any) -> Any:
        a, b = SHARES[part.share]
        return (self._mark(part.stop, f) - self._mark(part.start, f)) * (u * b + a)

    def _mark(self, k: int, f: Any) -> Any:
        # Without a range not even f · 0 is added: it would widen the ball.
        low, high = self.family.marks[k]
        return self.marks[k][0] + f * self._rise(k) if low < high else self.marks[k][0]

    def _rise(self, k: int) -> Any:
        """∂mark/∂f, the width of its range; an exact 0 where it has none."""
        (low, high), (first, last) = self.marks[k], self.family.marks[k]
        return high - low if first < last else 0

    def _rate(self, part: Segment, direction: int, u: Any, f: Any) -> Any:
        a, b = SHARES[part.share]
        if direction == U:
            return (self._mark(part.stop, f) - self._mark(part.start, f)) * b
        return (u * b + a) * (self._rise(part.stop) - self._rise(part.start))

    def _corners(self, part: Segment) -> list[Any]:
        key = part.mode, part.lags
        if key not in self.generators:
            self.generators[key] = [balls.decimal(X) for X in self.family.generator(*key)]
        return self.generators[key]


def enclosed(
    cell: ParameterCell,
    n: int,
    generators: list[list[Any]],
    middle: list[Any],
    wide: list[Any],
    ends: list[tuple[int, tuple[float, float]]],
    slope: Callable[[int, list[Any], list[Any]], Any],
) -> tuple[Any, list[tuple[int, Any]]]:
    """E at the centre of a cell and its slopes, n rows each: the mean-value form of a product.

    The durations of the pieces are `middle` at the centre and `wide` over the cell; `ends` has the
    range of each direction, and `slope` the derivative by one, of exponentials and generators.
    """
    from flint import arb

    weights = cell.corners.mean(axis=0)
    hull = None if len(cell.corners) == 1 else cell.corners
    point = zip(generators, middle, strict=True)
    centre = product_of([(hull_of(G, weights, None) * tau).exp() for G, tau in point])
    # Half widths rounded up: the slopes times [−1, 1] must reach both ends of the cell.
    moving = [(k, math.nextafter(0.5 * (b - a), math.inf)) for k, (a, b) in ends if b > a]
    slopes: list[tuple[int, Any]] = []
    if moving or hull is not None:
        X = [hull_of(corners, weights, hull) for corners in generators]
        factors = [(G * tau).exp() for G, tau in zip(X, wide, strict=True)]
        for k, half in moving:
            slopes.append((k, balls.top(slope(k, factors, X), n) * arb(half)))
        for corner in cell.corners if hull is not None else ():
            inner = towards(generators, wide, weights, hull, corner)
            slopes.append((POLYTOPE, balls.top(_sum(factors, inner), n)))
    return balls.top(centre, n), slopes


def combine(corners: list[Any], weights: np.ndarray) -> Any:
    """Σ λ_k 𝒜^k."""
    from flint import arb

    total = corners[0] * arb(float(weights[0]))
    for corner, weight in zip(corners[1:], weights[1:], strict=True):
        total = total + corner * arb(float(weight))
    return total


def hull_of(corners: list[Any], weights: np.ndarray, hull: np.ndarray | None) -> Any:
    """𝒜 at the weights, or its entrywise hull over a simplex with this centre."""
    if len(corners) == 1:
        return corners[0]
    if hull is None:
        return combine(corners, weights)
    from flint import arb_mat

    points = [combine(corners, point).entries() for point in (weights, *hull)]
    size = corners[0].nrows()
    union = points[0]
    for point in points[1:]:
        union = [x.union(y) for x, y in zip(union, point, strict=True)]
    return arb_mat(size, size, union)


def frechet(X: Any, Y: Any) -> Any:
    """The derivative of the exponential at X in the direction Y."""
    from flint import arb_mat

    size = X.nrows()
    whole = balls.blocks([[X, Y], [balls.zeros(size, size), X]]).exp().tolist()
    return arb_mat([row[size:] for row in whole[:size]])


def towards(
    generators: list[list[Any]],
    durations: list[Any],
    weights: np.ndarray,
    hull: np.ndarray | None,
    corner: np.ndarray,
) -> list[Any]:
    """The derivatives of exponentials from the weights towards a corner of the polytope."""
    inner = []
    for corners, tau in zip(generators, durations, strict=True):
        away = combine(corners, corner) - combine(corners, weights)
        inner.append(frechet(hull_of(corners, weights, hull) * tau, away * tau))
    return inner


def by_entries(
    plants: PlantSet, entries: list[Entry], X: list[tuple[int, Any, Any]], layouts: list[Any]
) -> dict[Entry, Any]:
    """The first n rows of the derivative of … e^{X_2} e^{X_1} by each entry of A and B, at every z.

    X are the mode of each piece, its generator at the vertex, and its duration; `layouts` place the
    entries of A and B in the generators.
    """
    n, radius, factors = plants.sizes[1], plants.radius, []
    moves: list[dict[Entry, Any]] = []
    for (mode, generator, tau), arranged in zip(X, layouts, strict=True):
        (room,) = arranged(radius[mode][None])
        exponent = (generator + balls.symmetric_matrix(room)) * tau  # every entry in its range
        own = [place for place in entries if place[0] == mode]
        units = zip(own, arranged(unit_matrices(own, radius.shape[1:])), strict=True)
        moves.append({place: frechet(exponent, balls.exact(U) * tau) for place, U in units})
        factors.append(exponent.exp())
    found: dict[Entry, Any] = {}
    for k, of_piece in enumerate(moves):
        # Only the first n rows are formed, from the left, so later products have n rows, too.
        before = product_of(factors[:k]) if k else None
        after = balls.top(product_of(factors[k + 1 :]), n) if k + 1 < len(X) else None
        for place, derivative in of_piece.items():
            term = balls.top(derivative, n) if after is None else after * derivative
            term = term if before is None else term * before
            found[place] = found[place] + term if place in found else term
    return {place: found[place] for place in entries}


def product_of(factors: list[Any]) -> Any:
    """factors[-1] … factors[0]."""
    result = factors[0]
    for factor in factors[1:]:
        result = factor * result
    return result


def _sum(factors: list[Any], inner: list[Any]) -> Any:
    total = None
    for k, derivative in enumerate(inner):
        term = product_of([*factors[:k], derivative, *factors[k + 1 :]])
        total = term if total is None else total + term
    return total


class BoxEnclosures:
    """Encloses cells of a box; generators are made once."""

    def __init__(self, family: Box) -> None:
        from flint import arb

        self.family = family
        step = balls.decimal_number(family.step)

        def phases(one: DelayInterval) -> tuple[Any, Any]:
            late = step * (one.count - 1)
            low, high = (balls.decimal_number(delay) - late for delay in one.delays)
            # At the ends of a period φ is 0 or h exactly, as the loop takes it.
            low = arb(0) if one.low == 0.0 else step if one.low == family.step else low
            return low, step if one.high == family.step else high

        self.clock = TimeNumbers(arb, phases, step, _room)
        self.generators: dict[tuple[int, int, int], list[Any]] = {}

    def of(self, cell: ParameterCell) -> Enclosure:
        """Enclose one cell."""
        family, n = self.family, self.family.states
        parts = [self._of_input(cell, c) for c in range(family.plants.sizes[2])]
        together: list[tuple[int, Any]] = []
        for at, (k, _) in enumerate(parts[0].slopes):
            together.append((k, self._joined([part.slopes[at][1] for part in parts], n)))
        centre = self._joined([part.centre for part in parts], n)
        return Enclosure(centre, together, self.sway(cell))

    def sway(self, cell: ParameterCell) -> Any:
        """L_i on the cell, for every z; each input's columns come from its own pieces."""
        family, plants = self.family, self.family.plants
        entries = entries_of(plants, (cell.order.mode, cell.order.after))
        if not entries:
            return None
        u, *f = (balls.interval(*pair) for pair in (cell.u, *cell.f))
        found = []
        for c in range(plants.sizes[2]):
            pieces = family.pieces(cell.order, c, self.clock, u, f)
            durations = zip(pieces, self._durations(pieces), strict=True)
            X = [(piece.mode, self._corners(piece, c)[0], tau) for piece, tau in durations]
            layouts = [partial(family.arranged, c=c, lag=piece.lag) for piece in pieces]
            found.append(by_entries(plants, entries, X, layouts))
        n = family.states
        joined = {at: self._joined([each[at] for each in found], n) for at in entries}
        return along_directions(joined, plants)

    def _joined(self, parts: list[Any], n: int) -> Any:
        """Rows over (x, all reads) from rows over x and the reads of each input.

        The columns of x are the same for every input; the last one's are kept.
        """
        from flint import arb_mat

        result = arb_mat(n, n + len(self.family.reads))
        for c, part in enumerate(parts):
            places = [*range(n), *self.family.columns(c)]
            for i, row in enumerate(part.tolist()):
                for place, x in zip(places, row, strict=True):
                    result[i, place] = x
        return result

    def _of_input(self, cell: ParameterCell, c: int) -> Enclosure:
        from flint import arb

        ends = (cell.u, *cell.f)
        middle_u, *middles = (arb(0.5) * (arb(a) + arb(b)) for a, b in ends)
        u, *f = (balls.interval(*pair) for pair in ends)
        at = ((middle_u, middles), (u, f))
        centre, pieces = (self.family.pieces(cell.order, c, self.clock, *each) for each in at)
        generators = [self._corners(piece, c) for piece in pieces]
        middle, wide = self._durations(centre), self._durations(pieces)
        moving = [(U, cell.u)] * self.family.switches(cell.order) + [*enumerate(cell.f, FIRST)]
        slope = partial(_slope, pieces)
        n = self.family.states
        return Enclosure(*enclosed(cell, n, generators, middle, wide, moving, slope))

    def _corners(self, piece: InputPiece, c: int) -> list[Any]:
        key = piece.mode, c, piece.lag
        if key not in self.generators:
            self.generators[key] = [balls.decimal(X) for X in self.family.generator(*key)]
        return self.generators[key]

    def _durations(self, pieces: list[InputPiece]) -> list[Any]:
        ends = [*(piece.end for piece in pieces[:-1]), self.clock.step]
        return [ends[0], *(b - a for a, b in pairwise(ends))]


def _slope(pieces: list[InputPiece], direction: int, factors: list[Any], X: list[Any]) -> Any:
    """∂E/∂p of u or a delay, X the generators of the pieces: one term per end that p moves."""
    size = X[0].nrows()
    total = balls.zeros(size, size)
    for k, piece in enumerate(pieces[:-1]):
        if direction in piece.moves:
            before, after = product_of(factors[: k + 1]), product_of(factors[k + 1 :])
            total = total + after * (X[k] - X[k + 1]) * before * piece.moves[direction]
    return total


def _room(amount: Any, sign: int) -> Any:
    """The ball from 0 to sign · max(0, a)."""
    from flint import arb

    most = amount.upper()
    return arb(0).union(most * sign) if most > 0 else arb(0)
