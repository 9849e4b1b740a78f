"""How a log differs from an identified plant: in its gain, its delay, or its level.

Errors a row ahead are linear in B and in constant terms. With the delays D + δ of a log of its own,

    e(δ, γ, c) = e(δ) + Σ_j γ_j ∂e/∂γ_j + Σ_a c_a ∂e/∂c_a,    B_j → (1 + γ_j) B_j,

so that γ and c are a linear regression and δ is searched on a grid. The plant itself is known with
a covariance Σ only: e has the further regressors ∂e/∂θ L w, Σ = L Lᵀ, with w normal of variance 1,
which adds |w|² to the sum of squares. Of N whitened errors with a sum of squares q, 2 log L is
−N log q. Of the eight subsets of (gain, delay, level) the one is chosen whose rise is largest, less
the χ² quantile of one degree of freedom for each of its unknowns. Errors that are not white have
fewer degrees of freedom: the rise is divided by 1 + 2 Σ |r| of their correlations.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.wording import amount
from deadtime.identification.estimate import Estimate
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import SHORTEST, SensorMatrix, Window
from deadtime.identification.predictor import Predictor
from deadtime.identification.residuals import CHANCE, autocorrelation

_FEW = 4_000  # rows of a log that are compared
_GRID = 17  # delays over the range searched
_NEAR = np.array([-2.0, -1.0, -0.5, 0.5, 1.0, 2.0])  # periods from the delay, which are tried, too
_FINE = 1e-2  # of a period: accuracy of the delay that is found
_SUBSETS = 7
_LEAST = 3  # rows per unknown
_SURE = 3.0  # standard errors of a correlation that counts
ROUND_OFF = 1e-9  # of an output's deviation: smaller errors are round-off
_FAR = 4.0  # ratio of variances from which errors count as far larger
_SINGULAR = 1e8  # condition number of A beyond which there is no rest


class Difference(NamedTuple):
    """Differences of a log from the model; None where there is none.

    gain : (m,), factors of B; delay : added to all, seconds
    level : (modes, n), added to dx/dt; offset : (p,), of the outputs, if it is that of a rest
    share : of the sum of squared errors that it explains
    """

    gain: Float[np.ndarray, " m"] | None
    delay: float | None
    level: Float[np.ndarray, "mode n"] | None
    offset: Float[np.ndarray, " p"] | None
    share: float

    def applied(self, predictor: Predictor) -> Predictor:
        """The predictor with this difference in its plant."""
        own = predictor.with_constant()
        layout, theta = own.log.layout, own.vector.copy()
        if self.gain is not None:
            theta[layout.of_B[:, :, : layout.m]] *= self.gain
        if self.delay is not None:
            theta[layout.at_delays] += self.delay
        if self.level is not None:
            theta[layout.of_B[:, :, layout.m]] += self.level
        return replace(own, vector=theta)

    def words(self, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> str:
        """The differences as a list in words."""
        words = []
        if self.gain is not None:
            of = [f"of {name} " if inputs[1:] else "" for name in inputs]
            each = (f"{round(float(one), 6):.3g}".replace("-", "−") for one in self.gain)
            words += [f"its gain {j}is {g} times as large" for j, g in zip(of, each, strict=True)]
        if self.delay is not None:
            more = "longer" if self.delay > 0.0 else "shorter"
            words.append(f"its delay is {amount(abs(self.delay))} s {more}")
        if self.offset is not None:
            each = zip(outputs, self.offset, strict=True)
            parts = [f"{f'{v:+.3g}'.replace('-', '−')} in {name}" for name, v in each]
            words.append(f"its level is off by {', '.join(parts)}")
        elif self.level is not None:
            words.append("a constant load acts on it")
        return ", ".join(words[:-1]) + (" and " if words[1:] else "") + words[-1]


def difference_of(predictor: Predictor, inflation: float, logs: int = 1) -> Difference | None:
    """The significant differences of a recording, one of several logs; None if there is none.

    inflation : of 2 log L by errors that are not white
    """
    from scipy.stats import chi2

    own = predictor.with_constant()
    (low, high), h, D = own.log.bounds, own.log.recording.step, own.model.plant.delays
    ends = min(0.0, max(low, SHORTEST * h) - float(D.min())), max(0.0, high - float(D.max()))
    near = np.clip(_NEAR * h, *ends)
    shifts = np.unique(np.concatenate((np.linspace(*ends, _GRID), near, [0.0])))
    regressions = _Regressions.of(predictor, own, shifts)
    if regressions is None:
        return None
    m, ways = own.log.layout.m, regressions.ways
    each = float(chi2.isf(CHANCE / (_SUBSETS * logs), 1))
    base, best, chosen = regressions.least((0.0,), False, False)[0], 0.0, None
    for gain, shifted, level in product((False, True), repeat=3):
        free = m * gain + shifted + len(ways.terms) * level
        value, shift, beta = regressions.least(shifts if shifted else (0.0,), gain, level)
        if shifted:
            value, shift, beta = regressions.least_near(shift, shifts, gain, level)
        rise = (base - value) / inflation - free * each
        if not free or rise <= best:
            continue
        factors, best = 1.0 + beta[: m * gain], rise
        chosen = Difference(
            factors if gain else None,
            shift if shifted else None,
            np.tensordot(beta[m * gain :], ways.terms, 1) if level else None,
            beta[m * gain :] @ ways.offsets if level and ways.offsets is not None else None,
            -float(np.expm1((value - base) / regressions.errors)),
        )
    return chosen


class _Levels(NamedTuple):
    """Constant terms of levels of their own, and the outputs' offsets that they make at rest.

    Where every mode has one rest, a level is an offset of an output, c_i = −A_i δ; otherwise it is
    a load on a state.
    """

    terms: Float[np.ndarray, "some mode n"]
    offsets: Float[np.ndarray, "some p"] | None

    @classmethod
    def of(cls, own: Predictor) -> _Levels:
        A, C, n = own.model.plant.A, own.log.C, own.log.layout.n
        if np.linalg.cond(A).max() < _SINGULAR:
            ways = np.eye(n) if own.log.embedding is None else C
            return cls(-np.einsum("iab,sb->sia", A, ways), ways @ C.T)
        return cls(np.tile(np.eye(n)[own.log.acting, None], (1, len(A), 1)), None)


class _Regressions:
    """Regressions of a recording's errors on gains and levels, at shifts of the delays.

    They use the rows that have errors at all shifts.
    """

    def __init__(self, own: Predictor, window: Window) -> None:
        self.own, self.window, self.good = own, window, np.ones(own.log.recording.rows, bool)
        self.kept: dict[float, tuple[np.ndarray, np.ndarray]] = {}
        self.products: dict[float, tuple[np.ndarray, np.ndarray]] = {}
        size = np.nanstd(np.vstack([part.output for part in own.parts]), axis=0)
        floor = (ROUND_OFF * size) ** 2 if own.exact else np.zeros(size.size)
        self.floor = np.diag(np.maximum(floor, np.finfo(float).tiny))
        self.ways = _Levels.of(own)
        self.root, self.by_plant = np.eye(size.size), np.zeros((0, 0))

    @classmethod
    def of(
        cls, plain: Predictor, own: Predictor, shifts: Float[np.ndarray, " shift"]
    ) -> _Regressions | None:
        """The regressions, or None if rows are too few."""
        D, p = own.model.plant.delays, len(own.log.C)
        result = cls(own, (float(D.min() + shifts[0]), float(D.max() + shifts[-1])))
        for shift in (shifts[0], shifts[-1], 0.0):
            result.good &= np.isfinite(result.rows(float(shift))[0]).all(axis=1)
        fed = own.log.sampling.fed
        each = [np.append(False, fed(part, *result.window[::-1])) for part in own.parts]
        result.good &= np.concatenate(each)
        if result.good.sum() <= _LEAST * (own.log.layout.m + len(result.ways.terms) + 1 + p):
            return None
        e = result.rows(0.0)[0][result.good]
        result.root = np.linalg.cholesky(e.T @ e / len(e) + result.floor)
        by = np.linalg.solve(result.root, plain.error_of_plant(result.window)[result.good])
        by = by.reshape(e.size, -1)
        result.by_plant = np.linalg.qr(np.vstack((by, np.eye(by.shape[1]))))[0][: e.size]
        return result

    @property
    def errors(self) -> int:
        """The number of errors in a sum of squares."""
        return int(self.good.sum()) * len(self.own.log.C)

    def rows(self, shift: float) -> tuple[np.ndarray, np.ndarray]:
        """Errors (samples, p) and their derivatives (samples, p, gains and levels)."""
        if shift not in self.kept:
            own, layout = self.own, self.own.log.layout
            vector = own.vector.copy()
            vector[layout.at_delays] += shift
            e, by = own.errors(vector, self.window), []
            for j in range(layout.m):
                moved = vector.copy()
                moved[layout.of_B[:, :, j]] *= 2.0
                by.append(own.errors(moved, self.window) - e)
            for terms in self.ways.terms:
                moved = vector.copy()
                moved[layout.of_B[:, :, layout.m]] += terms
                by.append(own.errors(moved, self.window) - e)
            self.kept[shift] = e, np.stack(by, axis=-1)
        return self.kept[shift]

    def least(
        self, shifts: Iterable[float], gain: bool, level: bool
    ) -> tuple[float, float, Float[np.ndarray, " free"]]:
        """Of several shifts the least −2 log L, up to a constant; the shift; gains and levels."""
        each = ((*self._left(float(shift), gain, level), float(shift)) for shift in shifts)
        value, beta, shift = min(each, key=lambda one: one[0])
        return value, shift, beta

    def least_near(
        self, shift: float, shifts: Float[np.ndarray, " shift"], gain: bool, level: bool
    ) -> tuple[float, float, Float[np.ndarray, " free"]]:
        """The least value between the neighbours of one of the shifts."""
        from scipy.optimize import minimize_scalar

        at = int(np.flatnonzero(shifts == shift)[0])
        found: Any = minimize_scalar(
            lambda one: self._left(one, gain, level)[0],
            bounds=(shifts[max(at - 1, 0)], shifts[min(at + 1, len(shifts) - 1)]),
            method="bounded",
            options={"xatol": _FINE * self.own.log.recording.step},
        )
        return self.least((shift, float(found.x)), gain, level)

    def _left(self, shift: float, gain: bool, level: bool) -> tuple[float, np.ndarray]:
        m, (products, unit) = self.own.log.layout.m, self._products(shift)
        own = 1 + np.r_[np.arange(m * gain), np.arange(m, unit.size if level else m)]
        beta = -np.linalg.lstsq(products[np.ix_(own, own)], products[own, 0], rcond=1e-12)[0]
        floor = np.linalg.solve(self.root, np.linalg.solve(self.root, self.floor).T)
        square = max(float(products[0, 0] + products[0, own] @ beta), 0.0)
        square += float(np.trace(floor)) * self.errors / len(self.root)
        return self.errors * float(np.log(square)), beta / unit[own - 1]

    def _products(self, shift: float) -> tuple[np.ndarray, np.ndarray]:
        """Inner products of errors and derivatives, less their part in the plant's; and units.

        `by_plant` has orthonormal columns, with the rows of w below them cut off.
        """
        if shift not in self.products:
            e, by = (one[self.good] for one in self.rows(shift))
            z = np.linalg.solve(self.root, e.T).T.reshape(-1, 1)
            X = np.linalg.solve(self.root, by).reshape(z.size, -1)
            unit = np.linalg.norm(X, axis=0)
            unit[unit == 0.0] = 1.0  # where squares underflow, too
            both = np.hstack((z, X / unit))
            inside = self.by_plant.T @ both
            self.products[shift] = both.T @ both - inside.T @ inside, unit
        return self.products[shift]


def inflation_of(white: list[Float[np.ndarray, "sample p"]]) -> float:
    """By how much 2 log L of errors that are not white exceeds its χ²: 1 + 2 Σ |r|."""
    r, count = autocorrelation(white)
    sure = np.abs(r) * np.sqrt(np.maximum(count, 1.0))[:, None] > _SURE
    return 1.0 + 2.0 * float(np.where(sure, np.abs(r), 0.0).sum(axis=0).max())


def contradictions(
    estimate: Estimate, C: SensorMatrix, recording: Recording
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Sentences and doubts on logs, fitted together, that contradict one another."""
    from scipy.stats import f

    each = recording.by_log
    if len(each) < 2:
        return (), ()
    log = np.repeat(np.arange(len(each)), [len(parts) for parts in each])
    total = np.bincount(log, [np.nansum(one**2) for one in estimate.white])
    number = np.bincount(log, [np.isfinite(one).sum() for one in estimate.white])
    mean = total / np.maximum(number, 1)
    inflation, found = inflation_of(list(estimate.white)), []
    for parts, size in zip(each, mean, strict=True):
        name = recording.logs[parts[0].log]
        own = recording._replace(parts=parts).stretches(_FEW, recording.lag(estimate.searched[1]))
        predictor = Predictor.of(estimate, C, own)
        difference = difference_of(predictor, inflation, len(each))
        if difference is not None:
            words = difference.words(recording.inputs, recording.outputs)
            found.append((difference.share * size, name, words))
    if found:
        _, name, words = max(found)
        return (
            f"The logs contradict one another: of {name}, compared with the plant of all, {words} "
            f"(likelihood ratio, level {CHANCE:g}). Identify it alone, or leave it out.",
        ), ("the logs contradict one another",)
    others = (total.sum() - total) / np.maximum(number.sum() - number, 1)
    ratio = mean / np.maximum(others, np.finfo(float).tiny)
    worst = int(np.argmax(ratio))
    free = number / inflation
    chance = f.sf(ratio[worst], max(free[worst], 1.0), max(free.sum() - free[worst], 1.0))
    if ratio[worst] < _FAR or chance > CHANCE / len(each):
        return (), ()
    name, times = recording.logs[worst], float(np.sqrt(ratio[worst]))
    return (
        f"The logs contradict one another: errors a row ahead in {name} are {times:.2g} times "
        f"those in the others (F test, level {CHANCE:g}): its noise or its plant is another one. "
        "Identify it alone, or leave it out.",
    ), ("the logs contradict one another",)
