"""SampledPlant: a plant at a sampling period, as the pieces in which nothing that acts changes.

An input u_k is held from t_k = k h on and reaches the plant a delay later, so within a period
different samples of it act one after the other. A *piece* is a stretch of a period in which the
mode and all acting inputs stay; its lags say how many samples before the period's own they were
computed. With one delay there are two, N = ⌈D/h⌉ and φ = D − (N − 1) h (`deadtime.plant.steps`),

    [t_k, t_k + φ):      u_{k−N}            lag N
    [t_k + φ, t_{k+1}):  u_{k−N+1}          lag N − 1, none of these where φ = h

and over a whole period, with the pieces' Φ and Γ,

    x_{k+1} = Φ x_k + Σ_l Γ_l u_{k−l},    l over the lags of all pieces.

Whoever needs to know what acts when reads pieces or periods, and works out neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.base.frozen import Frozen
from deadtime.plant.steps import Window
from deadtime.plant.switched_system import SwitchedSystem


class Stretch(NamedTuple):
    """Seconds from the sample on between which input j is the one of `lag[j]` samples ago."""

    start: float
    stop: float
    lag: Int[np.ndarray, " m"]


class Piece(NamedTuple):
    """What a stretch does to the state: x goes to Phi x + Gamma u, u the inputs that act."""

    Phi: Float[np.ndarray, "n n"]
    Gamma: Float[np.ndarray, "n m"]
    stretch: Stretch


class Period(NamedTuple):
    """What a whole period does: x_{k+1} = Phi x_k + Σ_l Gamma[l] u_{k−lags[l]}, oldest first."""

    Phi: Float[np.ndarray, "n n"]
    Gamma: Float[np.ndarray, "lag n m"]
    lags: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class SampledPlant(Frozen):
    """A plant at a sampling period, its modes held over whole periods (immutable).

    Attributes
    ----------
    plant : SwitchedSystem
    step : float
        Sampling period h, seconds.

    Examples
    --------
    >>> plant = SwitchedSystem([[[0.0]]], [[[1.0]]], delay=0.27)
    >>> for piece in SampledPlant(plant, 0.1).pieces(0):
    ...     print(round(piece.Gamma.item(), 12), piece.stretch.lag)
    0.07 [3]
    0.03 [2]
    >>> SampledPlant(plant, 0.1).period(0).lags
    (3, 2)
    """

    plant: SwitchedSystem
    step: float

    @cached_property
    def window(self) -> Window:
        """The inputs in flight."""
        return Window.of_plant(self.plant, self.step)

    @property
    def longest_lag(self) -> int:
        """N: no input older than u_{k−N} acts in period k."""
        return self.window.count

    def stretches(self, mode: int) -> tuple[Stretch, ...]:
        """The stretches of a period in which a mode is held, in order."""
        window, m = self.window, self.plant.inputs
        older, newer = (
            read_only(np.full(m, lag, np.int64)) for lag in (window.count, window.count - 1)
        )
        if window.phase >= window.step:
            return (Stretch(0.0, window.step, older),)
        return (
            Stretch(0.0, window.phase, older),
            Stretch(window.phase, window.step, newer),
        )

    def pieces(self, mode: int) -> tuple[Piece, ...]:
        """The pieces of a period in which a mode is held, in order."""
        from deadtime.numerics.exponential import held

        A, B = self.plant.A[mode], self.plant.B[mode]
        pieces = []
        for part in self.stretches(mode):
            Phi, Gamma = held(A, B, part.stop - part.start)
            pieces.append(Piece(read_only(Phi), read_only(Gamma), part))
        return tuple(pieces)

    def period(self, mode: int) -> Period:
        """A whole period in which a mode is held."""
        n, m = self.plant.B.shape[1:]
        first, *others = self.pieces(mode)
        Phi, Gamma = first.Phi, _by_lag(first)
        for piece in others:
            Phi = piece.Phi @ Phi
            Gamma = {lag: piece.Phi @ arrived for lag, arrived in Gamma.items()}
            for lag, arriving in _by_lag(piece).items():
                Gamma[lag] = Gamma.get(lag, np.zeros((n, m))) + arriving
        lags = tuple(sorted(Gamma, reverse=True))
        return Period(read_only(Phi), read_only(np.stack([Gamma[lag] for lag in lags])), lags)


def _by_lag(piece: Piece) -> dict[int, Float[np.ndarray, "n m"]]:
    """Γ of a piece, the columns of inputs of the same lag together."""
    lags = piece.stretch.lag
    return {int(lag): np.where(lags == lag, piece.Gamma, 0.0) for lag in np.unique(lags)}


def acting(
    lag: Int[np.ndarray, " m"], inputs: Sequence[np.ndarray] | np.ndarray
) -> Float[np.ndarray, " m"]:
    """The inputs that act in a piece; `inputs` are u_k, u_{k−1}, …, the latest first.

    Examples
    --------
    >>> acting(np.array([2, 0]), np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]))
    array([5., 2.])
    """
    return np.array([inputs[k][j] for j, k in enumerate(lag)])
