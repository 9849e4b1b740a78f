"""The maximum of a log whose modes are hidden and whose sensors are noisy, of one number of modes.

It begins at the plant that is likeliest without noise of the sensors, with two guesses of how much
of what a period adds is theirs. Plant and noise are climbed with the chain held, and the chain is
set to the jumps that are expected then, in turn. The first steps take modes to change at samples
and to last.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.identification.hidden.choice import Fitted, Search
from deadtime.identification.hidden.jumps import Jumps
from deadtime.identification.hidden.noisy_likelihood import HiddenNoisyLog, Starts
from deadtime.identification.maximum import maximise, window_of
from deadtime.identification.noise import continuous, first_noises, stretches
from deadtime.identification.noisy import NoisyLog
from deadtime.identification.parameters import Layout
from deadtime.identification.recording import Recording
from deadtime.identification.scoring import Maximum

_ENOUGH = 2_000  # samples that tell which of two beginnings is the better one
_ROUNDS = 10  # of plant and chain, each the other held
_CHAIN = 20  # steps of the chain in a round
_SOON, _LATE = 0.3, 1e-3  # of log likelihood, a gain that is worth a step: at first, at the end


class NoisyFit(NamedTuple):
    """The likeliest plant and noise of a number of modes, and BIC.

    fit : without noise of the sensors; window : of delays; values : log likelihood of every round
    """

    fit: Fitted
    log: HiddenNoisyLog
    best: Maximum
    window: tuple[float, float]
    values: Float[np.ndarray, " round"]
    bic: float

    @property
    def layout(self) -> Layout:
        """Where unknowns of the plant lie."""
        return self.fit.layout


def _lag(window: tuple[float, float], step: float) -> int:
    """Samples at the beginning of a stretch in which not all that acts is known."""
    return int(np.ceil(window[1] / step)) + 1


def fitted_with_noise(
    fit: Fitted,
    search: Search,
    recording: Recording,
    C: Float[np.ndarray, "p n"],
) -> NoisyFit:
    """The likeliest plant and noise of a recording of y = C x, from a fit without noise.

    Raises
    ------
    ArgumentError
        If a mode is left with next to no row.
    """
    exact, theta, layout = fit.ascent.log, fit.ascent.theta, fit.layout
    A, _, _ = layout.split(theta)
    share = fit.ascent.found.weight.sum(axis=0)
    W = np.tensordot(share / share.sum(), continuous(A, exact.S, recording.step), axes=1)
    window = window_of(exact, theta[layout.at_delays])
    known = np.diagonal(exact.evaluate(theta, exact.cells(theta)).information)
    unit = np.concatenate((1.0 / np.sqrt(np.maximum(known, 1e-300)), _units(W), np.ones(len(C))))
    one = replace(layout, modes=1, per_mode=False)
    noisy = NoisyLog(recording, one, C, False, search.bounds, exact.nodes)
    jumps = Jumps.lasting(layout.modes, recording.step, exact.jumps.rates)
    log = HiddenNoisyLog(noisy, layout, unit, jumps, exact.within)
    few = stretches(recording, _ENOUGH, _lag(window, recording.step))
    some = replace(noisy, recording=few)
    tried = []
    for noise in first_noises(W, C, recording.step):
        begun = replace(log, noisy=some, within=False, _kept={})
        tried.append(_climbed(begun, begun.whole.join(theta, noise), window, _SOON))
    first = max(tried, key=lambda one: one[1].found.value)
    log = replace(log, jumps=first[0].jumps)
    log, best, values = _climbed(log, first[1].theta, window, _LATE)
    best, window = maximise(log, best.theta, gain=_LATE)
    rows = np.vstack(log.posterior(best.theta, log.starts(*window)).node).sum(axis=0)
    if rows.min() < layout.least_periods:
        raise ArgumentError(
            f"modes = {layout.modes} is too many for this log: with noise of the sensors a mode is "
            f"left with {rows.min():.0f} rows: ask for fewer, or log for longer."
        )
    n, modes = layout.n, layout.modes
    unknowns = layout.size + n * (n + 1) // 2 + len(C) + modes * (modes - 1)
    bic = unknowns * float(np.log(search.periods.count)) - 2.0 * best.found.value
    return NoisyFit(fit, log, best, window, values, bic)


def _climbed(
    log: HiddenNoisyLog,
    theta: Float[np.ndarray, " size"],
    window: tuple[float, float],
    gain: float,
) -> tuple[HiddenNoisyLog, Maximum, Float[np.ndarray, " round"]]:
    """Rounds of the plant and of the chain, until they gain little; and the likelihood of each."""
    values, starts = [], log.starts(*window)
    while True:
        best, _ = maximise(log, theta, window=window, gain=gain)
        theta = best.theta
        values.append(best.found.value)
        if len(values) == _ROUNDS or (len(values) > 1 and values[-1] - values[-2] < 10.0 * gain):
            return log, best, np.array(values)
        log = _next_chain(log, theta, starts)


def _next_chain(log: HiddenNoisyLog, theta: np.ndarray, starts: Starts) -> HiddenNoisyLog:
    """The same with the likeliest chain, the plant held."""
    before = -np.inf
    for _ in range(_CHAIN):
        found = log.posterior(theta, starts)
        if found.value - before < _LATE:
            break
        log, before = replace(log, jumps=log.jumps.next(found.counts)), found.value
    return log


def _units(W: Float[np.ndarray, "n n"]) -> Float[np.ndarray, " entry"]:
    """How large the entries of a triangle L, L Lᵀ = W, are; of its diagonal the logarithms are."""
    i, j = np.tril_indices(len(W))
    return np.where(i == j, 1.0, np.sqrt(np.maximum(np.diagonal(W)[i], 1e-300)))
