"""What a law remembers of its past inputs, as windows, and their Laplace transform.

With one mode held, a law updated continuously is

    u(t) = F x(t) + Σ_p C_p ∫ e^{S_p (τ − α_p)} R_p u(t − τ) dτ,    τ from α_p to β_p.

A `Functional` says so itself, and a `Forecast` what it has settled to.

    W(s) = Σ_p W_p(s),    W_p(s) = C_p ∫ e^{S_p (τ − α_p)} e^{−sτ} dτ R_p
         = C_p (sI − S_p)⁻¹ (e^{−sα_p} − e^{−sβ_p} e^{S_p (β_p − α_p)}) R_p,

an entire function of s: where sI − S_p is singular the integral is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Forecast, Functional

# A Gauss panel of so many nodes integrates e^{at} to round-off for |a| · length ≤ _RATE.
_NODES, _RATE = 16, 8.0
_MOST_PANELS = 100_000


class LawWindow(NamedTuple):
    """One window of a law on its past inputs.

    C : (m, q), S : (q, q), R : (q, m);  near, far : α ≤ β, seconds;
    ending : (m, q), C e^{S (β − α)}
    """

    C: np.ndarray
    S: np.ndarray
    R: np.ndarray
    near: float
    far: float
    ending: np.ndarray

    @classmethod
    def balanced(
        cls, C: np.ndarray, S: np.ndarray, R: np.ndarray, near: float, far: float
    ) -> LawWindow:
        """A window in balanced states."""
        from deadtime.numerics.exponential import balance, discretise

        r = balance(S)
        C, S, R = C * r, S * r / r[:, None], R / r[:, None]
        return cls(C, S, R, near, far, C @ discretise(S, R, far - near)[0])

    def transform(
        self, s: Complex[np.ndarray, " point"]
    ) -> tuple[Complex[np.ndarray, "point m m"], Complex[np.ndarray, "point m m"]]:
        """W_p(s) and its slope, far from the eigenvalues of S."""
        at = s[:, None, None]
        shifted = at * np.eye(self.S.shape[0]) - self.S
        once = np.linalg.solve(shifted, np.broadcast_to(self.R + 0j, (s.size, *self.R.shape)))
        twice = np.linalg.solve(shifted, once)
        early, late = np.exp(-at * self.near), np.exp(-at * self.far)
        slope = late * (self.ending @ (self.far * once + twice))
        slope -= early * (self.C @ (self.near * once + twice))
        return early * (self.C @ once) - late * (self.ending @ once), slope


def windows_of(
    law: Functional | Forecast, units: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "m n"], tuple[LawWindow, ...]]:
    """F, of a state x in units of its own, and the windows of a law with its mode held."""
    held = law.settled
    row = int(held.row(np.zeros(1))[0])
    pieces = zip(held.C[row], held.S, held.R, held.near.tolist(), held.far.tolist(), strict=True)
    return held.F[row] * units, tuple(LawWindow.balanced(*piece) for piece in pieces)


def weights(
    windows: Sequence[LawWindow], rate: float
) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, "node m m"]]:
    """τ_j and the taps that integrate all windows against functions of a rate in 1/s.

    W(s) = Σ_j e^{−sτ_j} taps_j to round-off for |s| ≤ `rate`, with |S| allowed for in it.
    """
    m = windows[0].C.shape[0]
    parts = [(np.empty(0), np.empty((0, m, m)))]
    parts += [_weights(window, rate) for window in windows if window.far > window.near]
    tau, taps = zip(*parts, strict=True)
    return np.concatenate(tau), np.concatenate(taps)


def _weights(window: LawWindow, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """The nodes of one window, and their taps."""
    from deadtime.numerics.exponential import discretise

    S, R, whole_length = window.S, window.R, window.far - window.near
    if not rate * whole_length <= _RATE * _MOST_PANELS:
        raise ArgumentError(
            f"delay must be shorter for characteristic roots: the loop's fastest rate times the "
            f"delay is {rate * whole_length:.3g}, and at most {_RATE * _MOST_PANELS:.0g} is "
            "possible."
        )
    panels = int(np.ceil(rate * whole_length / _RATE)) + 1
    length = whole_length / panels
    z, weight = np.polynomial.legendre.leggauss(_NODES)
    first = (z + 1.0) / 2.0 * length
    inside = (
        np.stack([discretise(S, R, t)[0] @ R for t in first])
        * (weight / 2.0 * length)[:, None, None]
    )
    whole, row, taps = discretise(S, R, length)[0], window.C, []
    for _ in range(panels):
        taps.append(row @ inside)
        row = row @ whole
    tau = window.near + (np.arange(panels)[:, None] * length + first).ravel()
    return tau, np.concatenate(taps)
