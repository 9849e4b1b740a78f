"""Switching rules: the mode as a function of the state, σ(t) = r(x(t)).

The regions of the modes are half-spaces, polyhedra or sets of a largest quadratic form; or the rule
is any function. A state on a boundary belongs to mode 1 of a half-space, and to the first of the
polyhedra that contain it. A rule has one mode for every state: regions that overlap or leave a gap
are refused.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from deadtime.base.checks import count, index, number, read_only, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.plant import SwitchedSystem
from deadtime.switching.rules.motion import Motion
from deadtime.switching.rules.partition import require_partition
from deadtime.switching.rules.region_and_sampled_motion import RegionMotion, Regions, SampledMotion
from deadtime.switching.signal import SwitchingSignal


@dataclass(frozen=True, eq=False, repr=False)
class Rule(Frozen, ABC):
    """A map from states to modes."""

    @abstractmethod
    def modes_of(self, states: Float[np.ndarray, "k n"]) -> Int[np.ndarray, " k"]:
        """The modes of many states, one per row."""

    @abstractmethod
    def require(self, plant: SwitchedSystem) -> Rule:
        """The rule itself, if it fits the sizes of a plant; an error otherwise."""

    @abstractmethod
    def motion(self, plant: SwitchedSystem, lengths: tuple[float, ...], unseen: int = 0) -> Motion:
        """A plant under the rule, over pieces of these lengths with held inputs.

        The rule does not depend on the last `unseen` states of the plant.
        """

    @abstractmethod
    def same(self, other: Rule) -> bool:
        """Whether the other rule has equal numbers, or is the same function."""

    def __call__(self, x: ArrayLike) -> int:
        """r(x), the mode of one state of shape (n,)."""
        return int(self.modes_of(real_array("x", x, "(n,)", 1)[None])[0])


@dataclass(frozen=True, eq=False, repr=False)
class PolyhedralRule(Rule):
    """A rule made of polyhedra: region r is where rows·x ≤ offsets for its rows.

    Attributes
    ----------
    rows : (rows, n), offsets : (rows,)
        The inequalities of all regions, one region after the other.
    region_modes : (regions,) int
        The mode of each region; several may share one.
    first : (regions + 1,) int
        The first row of each region, then the number of rows.
    """

    rows: Float[np.ndarray, "row n"]
    offsets: Float[np.ndarray, " row"]
    region_modes: Int[np.ndarray, " region"]
    first: Int[np.ndarray, " region+1"]

    def regions_of(self, states: Float[np.ndarray, "k n"]) -> Int[np.ndarray, " k"]:
        """The first region that contains each state; the nearest if round-off leaves none."""
        norms = np.linalg.norm(self.rows, axis=1)
        outside = (states @ self.rows.T - self.offsets) / norms
        outside = np.maximum.reduceat(outside, self.first[:-1], axis=1)
        holds = outside <= 0.0
        # `argmax` of booleans is the first that holds: earlier regions own shared boundaries.
        return np.where(holds.any(axis=1), holds.argmax(axis=1), outside.argmin(axis=1))

    def modes_of(self, states: Float[np.ndarray, "k n"]) -> Int[np.ndarray, " k"]:
        return self.region_modes[self.regions_of(states)]

    def require(self, plant: SwitchedSystem) -> Rule:
        n, highest = self.rows.shape[1], int(self.region_modes.max())
        if n != plant.states:
            raise ArgumentError(
                f"rule must be one of {plant.states} states, as the plant's, got one of {n}."
            )
        if highest >= plant.modes:
            raise ArgumentError(
                f"rule names mode {highest}, but the plant's modes are 0..{plant.modes - 1}: "
                "modes count from 0."
            )
        return self

    def motion(self, plant: SwitchedSystem, lengths: tuple[float, ...], unseen: int = 0) -> Motion:
        size, n = plant.states, self.rows.shape[1]
        rows = np.pad(self.rows, ((0, 0), (0, unseen)))
        planes = np.empty((0, size, size)), rows, self.offsets, self.first, self.region_modes

        def regions_of(states: np.ndarray) -> np.ndarray:
            return self.regions_of(states[:, :n])

        return RegionMotion.of(regions_of, plant.A, plant.B, Regions(*planes), lengths, unseen)

    def same(self, other: Rule) -> bool:
        return isinstance(other, PolyhedralRule) and all(
            np.array_equal(getattr(self, name), getattr(other, name))
            for name in ("rows", "offsets", "first", "region_modes")
        )


@dataclass(frozen=True, eq=False, init=False, repr=False)
class HalfSpace(PolyhedralRule):
    r"""Mode 1 where :math:`\text{normal} \cdot x \ge \text{offset}`, mode 0 elsewhere.

    Parameters
    ----------
    normal : array_like, shape (n,)
        Points into mode 1; any length but 0.
    offset : float
        In the unit of :math:`\text{normal} \cdot x`.

    Examples
    --------
    >>> import numpy as np
    >>> rule = HalfSpace([0.0, 1.0], offset=0.5)
    >>> rule([3.0, 0.5]), rule([3.0, 0.4])
    (1, 0)
    """

    normal: Float[np.ndarray, " n"]
    offset: float

    def __init__(self, normal: ArrayLike, offset: float = 0.0) -> None:
        normal = real_array("normal", normal, "(n,)", 1)
        offset = number("offset", offset)
        if not normal.any():
            raise ArgumentError("normal must not be zero: it points from mode 0 into mode 1.")
        # The first region owns the boundary: mode 1.
        _fill(self, np.stack((-normal, normal)), np.array([-offset, offset]), [0, 1, 2], [1, 0])
        vars(self).update(normal=normal, offset=offset)

    def __repr__(self) -> str:
        return f"HalfSpace(mode 1 where {self.normal.tolist()}·x ≥ {self.offset:g})"


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Polyhedra(PolyhedralRule):
    r"""The mode of the polyhedral region that contains the state.

    Region :math:`i` is where :math:`H_i x \le h_i`.

    Parameters
    ----------
    regions : sequence of pairs (H, h)
        Shapes (rows, n) and (rows,). Their union must be the whole space.
    modes : sequence of int, optional
        The mode of each region, 0, 1, 2, … by default. Regions of one mode may overlap.

    Raises
    ------
    ArgumentError
        If a region is empty, regions of different modes overlap, or there is a gap; the message has
        a state as an example.

    Examples
    --------
    A slab :math:`|x_1| \le 1` in mode 0 between two half-spaces in mode 1:

    >>> slab = ([[1, 0], [-1, 0]], [1, 1])
    >>> rule = Polyhedra([slab, ([[-1, 0]], [-1]), ([[1, 0]], [-1])], modes=[0, 1, 1])
    >>> rule.modes_of(np.array([[0.5, 9.0], [1.0, 0.0], [-2.0, 0.0]]))
    array([0, 0, 1])
    """

    def __init__(
        self, regions: Sequence[Sequence[ArrayLike]], modes: Sequence[int] | None = None
    ) -> None:
        pairs = [_polyhedron(i, region) for i, region in enumerate(regions)]
        if not pairs:
            raise ArgumentError("regions must hold at least one pair (H, h), got none.")
        n = pairs[0][0].shape[1]
        for i, (H, _) in enumerate(pairs):
            require_shape(f"regions[{i}][0]", H, (H.shape[0], n), "(rows, n)")
        modes = range(len(pairs)) if modes is None else modes
        if len(modes) != len(pairs):
            raise ArgumentError(
                f"modes must have one entry per region, {len(pairs)}, got {len(modes)}."
            )
        named = np.array([count(f"modes[{i}]", mode, 0) for i, mode in enumerate(modes)])
        require_partition(pairs, named)
        first = np.cumsum([0, *(h.size for _, h in pairs)])
        rows, offsets = np.vstack([H for H, _ in pairs]), np.concatenate([h for _, h in pairs])
        _fill(self, rows, offsets, first, named)

    @property
    def regions(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The pairs (H, h)."""
        cuts = self.first[1:-1]
        return list(zip(np.split(self.rows, cuts), np.split(self.offsets, cuts), strict=True))

    @property
    def modes(self) -> list[int]:
        """The mode of each region."""
        return self.region_modes.tolist()

    def __repr__(self) -> str:
        regions, modes = self.region_modes.size, np.unique(self.region_modes).size
        return f"Polyhedra(regions={regions}, modes={modes}, states={self.rows.shape[1]})"


@dataclass(frozen=True, eq=False, repr=False)
class FunctionRule(Rule):
    """A function from a state of shape (n,) to a mode; `simulate` and laws take a function, too.

    Crossings are searched at samples of every piece of time under one input, and then bisected: a
    stay in a mode between two samples is missed, and the run ends where both modes' fields point
    at their boundary. `HalfSpace`, `Polyhedra` and `QuadraticRegions` miss no stay beyond
    round-off, and slide along their boundaries.

    Parameters
    ----------
    function : callable
        From x, shape (n,), to an integer.
    samples : int
        Number of samples of each piece; 8 by default.

    Examples
    --------
    >>> rule = FunctionRule(lambda x: 1 if x[0] ** 2 + x[1] ** 2 > 1.0 else 0)
    >>> rule([0.5, 0.5])
    0
    """

    function: Callable[[np.ndarray], int]
    samples: int = 8

    def __post_init__(self) -> None:
        count("samples", self.samples)
        super().__post_init__()

    def modes_of(self, states: Float[np.ndarray, "k n"]) -> Int[np.ndarray, " k"]:
        return np.array([self.function(x) for x in states])

    def require(self, plant: SwitchedSystem) -> Rule:
        return self

    def motion(self, plant: SwitchedSystem, lengths: tuple[float, ...], unseen: int = 0) -> Motion:
        function, modes, seen = self.function, plant.modes, plant.states - unseen

        def mode_at(x: np.ndarray) -> int:
            mode = function(x[:seen])
            if (type(mode) is int or isinstance(mode, np.integer)) and 0 <= mode < modes:
                return int(mode)
            return index(f"rule({np.array2string(x[:seen], precision=4)})", mode, modes)

        return SampledMotion.of(mode_at, plant.A, plant.B, self.samples, lengths)

    def same(self, other: Rule) -> bool:
        mine = self.function, self.samples
        return isinstance(other, FunctionRule) and mine == (other.function, other.samples)

    def __repr__(self) -> str:
        name = getattr(self.function, "__name__", type(self.function).__name__)
        return f"FunctionRule({name}, samples={self.samples})"


def as_rule(name: str, value: Any) -> Rule:
    """The rule itself, or a function of the state as a rule."""
    if isinstance(value, Rule):
        return value
    if isinstance(value, SwitchingSignal) or not callable(value):
        raise ArgumentError(
            f"{name} must be a HalfSpace, Polyhedra, QuadraticRegions or a function from a state "
            f"to a mode, got {type(value).__name__}."
        )
    return FunctionRule(cast("Callable[[np.ndarray], int]", value))


def _polyhedron(i: int, region: Sequence[ArrayLike]) -> tuple[np.ndarray, np.ndarray]:
    if not isinstance(region, (tuple, list)) or len(region) != 2:
        raise ArgumentError(f"regions[{i}] must be a pair (H, h), got {region!r}.")
    H = real_array(f"regions[{i}][0]", region[0], "(rows, n)", 2)
    h = real_array(f"regions[{i}][1]", region[1], "(rows,)", 1)
    require_shape(f"regions[{i}][1]", h, (H.shape[0],), "(rows,)")
    empty = np.flatnonzero(~H.any(axis=1))
    if empty.size:
        raise ArgumentError(f"regions[{i}][0][{empty[0]}] must not be a row of zeros.")
    return H, h


def _fill(
    rule: PolyhedralRule, rows: np.ndarray, offsets: np.ndarray, first: ArrayLike, modes: ArrayLike
) -> None:
    first, modes = np.asarray(first, np.int64), np.asarray(modes, np.int64)
    for array in (rows, offsets, first, modes):
        array.flags.writeable = False
    vars(rule).update(rows=rows, offsets=offsets, first=first, region_modes=modes)


_SYMMETRIC = 1e-12  # asymmetry of a matrix, relative to its largest entry


@dataclass(frozen=True, eq=False, init=False, repr=False)
class QuadraticRegions(Rule):
    r"""The mode whose quadratic form is the largest (max-switching).

    :math:`r(x) = \arg\max_i x^T S_i x`, the first one on a boundary. For min-switching, by the
    smallest form, give :math:`-S`.

    Parameters
    ----------
    S : array_like, shape (modes, n, n)
        A symmetric matrix per mode, no two of them alike.

    Raises
    ------
    ArgumentError
        If S is not of that shape, not finite, not symmetric, or two modes have the same form.

    References
    ----------
    arXiv 2603.20027 switches a plant with an input delay by two such forms (its example is in
    docs/theory/known-switching.md).

    Examples
    --------
    Mode 1 where :math:`|x_2| > |x_1|`:

    >>> rule = QuadraticRegions([[[1, 0], [0, -1]], [[-1, 0], [0, 1]]])
    >>> rule([3.0, -2.0]), rule([1.0, -2.0])
    (0, 1)
    """

    S: Float[np.ndarray, "mode n n"]

    def __init__(self, S: ArrayLike) -> None:
        S = real_array("S", S, "(modes, n, n)", 3)
        modes, n = S.shape[:2]
        if S.shape[2] != n:
            raise ArgumentError(
                f"S must have shape (modes, n, n), got {S.shape}: one square matrix per mode."
            )
        for i in range(modes):
            skew = np.abs(S[i] - S[i].T)
            if skew.max() > _SYMMETRIC * np.abs(S[i]).max():
                a, b = np.unravel_index(skew.argmax(), skew.shape)
                raise ArgumentError(
                    f"S[{i}] must be symmetric, got {S[i, a, b]:g} at ({a}, {b}) and "
                    f"{S[i, b, a]:g} at ({b}, {a}): (S + S.T) / 2 has the same form."
                )
        S = read_only(0.5 * (S + S.transpose(0, 2, 1)))
        for i in range(modes):
            for j in range(i):
                if np.array_equal(S[i], S[j]):
                    raise ArgumentError(
                        f"S[{i}] must differ from S[{j}]: where two forms are the same, the rule "
                        "does not say which mode is active."
                    )
        vars(self).update(S=S)

    def modes_of(self, states: Float[np.ndarray, "k n"]) -> Int[np.ndarray, " k"]:
        return np.einsum("ka,iab,kb->ki", states, self.S, states).argmax(axis=1)

    def require(self, plant: SwitchedSystem) -> Rule:
        modes, n = self.S.shape[:2]
        if (modes, n) != (plant.modes, plant.states):
            raise ArgumentError(
                f"rule must have one form in {plant.states} states for each of the plant's "
                f"{plant.modes} modes, got {modes} in {n}."
            )
        return self

    def motion(
        self, plant: SwitchedSystem, lengths: tuple[float, ...], unseen: int = 0
    ) -> RegionMotion:
        modes, n = self.S.shape[:2]
        # Region i has a boundary for every j ≠ i: xᵀ(S_j − S_i) x ≤ 0.
        others = [j for i in range(modes) for j in range(modes) if j != i]
        forms = self.S[others] - np.repeat(self.S, modes - 1, axis=0)
        forms = np.pad(forms, ((0, 0), (0, unseen), (0, unseen)))
        planes = np.zeros((len(others), n + unseen)), np.zeros(len(others))
        first, named = (modes - 1) * np.arange(modes + 1), np.arange(modes)
        regions = Regions(forms, *planes, first, named)

        def regions_of(states: np.ndarray) -> np.ndarray:
            return self.modes_of(states[:, :n])

        return RegionMotion.of(regions_of, plant.A, plant.B, regions, lengths, unseen)

    def same(self, other: Rule) -> bool:
        return isinstance(other, QuadraticRegions) and np.array_equal(self.S, other.S)

    def __repr__(self) -> str:
        modes, n = self.S.shape[:2]
        return f"QuadraticRegions(modes={modes}, states={n})"
