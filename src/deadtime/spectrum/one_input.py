"""One input's delay varied, the others' as they are: the loop closed but for that input.

With the columns p_k of the delay line of all other inputs at their own delays, a root lies on the
limit of stability (`deadtime.spectrum.response`) where M − r p is singular,

    M − r p = M_j − r p_j e_jᵀ,    M_j = M − Σ_{k≠j} r p_k e_kᵀ,

and det(M_j − r p_j e_jᵀ) = det M_j (1 − r_j p_j) with r_j = e_jᵀ M_j⁻¹ r: the loop gain at input j
is a number, r_j p_j.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.numerics.small_matrices import inverses, traces
from deadtime.spectrum.response import LoopResponse, Response, Samples


@dataclass(frozen=True, eq=False)
class OneInput(Response):
    """A loop as a function of one input's delay (immutable).

    Attributes
    ----------
    whole : LoopResponse
    nominal : float
        The delay at which the `whole` has all its inputs' own, seconds.
    number : int
        j.
    offset : float
        By how much the delay of input j is longer than the one that is varied, seconds.
    """

    whole: LoopResponse
    nominal: float
    number: int
    offset: float

    @property
    def memory(self) -> float:
        return self.whole.memory + self.nominal + self.offset

    @property
    def highest(self) -> float:
        return self.whole.highest

    @property
    def cuts(self) -> Float[np.ndarray, " cut"]:
        return self.whole.cuts

    @property
    def period(self) -> float | None:
        return self.whole.period

    def samples(self, omega: np.ndarray, even: bool = False) -> Samples:
        loop, j = self.whole.samples(omega, even), self.number
        p, p_slope, _ = self.whole.delay_line(omega, np.array([self.nominal]))
        p[:, :, j] = p_slope[:, :, j] = 0.0
        M_slope = loop.M_slope - loop.r_slope @ p - loop.r @ p_slope
        inverse = inverses(loop.M - loop.r @ p)
        r = inverse @ loop.r
        r_slope = (inverse @ (loop.r_slope - M_slope @ r))[:, j : j + 1]
        # det M_j and det M_j · r_j for M and r would do as well. Scaled to M = 1 at every
        # frequency they have the same poles and zeros, and floats hold them.
        rate = traces(inverse, M_slope)[:, None, None]
        r = r[:, j : j + 1]
        return Samples(omega, loop.plant, np.ones_like(rate), rate, r, r_slope + rate * r)

    def delay_line(
        self, omega: np.ndarray, delay: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.whole.arriving(slice(self.number, self.number + 1), omega, delay + self.offset)
