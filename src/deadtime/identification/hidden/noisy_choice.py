"""The maximum of a log whose modes are hidden and whose sensors are noisy, of one number of modes.

It begins at each of the regressions that starts without noise lead to, with two guesses of how much
of what a period adds is the sensors'; what leads highest in coarse steps, with modes that change at
samples and last at first, goes on. Plant and noise are climbed with the chain held, and the chain
is set to the jumps that are expected then, in turn.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.identification.hidden.choice import (
    Begun,
    HiddenFit,
    HiddenSearch,
    begun,
    bic_of,
    fitted,
)
from deadtime.identification.levels import at_zero, from_zero
from deadtime.identification.likelihoods.hidden_noisy_log import HiddenNoisyLog, Starts
from deadtime.identification.likelihoods.jumps import Jumps
from deadtime.identification.likelihoods.likelihood import maximise, window_of
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy.noise import first_noises
from deadtime.identification.parameters import Layout, Vector, Window
from deadtime.identification.scoring import Maximum
from deadtime.identification.transition import continuous

_ENOUGH = 2_000  # samples that tell which of two beginnings is the better one
_ROUNDS = 10  # of plant and chain, each the other held
_CHAIN = 20  # steps of the chain in a round
_FAR = 10.0  # times what BIC asks of constant terms: they are no chance
_SOON, _LATE = 0.3, 1e-3  # of log likelihood, a gain that is worth a step: at first, at the end


def fitted_with_noise(
    search: HiddenSearch, layout: Layout, recording: Recording, C: Float[np.ndarray, "p n"]
) -> HiddenFit[HiddenNoisyLog]:
    """The likeliest plant and noise of a recording of y = C x, of a number of modes.

    Raises
    ------
    ArgumentError
        If the log is too short for so many, or a mode is left with next to no row.
    """
    if search.plain is not None and not _seems_to_need_level(search, layout):
        plain = replace(layout, constant=False)
        return fitted_with_noise(search.plain, plain, recording.absolute(), C)
    found, best = _led(search, *_best_start(search, layout, recording, C))
    if search.plain is None:
        return found
    return min(found, _at_zero(search.plain, found, best) or found, key=lambda fit: fit.bic)


def _seems_to_need_level(search: HiddenSearch, layout: Layout) -> bool:
    """Whether constant terms lower BIC of exact states; where these cannot tell, they might."""
    try:
        return fitted(search, layout).layout.constant
    except ArgumentError:
        return True


def _at_zero(
    search: HiddenSearch, fit: HiddenFit[HiddenNoisyLog], best: Maximum
) -> HiddenFit[HiddenNoisyLog] | None:
    """The maximum near a fit without its constant terms; None where these are far from chance."""
    given = best.theta, best.found.information, fit.log.recording, np.linalg.pinv(fit.log.C)
    far, terms = from_zero(fit.layout, *given)
    if far > _FAR * terms * np.log(search.periods.count):
        return None
    log, kept = at_zero(fit.log, best.theta.size)
    log = replace(log, errors=log.errors[kept], _kept={})
    with suppress(ArgumentError):
        return _led(search, fit.begun, log, best.theta[kept], fit.window)[0]


def _led(
    search: HiddenSearch, begin: Begun, log: HiddenNoisyLog, theta: Vector, window: Window
) -> tuple[HiddenFit[HiddenNoisyLog], Maximum]:
    """The maximum that a vector leads to.

    Raises
    ------
    ArgumentError
        If it leaves a mode with next to no row.
    """
    layout = log.layout
    log, best, values = _climbed(log, theta, window, _LATE)
    best, window = maximise(log, best.theta, gain=_LATE)
    if (rows := _least_rows(log, best.theta, window)) < layout.least_periods:
        raise ArgumentError(
            f"modes = {layout.modes} is too many for this log: with noise of the sensors a mode is "
            f"left with {rows:.0f} rows: ask for fewer, or log for longer."
        )
    # Of the same samples for all numbers, and all levels: nothing but P0 is known of the first.
    starts = log.starts(*search.bounds)
    value = float(log.filtered(best.theta, starts)[1][~np.concatenate(starts)].sum())
    bic = bic_of(search, layout, best.theta.size - layout.size, value)
    given = log, best.theta, log.starts(*window), window, values, bic
    return HiddenFit(*given, begin, begin.log, begin.theta), best


def _best_start(
    search: HiddenSearch, layout: Layout, recording: Recording, C: Float[np.ndarray, "p n"]
) -> tuple[Begun, HiddenNoisyLog, Vector, tuple[float, float]]:
    """What leads highest in coarse steps, of those that leave all modes some rows, if any do.

    And its likelihood, its vector, and the window of its delays.
    """
    few, found = recording.stretches(_ENOUGH, recording.lag(search.bounds[1])), []
    for start in _starts(search, layout):
        log, W = _of_start(start, search, recording, C)
        window = window_of(start.log, start.theta[layout.at_delays])
        rough = replace(log, recording=few, within=False, _kept={})
        for noise in first_noises(W, C, recording.step):
            vector = rough.join(start.theta, noise)
            led, best, _ = _climbed(rough, vector, window, _SOON)
            whole = _least_rows(led, best.theta, window) >= layout.least_periods
            value = led.value(best.theta, led.starts(*search.bounds))
            own = replace(log, jumps=led.jumps)
            found.append(((whole, value), (start, own, best.theta, window)))
    return max(found, key=lambda one: one[0])[1]


def _starts(search: HiddenSearch, layout: Layout) -> list[Begun]:
    """Those that regressions lead to with one covariance of all modes, and with one of each.

    Noise of sensors is that of all modes; where one hides another, though, the others may not.
    """
    found, errors = [], []
    for common in (True, False)[: layout.modes]:
        try:
            found += begun(search, layout, common)
        except ArgumentError as error:
            errors.append(error)
    if not found:
        raise errors[0]
    return found


def _of_start(
    start: Begun, search: HiddenSearch, recording: Recording, C: Float[np.ndarray, "p n"]
) -> tuple[HiddenNoisyLog, Float[np.ndarray, "n n"]]:
    """The likelihood, with modes that last; and what a period adds, as noise of the plant."""
    exact, theta, layout = start.log, start.theta, start.log.layout
    A, _, _ = layout.split(theta)
    share = start.found.weight.sum(axis=0)
    W = np.tensordot(share / share.sum(), continuous(A, exact.S, recording.step), axes=1)
    known = np.diagonal(exact.evaluate(theta, exact.cells(theta)).information)
    errors = np.concatenate((1.0 / np.sqrt(np.maximum(known, 1e-300)), _units(W), np.ones(len(C))))
    jumps = Jumps.lasting(layout.modes, recording.step, not recording.even)
    given = recording, layout, exact.within, search.bounds, exact.nodes, C
    return HiddenNoisyLog(*given, errors=errors, jumps=jumps), W


def _least_rows(log: HiddenNoisyLog, theta: Vector, window: Window) -> float:
    """How many rows the rarest mode is expected to have."""
    return float(np.vstack(log.posterior(theta, log.starts(*window)).node).sum(axis=0).min())


def _climbed(
    log: HiddenNoisyLog, theta: Vector, window: Window, gain: float
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
