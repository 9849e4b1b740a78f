"""How a log differs from an identified plant: in its gain, its delay, or its level.

Errors a row ahead are linear in B and in constant terms. With the delays D + δ of a log of its own,

    e(δ, γ, c) = e(δ) + Σ_j γ_j ∂e/∂γ_j + Σ_a c_a ∂e/∂c_a,    B_j → (1 + γ_j) B_j,

so that γ and c are a linear regression and δ is searched on a grid. The plant itself is known with
a covariance Σ only: e has the further regressors ∂e/∂θ L w, Σ = L Lᵀ, with w normal of variance 1,
which adds |w|² to the sum of squares. Of N whitened errors with a sum of squares q, 2 log L is
−N log q. Of the eight subsets of (gain, delay, level) the one is chosen whose rise exceeds its χ²
quantile by most; it is empty where none does. Errors that are not white have fewer degrees of
freedom: the rise is divided by 1 + 2 Σ |r| of their correlations.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.wording import amount
from deadtime.identification.estimate import Estimate
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import SensorMatrix, Window
from deadtime.identification.predictor import Predictor
from deadtime.identification.residuals import autocorrelation

CHANCE = 1e-3  # significance level of a difference, and of larger errors
_FEW = 4_000  # rows of a log that are compared
_GRID = 17  # delays over the range searched
_NEAR = np.array([-2.0, -1.0, -0.5, 0.5, 1.0, 2.0])  # periods from the delay, which are tried, too
_FINE = 9  # delays between the neighbours of the best one
_SUBSETS = 7
_LEAST = 3  # rows per unknown
_SHORTEST = 1e-6  # of a period: the shortest delay
_SURE = 3.0  # standard errors of a correlation that counts
_ROUND_OFF = 1e-9  # of an output's deviation: smaller errors are round-off
_FAR = 4.0  # ratio of variances from which errors count as far larger
_SINGULAR = 1e8  # condition number of A beyond which there is no rest


class Difference(NamedTuple):
    """What differs in a log; None where it does not.

    gain : (m,), factors of B; delay : added to all, seconds; level : (n,), added to dx/dt
    rise : of 2 log L, beyond the threshold of its χ² quantile
    """

    gain: Float[np.ndarray, " m"] | None
    delay: float | None
    level: Float[np.ndarray, " n"] | None
    rise: float

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

    def words(self, predictor: Predictor, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> str:
        """What differs, as a list in words."""
        words = []
        if self.gain is not None:
            each = zip(inputs, self.gain, strict=True)
            of = [f"of {name} " if len(inputs) > 1 else "" for name in inputs]
            words += [f"its gain {of[j]}is {g:.3g} times as large" for j, (_, g) in enumerate(each)]
        if self.delay is not None:
            more = "longer" if self.delay > 0.0 else "shorter"
            words.append(f"its delay is {amount(abs(self.delay))} s {more}")
        if self.level is not None:
            A = predictor.model.plant.A
            level = "its level is another one"
            if len(A) == 1 and np.linalg.cond(A[0]) < _SINGULAR:
                off = -predictor.log.C @ np.linalg.solve(A[0], self.level)
                each = zip(outputs, off, strict=True)
                parts = [f"{f'{v:+.3g}'.replace('-', '−')} in {name}" for name, v in each]
                level = f"its level is off by {', '.join(parts)}"
            words.append(level)
        return ", ".join(words[:-1]) + (" and " if words[1:] else "") + words[-1]


def difference_of(predictor: Predictor, inflation: float, logs: int = 1) -> Difference | None:
    """What differs significantly in a recording, one of several logs; None if nothing does.

    inflation : of 2 log L by errors that are not white
    """
    from scipy.stats import chi2

    own = predictor.with_constant()
    (low, high), h, D = own.log.bounds, own.log.recording.step, own.model.plant.delays
    ends = min(0.0, max(low, _SHORTEST * h) - float(D.min())), max(0.0, high - float(D.max()))
    near = np.clip(_NEAR * h, *ends)
    shifts = np.unique(np.concatenate((np.linspace(*ends, _GRID), near, [0.0])))
    regressions = _Regressions.of(predictor, own, shifts)
    if regressions is None:
        return None
    m, acting = own.log.layout.m, own.log.acting
    base, best, chosen = regressions.least((0.0,), False, False)[0], 0.0, None
    for gain, shifted, level in product((False, True), repeat=3):
        free = m * gain + shifted + acting.size * level
        value, shift, beta = regressions.least(shifts if shifted else (0.0,), gain, level)
        rise = (base - value) / inflation - float(
            chi2.isf(CHANCE / (_SUBSETS * logs), max(free, 1))
        )
        if not free or rise <= best:
            continue
        if shifted:
            at = int(np.flatnonzero(shifts == shift)[0])
            around = np.linspace(
                shifts[max(at - 1, 0)], shifts[min(at + 1, len(shifts) - 1)], _FINE
            )
            _, shift, beta = regressions.least(around, gain, level)
        c = np.zeros(own.log.layout.n)
        c[acting] = beta[m * gain :] if level else 0.0
        factors, best = 1.0 + beta[: m * gain], rise
        chosen = Difference(
            factors if gain else None, shift if shifted else None, c if level else None, rise
        )
    return chosen


class _Regressions:
    """Regressions of a recording's errors on gains and levels, at shifts of the delays.

    They use the rows that have errors at all shifts.
    """

    def __init__(self, own: Predictor, window: Window) -> None:
        self.own, self.window, self.good = own, window, np.ones(own.log.recording.samples, bool)
        self.kept: dict[float, tuple[np.ndarray, np.ndarray]] = {}
        size = np.nanstd(np.vstack([part.output for part in own.parts]), axis=0)
        floor = (_ROUND_OFF * size) ** 2 if own.exact else np.zeros(size.size)
        self.floor = np.diag(np.maximum(floor, np.finfo(float).tiny))
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
        if result.good.sum() <= _LEAST * (own.log.layout.m + own.log.acting.size + 1 + p):
            return None
        e = result.rows(0.0)[0][result.good]
        result.root = np.linalg.cholesky(e.T @ e / len(e) + result.floor)
        by = np.linalg.solve(result.root, plain.error_of_plant(result.window)[result.good])
        result.by_plant = by.reshape(e.size, -1)
        return result

    def rows(self, shift: float) -> tuple[np.ndarray, np.ndarray]:
        """Errors (samples, p) and their derivatives (samples, p, gains and levels)."""
        if shift not in self.kept:
            own, layout = self.own, self.own.log.layout
            vector = own.vector.copy()
            vector[layout.at_delays] += shift
            e, by = own.errors(vector, self.window), []
            unit = float(np.nanstd(e)) / own.log.recording.step + np.finfo(float).tiny
            of_gain = [(layout.of_B[:, :, j], 1.0) for j in range(layout.m)]
            of_level = [(layout.of_B[:, a, layout.m], unit) for a in own.log.acting]
            for place, step in (*of_gain, *of_level):
                moved = vector.copy()
                moved[place] += step if step == unit else moved[place]
                by.append((own.errors(moved, self.window) - e) / step)
            self.kept[shift] = e, np.stack(by, axis=-1)
        return self.kept[shift]

    def least(
        self, shifts: Iterable[float], gain: bool, level: bool
    ) -> tuple[float, float, Float[np.ndarray, " free"]]:
        """Of several shifts the least −2 log L, up to a constant; the shift; gains and levels."""
        each = ((*self._left(float(shift), gain, level), float(shift)) for shift in shifts)
        value, beta, shift = min(each, key=lambda one: one[0])
        return value, shift, beta

    def _left(self, shift: float, gain: bool, level: bool) -> tuple[float, np.ndarray]:
        e, by = (one[self.good] for one in self.rows(shift))
        m = self.own.log.layout.m
        chosen = np.r_[np.arange(m * gain), np.arange(m, by.shape[2] if level else m)]
        z = np.linalg.solve(self.root, e.T).T.ravel()
        X = np.linalg.solve(self.root, by[..., chosen]).reshape(z.size, -1)
        unit = np.maximum(np.linalg.norm(X, axis=0), np.finfo(float).tiny)
        unknown = self.by_plant.shape[1]
        below = np.hstack((np.zeros((unknown, chosen.size)), np.eye(unknown)))
        both = np.vstack((np.hstack((X / unit, self.by_plant)), below))
        given = np.concatenate((z, np.zeros(unknown)))
        beta = -np.linalg.lstsq(both, given, rcond=1e-9)[0]
        left = given + both @ beta
        floor = np.trace(np.linalg.solve(self.root, np.linalg.solve(self.root, self.floor).T))
        square = float(left @ left) + len(e) * float(floor)
        return z.size * float(np.log(square)), beta[: chosen.size] / unit


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
    inflation, found = inflation_of(list(estimate.white)), []
    for name, parts in zip(recording.logs, each, strict=True):
        own = recording._replace(parts=parts).stretches(_FEW, recording.lag(estimate.searched[1]))
        predictor = Predictor.of(estimate, C, own)
        difference = difference_of(predictor, inflation, len(each))
        if difference is not None:
            words = difference.words(predictor, recording.inputs, recording.outputs)
            found.append((difference.rise, name, words))
    if found:
        _, name, words = max(found)
        return (
            f"The logs contradict one another: of {name}, compared with the plant of all, {words} "
            f"(likelihood ratio, level {CHANCE:g}). Identify it alone, or leave it out.",
        ), ("the logs contradict one another",)
    log = np.repeat(np.arange(len(each)), [len(parts) for parts in each])
    squares = [np.nansum(one**2) for one in estimate.white]
    counts = [np.isfinite(one).sum() for one in estimate.white]
    total, number = np.bincount(log, squares), np.bincount(log, counts)
    others = (total.sum() - total) / np.maximum(number.sum() - number, 1)
    ratio = total / np.maximum(number, 1) / np.maximum(others, np.finfo(float).tiny)
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
