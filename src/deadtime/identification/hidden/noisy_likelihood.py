"""The likelihood of a log whose modes are hidden and whose sensors are noisy.

Exact, it is a sum over all paths, each with Kalman's filter of its own. Here all filters that lead
to a mode are mixed after every sample (`filters_kernel`), so that the modes' filters give densities
b_k of what every period leads to, and log L = log Σ_σ p(σ) Π b_k(σ_k, σ_{k+1}) as of exact states.
A period within which the mode changes from i to j does what a share f of i and the rest of j do, f
uniform, to first order in the period: with x_i and x_j where either alone would lead, its mean is
(x_i + x_j)/2, and its covariance that of i and j, halved and added, and (x_i − x_j)(x_i − x_j)ᵀ/12.

Derivatives are forward differences; the information is that of every sample's own score,

    F = Σ_k ∂ℓ_k ∂ℓ_kᵀ,    ℓ_k = log p(y_k | y_0 … y_{k−1}).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from deadtime.base.frozen import Frozen
from deadtime.identification.hidden.filters_kernel import filter_modes
from deadtime.identification.hidden.jumps import Jumps
from deadtime.identification.hidden.mode_periods import Posterior, path_of, posterior_of
from deadtime.identification.hidden.stretch import PartPeriods, stretch_of
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy.likelihood import NoiseLevels, NoisyLog
from deadtime.identification.parameters import Layout
from deadtime.identification.scoring import Evaluate, Evaluation

_SMALL = 1e-3  # of a standard error, a step of differences: what bends moves no maximum by more

Starts = list[Bool[np.ndarray, " sample"]]


@dataclass(frozen=True, eq=False)
class HiddenNoisyLog(Frozen):
    """The likelihood in the vector of a `NoisyLog`, the chain held.

    noisy : the same log with one mode; unit : standard errors of the vector, about
    within : whether the mode may change within periods
    """

    noisy: NoisyLog
    layout: Layout
    unit: Float[np.ndarray, " size"]
    jumps: Jumps
    within: bool
    _kept: dict[tuple[int, bytes], PartPeriods] = field(default_factory=dict, repr=False)

    @property
    def recording(self) -> Recording:
        """The log."""
        return self.noisy.recording

    @property
    def bounds(self) -> tuple[float, float]:
        """Of the delays, seconds."""
        return self.noisy.bounds

    @property
    def nodes(self) -> Float[np.ndarray, " node"]:
        """For predictions."""
        return self.noisy.nodes

    @property
    def whole(self) -> NoisyLog:
        """The layout of the vector; modes in it are those of the recording."""
        return replace(self.noisy, layout=self.layout)

    @property
    def most(self) -> Float[np.ndarray, " size"]:
        """Steps of noise beyond which differences tell little; of plants there are none."""
        most = self.unit.copy()
        most[: self.layout.size] = np.inf
        return most

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """What bounds unknowns, delays aside."""
        return self.whole.limits

    def noise(self, vector: Float[np.ndarray, " size"]) -> NoiseLevels:
        """W and the sensors' deviations of a vector."""
        return self.whole.noise(vector)

    def starts(self, low: float, high: float) -> Starts:
        """The samples before which nothing is known, for delays between two; of every part."""
        return self.noisy.starts(low, high)

    def filtered(
        self,
        vector: Float[np.ndarray, " size"],
        starts: Starts,
        cells: Int[np.ndarray, " delay"] | None = None,
    ) -> tuple[list[tuple[np.ndarray, np.ndarray]], Float[np.ndarray, " sample"]]:
        """Of every part the densities of all periods, stay and change; and what samples add."""
        A, B, delays = self.layout.split(vector[: self.layout.size])
        L, R, laid, gained = self.whole.root(vector), self.noise(vector).deviation ** 2, [], []
        own = None if cells is None or not cells.size else self.layout.spread(cells)
        for number, start in enumerate(starts):
            each = []
            for i in range(self.layout.modes):
                one = slice(i, i + 1)
                theta, in_cells = self.noisy.layout.join(A[one], B[one], delays[one]), None
                if own is not None:
                    in_cells = own[one]
                each.append(self._once(number, start, theta, L, in_cells))
            Phi, added, Q = (np.array(one) for one in list(zip(*each, strict=True))[1:])
            part = self.recording.parts[number]
            stay = np.empty((part.time.size - 1, self.layout.modes))
            move = np.empty((*stay.shape, self.layout.modes))
            adds = np.empty(part.time.size)
            given = (part.output, start, each[0].kind, Phi, added, Q, self.noisy.C)
            given = (*given, R, self.noisy.P0, *self.jumps.over(part.time))
            filter_modes(*map(np.ascontiguousarray, given), self.within, stay, move, adds)
            laid.append((stay, move))
            gained.append(adds)
        return laid, np.concatenate(gained)

    def _once(self, number: int, start: np.ndarray, *given: np.ndarray | None) -> PartPeriods:
        """`stretch_of` one mode; the last are kept: differences ask for few anew."""
        key = number, b"".join(one.tobytes() for one in (start, *given) if one is not None)
        if key not in self._kept:
            if len(self._kept) > 4 * self.layout.modes * len(self.recording.parts):
                self._kept.clear()
            self._kept[key] = stretch_of(self.noisy, number, start, *given)  # pyright: ignore[reportArgumentType]
        return self._kept[key]

    def posterior(
        self,
        vector: Float[np.ndarray, " size"],
        starts: Starts,
        cells: Int[np.ndarray, " delay"] | None = None,
    ) -> Posterior:
        """What the log says of the modes; its weights are of all periods."""
        laid, gained = self.filtered(vector, starts, cells)
        parts = self.recording.parts
        every = [np.arange(part.time.size - 1) for part in parts]
        found = posterior_of(parts, laid, self.jumps, every, self.within)
        return found._replace(value=float(gained.sum()))

    def path(
        self, vector: Float[np.ndarray, " size"], starts: Starts
    ) -> list[Int[np.ndarray, " sample"]]:
        """The likeliest modes of the samples of every part."""
        return path_of(self.recording.parts, self.filtered(vector, starts)[0], self.jumps)

    def value(
        self,
        vector: Float[np.ndarray, " size"],
        starts: Starts,
        cells: Int[np.ndarray, " delay"] | None = None,
    ) -> float:
        """The log likelihood."""
        return float(self.filtered(vector, starts, cells)[1].sum())

    def evaluate(
        self,
        vector: Float[np.ndarray, " size"],
        starts: Starts,
        cells: Int[np.ndarray, " delay"] | None = None,
    ) -> Evaluation:
        """The log likelihood, its score, and the information of samples' own scores."""
        size = vector.size
        with np.errstate(all="ignore"):
            now = self.filtered(vector, starts, cells)[1]
            if not np.isfinite(now).all():
                return Evaluation(-np.inf, np.zeros(size), np.eye(size))
            slope = np.empty((size, now.size))
            for a in range(size):
                step = np.zeros(size)
                step[a] = _SMALL * self.unit[a]
                slope[a] = (self.filtered(vector + step, starts, cells)[1] - now) / step[a]
        if not np.isfinite(slope).all():
            return Evaluation(-np.inf, np.zeros(size), np.eye(size))
        return Evaluation(float(now.sum()), slope.sum(axis=1), slope @ slope.T)

    def evaluate_in(self, low: float, high: float) -> Callable[[np.ndarray], Evaluate]:
        """The likelihood for delays between two, seconds; of even rows in cells of theirs."""
        starts = self.starts(low, high)
        return lambda cells: lambda vector: self.evaluate(vector, starts, cells)
