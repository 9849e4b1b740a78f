r"""Inputs between samples: held or linear, tested against each other by a model of both.

An analog input that is sampled and taken as held gives a delay that is half a period too short,
because a held input is on average that much late. Neither model is a case of the other. Both are
of the input (1 − α) held + α linear. Let e₀ and e₁ be the residuals at the maxima with held and
with linear inputs, white and in standard deviations. To first order in the difference d = e₀ − e₁,

    e(α) = e₀ − α d,    α̂ = e₀ᵀd / dᵀd,    2 (log L(α̂) − log L(α)) = N log(|e(α)|² / |e(α̂)|²),

a regression (the J test of Davidson and MacKinnon, Econometrica 49(3), 1981) whose standard error
1/|d| is the inverse of the distance of both models in standard deviations.

An α is plausible if its likelihood ratio does not reject it, or if it is so near α̂ that the delay
hardly depends on it. Where neither is, something else acts, as an actuator that smooths the input
more than a linear one.

A smooth input, of frequencies well below 1/h, follows neither model, but has the delay of the
linear one. Its α̂ is often near 0, as the smearing by both models is compensated by B and D. So held
inputs are said to be supported only if their samples are not those of a smooth input.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from deadtime.base.errors import ArgumentError
from deadtime.identification.estimate import EDGE, Estimate, IdentifiedLog
from deadtime.identification.identifiability import fed_back
from deadtime.identification.likelihoods.likelihood import maximise, window_of
from deadtime.identification.log.recording import Recording
from deadtime.identification.parameters import Window
from deadtime.identification.residuals import judge_residuals

HOLDS = "held", "linear"  # by the degree of the input between samples
_FEWEST = 8  # rows of a part that count
_MOST = 30  # rows of the past of an input
_SHARES = np.array([0.0, 1.0])  # α of held and of linear inputs
_SMOOTH = 0.5  # of an input's variance: error of a spline through every other sample
_LITTLE = 0.1  # of an interval: a smaller shift hardly matters
_NEAR = 0.25  # of α: the delay then is off by less than an eighth of a period
_SURE = 3.0  # standard deviations at which a model is rejected
_CHANGES = 0.5  # share of rows in which an input of steps changes, at most
_ROUND_OFF = 1e-12  # of the largest variance of residuals, which counts as none
_ENOUGH = 10_000  # samples that suffice for the test
_GAIN = 0.05  # rise of log likelihood that ends the climbs of the test


class HoldTest(NamedTuple):
    """The share α of a linear input in the likeliest mixture, and how far it rejects the models.

    off : of α̂ against 0 and 1, roots of likelihood ratios, in standard deviations
    later : by how much delays are longer with linear inputs, seconds
    fits : whether residuals with linear inputs look like chance
    early : whether linear inputs act before their rows
    """

    share: float
    off: Float[np.ndarray, " model"]
    later: Float[np.ndarray, " delay"]
    fits: bool
    early: bool

    @property
    def plausible(self) -> Bool[np.ndarray, " model"]:
        """Whether inputs may be held, and whether linear."""
        return (self.off < _SURE) | (np.abs(self.share - _SHARES) < _NEAR)


def degree_of(hold: object) -> int | None:
    """The degree of inputs between samples; None to take them as held and to test it."""
    if hold is None:
        return None
    if hold not in HOLDS:
        raise ArgumentError(
            'hold must be "held", "linear", or None to take inputs as held and to test it, got '
            f"{hold!r}."
        )
    return HOLDS.index(str(hold))


def require_causal(recording: Recording, bounds: Window, noise: bool | None) -> None:
    """Refuse linear inputs with feedback where delays shorter than a period are searched.

    Then a row's input acts before the row: whether the measurement shows the input, or the input
    follows the measurement, cannot be told.
    """
    h = recording.step
    if not recording.hold or bounds[0] >= h * (1.0 - EDGE) or noise is False:
        return
    for name in np.array(recording.inputs)[_follows(recording, bounds[1])][:1]:
        raise ArgumentError(
            f'hold="linear", --hold linear, needs delays of at least a row, {h:.4g} s, because '
            f"{name} is related to the measurement of its own row: with a shorter delay a linear "
            "input acts before its row, and the log does not tell that from feedback. Narrow "
            f'delay=(low, high), --delay LOW HIGH, to {h:.4g} s and more; say hold="held" if a '
            "digital law sends the input; or noise=False, --no-noise, if it follows no measurement."
        )


def with_hold_tested(log: IdentifiedLog, degree: int | None) -> IdentifiedLog:
    """The identified log with what it says of its inputs between samples.

    degree : as requested; None to test held inputs against linear ones
    """
    estimate, recording = log.estimate, log.recording
    changes = np.vstack([np.abs(np.diff(part.input, axis=0)) > 0.0 for part in recording.parts])
    stays = bool((changes.mean(axis=0) <= _CHANGES).all())
    if degree:
        sentence = "Inputs are taken to change linearly between samples."
        if (log.estimate.delays < log.recording.step * (1.0 - EDGE)).any():
            sentence = (
                f"{sentence} With a delay below a row they act before their row, so they are taken "
                "not to follow its measurement."
            )
        if not stays:
            return log._replace(sentences=(*log.sentences, sentence))
        sentence = (
            f"{sentence} Yet inputs keep their values in most rows, as held ones do: repeat with "
            'hold="held", --hold held; else the delay may be half a period, '
            f"{0.5 * recording.step:.3g} s, too long."
        )
        doubt = "inputs that seem to be held are taken as linear"
        return log._replace(sentences=(*log.sentences, sentence), doubts=(*log.doubts, doubt))
    if degree == 0 or estimate.missed.any() or stays:
        return log
    test = hold_test(estimate, recording)
    if test is None:
        return log
    if test.early and (follows := _follows(recording, estimate.searched[1])).any():
        return _near_zero_in_loop(log, test, np.array(recording.inputs)[follows][0])
    return _with_result(log, test)


def _follows(recording: Recording, longest: float) -> Bool[np.ndarray, " m"]:
    """Which inputs are feedback, given all of their past that delays up to `longest` may show."""
    short = fed_back(recording)
    return short & fed_back(recording, min(recording.lag(longest), _MOST)) if short.any() else short


def hold_test(estimate: Estimate, recording: Recording) -> HoldTest | None:
    """Held against linear inputs, from one climb each; None if the climbs lead nowhere."""
    held = estimate.log.along(recording)
    held = replace(held, recording=recording.stretches(_ENOUGH, recording.lag(held.bounds[1])))
    linear = replace(held, recording=held.recording._replace(hold=1))
    theta, place = estimate.best.theta.copy(), held.layout.at_delays
    low, high = window_of(held, theta[place])
    window = low, min(held.bounds[1], high + recording.step)
    own = maximise(held, theta, window=window, gain=_GAIN)[0]
    theta[place] = np.minimum(own.theta[place] + 0.5 * recording.step, held.bounds[1])
    other = maximise(linear, theta, window=window, gain=_GAIN)[0]
    if not np.isfinite((own.value, other.value)).all():
        return None
    each = held.residuals(own.theta, window), linear.residuals(other.theta, window)
    parts = held.recording.parts
    modes = np.concatenate([np.append(0, part.mode[:-1]) for part in parts])
    white = _whitened(each, modes, int(other.value > own.value))
    e = white[:, np.isfinite(white).all(axis=(0, 2))].reshape(2, -1)
    d, least = e[0] - e[1], np.finfo(float).tiny
    share = float(e[0] @ d) / max(float(d @ d), least)
    least = max(float(((e[0] - share * d) ** 2).sum()), least)
    off = np.sqrt(d.size * np.log1p(float(d @ d) * (share - _SHARES) ** 2 / least))
    later = np.clip(other.theta[place] - own.theta[place], 0.0, recording.step)
    by_part = np.split(white[1], np.cumsum([part.time.size for part in parts])[:-1])
    tests = judge_residuals(by_part, held.recording, float(other.theta[place].max()))
    early = bool((other.theta[place] < recording.step).any())
    return HoldTest(share, off, later, tests.white and tests.unrelated, early)


def _whitened(
    each: tuple[tuple[np.ndarray, np.ndarray], ...], modes: np.ndarray, better: int
) -> Float[np.ndarray, "2 sample p"]:
    """Residuals of both models in standard deviations of the better one's, where both are known."""
    both = np.array([e for e, _ in each]) / np.sqrt(each[better][1])
    known, white = np.isfinite(both).all(axis=(0, 2)), np.full(both.shape, np.nan)
    for i in np.unique(modes[known]):
        own = known & (modes == i)
        e = both[:, own]
        values, vectors = np.linalg.eigh(e[better].T @ e[better] / e.shape[1])
        floor = _ROUND_OFF * values.max() + np.finfo(float).tiny
        white[:, own] = e @ vectors / np.sqrt(np.maximum(values, floor))
    return white


def _smooth(recording: Recording) -> bool:
    """Whether splines through every other sample of an input predict the others.

    Inputs that stay in most rows are left out.
    """
    from scipy.interpolate import CubicSpline

    for j in range(len(recording.inputs)):
        errors, every = [np.zeros(0)], [np.zeros(0)]
        for part in recording.parts:
            known = np.isfinite(part.input[:, j])
            t, u = part.time[known], part.input[known, j]
            if u.size < _FEWEST:
                continue
            inner = slice(1, u.size - u.size % 2 - 1, 2)
            errors.append(u[inner] - CubicSpline(t[::2], u[::2])(t[inner]))
            every.append(u)
        u, e = np.concatenate(every), np.concatenate(errors)
        changes = np.count_nonzero(np.diff(u)) > _CHANGES * u.size
        if changes and e.size and np.mean(e**2) < _SMOOTH * np.var(u):
            return True
    return False


def _zero(estimate: Estimate) -> bool:
    """Whether a delay fits best at 0, the edge of the range."""
    low, high = estimate.searched
    return low == 0.0 and bool((estimate.delays <= EDGE * (high - low)).any())


def _near_zero_in_loop(log: IdentifiedLog, test: HoldTest, name: str) -> IdentifiedLog:
    """The identified log with what a delay near 0 may mean where an input seems to be feedback."""
    if test.plausible[0] and not _zero(log.estimate):
        return log
    sentence = (
        f"{name} is related to the measurement of its own row: either it follows that measurement, "
        "or the input acts up to half a row earlier than logged, because it changes linearly "
        'between samples (hold="linear" with noise=False, --hold linear --no-noise), or because '
        "its stamps are late."
    )
    doubt = "the input does not seem to be held between samples"
    return log._replace(sentences=(*log.sentences, sentence), doubts=(*log.doubts, doubt))


def _with_result(log: IdentifiedLog, test: HoldTest) -> IdentifiedLog:
    """The identified log with the sentences, doubts and intervals that follow from a test."""
    estimate, h = log.estimate, log.recording.step
    held, linear = test.plausible
    if held:
        by_chance = estimate.tests.white and estimate.tests.unrelated
        if linear or not by_chance or _smooth(log.recording):
            return _widened(log, test.later)
        sentence = "The input is taken as held between samples: the log supports that."
        return log._replace(sentences=(*log.sentences, sentence))
    if _zero(estimate):
        sentence = (
            "The input acts up to half a row earlier than logged: it changes linearly between "
            'samples (repeat with hold="linear", --hold linear), or its stamps are late.'
        )
    elif linear and test.fits:
        sentence = (
            "The log speaks for an input that changes linearly between samples (a held one fits "
            f'worse by {test.off[0]:.1f} standard deviations): repeat with hold="linear", --hold '
            f"linear; with a held input the delay is about half a period, {0.5 * h:.3g} s, too "
            f"short. (A lag of the actuator of about {h / np.sqrt(12.0):.2g} s looks alike.)"
        )
    else:
        sentence = (
            "The log supports neither an input that is held between samples nor one that changes "
            "linearly: an actuator with a lag, a filter or a second path may act, or stamps may be "
            f"off. The delay may be off by half a period, {0.5 * h:.3g} s."
        )
    doubt = "the input does not seem to be held between samples"
    return log._replace(
        sentences=(*log.sentences, sentence),
        doubts=(*log.doubts, doubt),
        linear=bool(linear) and test.fits,
    )


def _widened(log: IdentifiedLog, later: Float[np.ndarray, " delay"]) -> IdentifiedLog:
    """The identified log with intervals that hold the delays of linear inputs, too."""
    estimate = log.estimate
    low, high = estimate.intervals.T
    if (later < _LITTLE * (high - low)).all():
        return log
    ends = np.column_stack((np.minimum(low, low + later), np.maximum(high, high + later)))
    estimate = replace(
        estimate, intervals=np.clip(ends, estimate.searched[0], estimate.log.bounds[1])
    )
    sentence = (
        "The log does not tell whether the input is held between samples or changes linearly: the "
        f"interval covers both; a linear one has a delay {_ends(later)} s longer. Say which by "
        'hold="held" or hold="linear", --hold.'
    )
    return log._replace(estimate=estimate, sentences=(*log.sentences, sentence))


def _ends(values: Sequence[float] | np.ndarray) -> str:
    texts = sorted({f"{value:.3g}" for value in values}, key=float)
    return texts[0] if len(texts) == 1 else f"{texts[0]} … {texts[-1]}"
