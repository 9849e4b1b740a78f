"""Residuals of an identified plant: one-step predictions of a log, and tests of their whiteness.

The test of Ljung and Box (Biometrika 65(2), 1978) over ten lags, and the largest correlation with
an input at any lag of the delays searched, at Bonferroni's level.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import Squares
from deadtime.identification.sampling import Sampling, known_ends, paths_of
from deadtime.identification.transition import interpolation, plain_transitions
from deadtime.plant import SwitchedSystem

_BLOCK = 20_000
LAGS = 10  # at which residuals are compared with themselves
_MOST_LAGS = 60  # with the inputs
CHANCE = 1e-3  # significance level: a test fails whose figure has a smaller probability


class ResidualTests(NamedTuple):
    """Tests of residuals: white noise, and uncorrelated with inputs.

    whiteness : the probability of a larger deviation from white noise
    lag, correlation : of the largest correlation with themselves, in samples
    input_chance : the probability of a larger correlation with any input
    input_delay : after how long it is largest, seconds; input : with which
    """

    whiteness: float
    lag: int
    correlation: float
    input_chance: float
    input_delay: float
    input: int

    @property
    def white(self) -> bool:
        return self.whiteness >= CHANCE

    @property
    def unrelated(self) -> bool:
        """Whether residuals are uncorrelated with the inputs."""
        return self.input_chance >= CHANCE


class FittedModel(NamedTuple):
    """A plant with the constant terms of its modes, and how its log is sampled."""

    plant: SwitchedSystem
    constant: Float[np.ndarray, "mode n"]
    sampling: Sampling

    def one_step(self, part: Part, k: np.ndarray, states: np.ndarray) -> np.ndarray:
        """States (periods, n) a period after given ones at the samples k of a part."""
        plant, sampling, result = self.plant, self.sampling, np.empty((k.size, self.plant.states))
        nodes, through = sampling.nodes, paths_of(plant.inputs, plant.inputs, sampling.hold)
        integrals = plain_transitions(plant.A, nodes, sampling.hold + 1)
        Phi_at, W_at = integrals[:2]
        for start in range(0, k.size, _BLOCK):
            own = k[start : start + _BLOCK]
            mode = part.mode[own]
            over = interpolation(nodes, part.time[own + 1] - part.time[own])
            acting = sampling.acting(part, own, plant.delays).joined(over, constant=False)
            for i in np.unique(mode):
                at = np.flatnonzero(mode == i)
                x = states[start + at]
                free = np.einsum("kq,qab,kb->ka", over[at], Phi_at[i], x, optimize=True)
                push = np.stack([integrals[w, i] @ plant.B[i, :, j] for j, w in through], axis=-1)
                forced = np.tensordot(acting[at], push, axes=([1, 2], [0, 2]))
                result[start + at] = free + forced + over[at] @ (W_at[i] @ self.constant[i])
        return result

    def residuals(
        self, recording: Recording, within: bool, roots: Squares
    ) -> list[Float[np.ndarray, "sample n"]]:
        """Of every part x_k less its prediction from x_{k−1}, whitened by the roots; else NaN."""
        residuals = []
        for part in recording.parts:
            k = np.flatnonzero(known_ends(part, within) & self.fed(part))
            rest = part.output[k + 1] - self.one_step(part, k, part.output[k])
            rest /= np.sqrt((part.time[k + 1] - part.time[k]) / recording.step)[:, None]
            white = np.full(part.output.shape, np.nan)
            for i in range(self.plant.modes):
                own = part.mode[k] == i
                white[k[own] + 1] = np.linalg.solve(roots[i], rest[own].T).T
            residuals.append(white)
        return residuals

    def fed(self, part: Part) -> Bool[np.ndarray, " period"]:
        """The periods whose acting inputs are known."""
        longest, shortest = float(self.plant.delays.max()), float(self.plant.delays.min())
        return self.sampling.fed(part, longest, shortest)

    def transitions(
        self, part: Part
    ) -> tuple[Float[np.ndarray, "period n n"], Float[np.ndarray, "period n"]]:
        """Φ and the effect of inputs of every period, NaN where acting inputs are not known."""
        k, n, nodes = np.flatnonzero(self.fed(part)), self.plant.states, self.sampling.nodes
        count = part.time.size - 1
        Phi, forced = np.full((count, n, n), np.nan), np.full((count, n), np.nan)
        forced[k] = self.one_step(part, k, np.zeros((k.size, n)))
        Phi_at, _ = plain_transitions(self.plant.A, nodes)
        for start in range(0, k.size, _BLOCK):
            own = k[start : start + _BLOCK]
            over = interpolation(nodes, part.time[own + 1] - part.time[own])
            for i in np.unique(part.mode[own]):
                at = part.mode[own] == i
                Phi[own[at]] = np.tensordot(over[at], Phi_at[i], 1)
        return Phi, forced


def judge_residuals(
    white: list[Float[np.ndarray, "sample n"]],
    recording: Recording,
    longest: float,
    spent: int | None = None,
) -> ResidualTests:
    """Tests of whitened residuals, by Ljung and Box, and by the largest correlation with inputs.

    spent : correlations that the fitted matrices remove, n² by default
    """
    from scipy.stats import chi2, norm

    n, m = white[0].shape[1], recording.parts[0].input.shape[1]
    total, pairs_at, worst = 0.0, 0, (0, 0.0)
    for lag in range(1, LAGS + 1):
        r, count = _correlation(white, white, lag)
        total += count * float((r**2).sum())
        pairs_at += count > 0
        size = float(r.flat[np.abs(r).argmax()])
        worst = (lag, size) if abs(size) > abs(worst[1]) else worst
    spare = max(n * n * pairs_at - (n * n if spent is None else spent), n * n)
    r, count = input_correlations(white, recording, longest)
    z, lags = np.abs(r).max(axis=1) * np.sqrt(count)[:, None], len(count)
    place = np.unravel_index(int(np.argmax(z)), (lags, m))
    chance = min(1.0, float(2.0 * norm.sf(np.max(z)) * lags * n * m))
    return ResidualTests(
        float(chi2.sf(total, spare)),
        *worst,
        chance,
        float(recording.step * (place[0] + 1)),
        int(place[1]),
    )


def input_correlations(
    white: list[Float[np.ndarray, "sample n"]], recording: Recording, longest: float
) -> tuple[Float[np.ndarray, "lag n m"], Float[np.ndarray, " lag"]]:
    """The residuals' correlation with inputs 1, 2, … samples before, and the number of pairs."""
    lags = min(int(np.ceil(longest / recording.step)) + LAGS, _MOST_LAGS)
    every = np.vstack([part.input for part in recording.parts])
    mean, deviation = np.nanmean(every, axis=0), np.nanstd(every, axis=0)
    inputs = [(part.input - mean) / deviation for part in recording.parts]
    r, count = zip(*(_correlation(white, inputs, lag + 1) for lag in range(lags)), strict=True)
    return np.array(r), np.array(count, float)


def _correlation(
    late: list[np.ndarray], early: list[np.ndarray], lag: int
) -> tuple[np.ndarray, int]:
    """The correlation of samples with those `lag` before, and the number of known pairs."""
    total, count = np.zeros((late[0].shape[1], early[0].shape[1])), 0
    for after, before in zip(late, early, strict=True):
        if len(after) <= lag:
            continue
        a, b = after[lag:], before[:-lag]
        known = np.asarray(np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1))
        total += np.where(known[:, None], a, 0.0).T @ np.where(known[:, None], b, 0.0)
        count += int(known.sum())
    return total / max(count, 1), count


def autocorrelation(
    white: list[Float[np.ndarray, "sample n"]],
) -> tuple[Float[np.ndarray, "lag n"], Float[np.ndarray, " lag"]]:
    """The correlation of each residual with itself, and the number of pairs for it."""
    r, count = zip(*(_correlation(white, white, lag + 1) for lag in range(LAGS)), strict=True)
    return np.diagonal(r, axis1=1, axis2=2), np.array(count, float)


def alternates(white: list[Float[np.ndarray, "sample n"]]) -> bool:
    """Whether errors of exact states tend to change sign, as caused by noise of sensors.

    Noise v adds v_{k+1} − Φ v_k to the error of a period, hence −Φ V to the covariance of
    neighbours. The level is one standard deviation, exceeded by chance every sixth time: a test at
    1e-3 would miss noise that biases a delay.
    """
    r, count = autocorrelation(white)
    return bool((r[0] * np.sqrt(count[0]) < -1.0).any())
