"""Regions by quadratic forms: the mode whose xᵀS_i x is largest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from deadtime.base.checks import read_only, real_array
from deadtime.base.errors import ArgumentError
from deadtime.plant import SwitchedSystem
from deadtime.switching.rules.region_motion import RegionMotion, Regions
from deadtime.switching.rules.rule import Rule

_SYMMETRIC = 1e-12  # of the largest entry of a matrix


@dataclass(frozen=True, eq=False, init=False, repr=False)
class QuadraticRegions(Rule):
    """The mode whose quadratic form is the largest, r(x) = argmax_i xᵀS_i x (max-switching).

    On a boundary it is the first of the largest. For the smallest form, as min-switching has it,
    give −S.

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
    Mode 1 where |x₂| > |x₁|:

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
