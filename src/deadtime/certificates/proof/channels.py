"""The matrices of ξ⁺ = M₀ ξ + B w, v = C ξ + D w, in floats: every entry is exact but E₀ D."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.certificates.proof.evidence import Centre, Setting


@dataclass(frozen=True, eq=False)
class Channels:
    """C (v, d), D (v, w), and [M₀ B]'s first n + o rows as a product: top = left · right.

    top ζ = (x⁺, the law's outputs) of ζ = (ξ, w); all entries of `left` and `right` are entries of
    the centre, ones and zeros.
    """

    C: Float[np.ndarray, "v order"]
    D: Float[np.ndarray, "v w"]
    left: Float[np.ndarray, "top inner"]
    right: Float[np.ndarray, "inner dw"]

    @classmethod
    def of(cls, setting: Setting, centre: Centre) -> Channels:
        """Lay out the channels of a centre."""
        n, o, d = setting.states, setting.outputs, setting.order
        reads = setting.family.reads
        w = n + o * setting.rows_differ
        k = n + len(reads)
        C, D = np.zeros((k, d)), np.zeros((k, w))
        C[:n, :n] = np.eye(n)
        for place, (lag, j) in enumerate(reads, n):
            at = setting.input_at(lag, j)
            if lag:
                C[place, at] = 1.0
            else:
                C[place] = centre.row[at]
                D[place, n:] = np.eye(o)[at, : w - n]
        # (x⁺, (w⁺, u)) = [E₀ I 0; 0 0 I] (y, w_x, row₀ ξ + w_u)
        left, right = np.zeros((n + o, k + n + o)), np.zeros((k + n + o, d + w))
        left[:n, :k], left[:n, k : k + n], left[n:, k + n :] = centre.E, np.eye(n), np.eye(o)
        right[:k, :d], right[:k, d:] = C, D
        right[k : k + n, d : d + n] = np.eye(n)
        right[k + n :, :d] = centre.row
        right[k + n :, d + n :] = np.eye(o)[:, : w - n]
        more = np.concatenate((C, centre.R, centre.Psi))
        return cls(more, np.concatenate((D, np.zeros((len(more) - k, w)))), left, right)

    @property
    def wide(self) -> Float[np.ndarray, "vw dw"]:
        """Y = [C D; 0 I], from ζ to (v, w)."""
        w = self.D.shape[1]
        bottom = np.concatenate((np.zeros((w, self.C.shape[1])), np.eye(w)), axis=1)
        return np.concatenate((np.concatenate((self.C, self.D), axis=1), bottom))

    def shift(self, m: int) -> Float[np.ndarray, "order dw"]:
        """[M₀ B]."""
        d = self.C.shape[1]
        top = self.left @ self.right
        result = np.zeros((d, top.shape[1]))
        result[: len(top)] = top
        keep = d - len(top)
        n = len(top) - m
        result[len(top) :, n : n + keep] = np.eye(keep)
        return result
