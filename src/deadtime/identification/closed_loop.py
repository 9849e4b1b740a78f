"""Closed loops: inputs that are hardly more than a function of what was measured.

With sensors of noise v, y_k = x_k + v_k, and one state, a period is

    y_{k+1} = Φ y_k + Γ₁ u_{k−N} + Γ₂ u_{k−N+1} + ε_k,    ε_k = w_k + v_{k+1} − Φ v_k.

ε_k is correlated with y_k, by −Φ V, and with its neighbours, so that of all predictors the best one
reads y_k, y_{k−1}, y_{k−2}, … with weights that fall by the ratio of the filter. Where u_k = K y_k,
an input of a period or two ago *is* such a measurement: as if sensors had no noise, a delay that
short lets B K stand for a weight of the predictor. That is a maximum of the likelihood which is
higher than the plant's own, with another B, often of the other sign, and it leaves white residuals.

With the noise of sensors among the unknowns it is none any more. What is left of a delay is how y
follows itself after D + h, a B K part of it that noise hides: there may be many maxima. So the
likelihood is maximised in every cell of the delay, from several beginnings, and intervals go over
all cells that are plausible. Where these are most of the range, the log tells A + B K, no more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from deadtime.identification.delay_intervals import plausible_fall
from deadtime.identification.estimate import Estimate
from deadtime.identification.levels import without_level
from deadtime.identification.likelihoods.likelihood import climb_within, maximise
from deadtime.identification.likelihoods.noisy_log import NoisyLog
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy.noise import begun_with_noise, estimated_of, exact_holds
from deadtime.identification.scoring import Evaluate, Maximum
from deadtime.identification.start import Start, cell_range

_MANY = 40  # cells: in so many all beginnings are tried, in others only the neighbour's maximum
_FEW = 2_000  # samples of a first look at all cells
_GAIN = 1e-3  # of log likelihood that is worth a step
_SAME = 0.1  # of log likelihood: a neighbour that is so much likelier leads elsewhere


def over_all_cells(log: NoisyLog, begins: list[np.ndarray]) -> Estimate:
    """The estimate with the likelihood of every cell of each delay as what tells it.

    begins : vectors of the likelihood to climb from, in each cell
    """
    recording, bounds = log.recording, log.bounds
    lag = recording.lag(bounds[1])
    some = replace(log, recording=recording.stretches(_FEW, lag))
    theta, curves, vectors = begins[0], [], []
    first, last = cell_range(recording.step, bounds, log.layout.m)
    every = np.arange(first, last + 1)
    for row in range(log.layout.delays):
        tops = _in_cells(some, begins, row, every)
        if some.recording is not recording:
            tops = _anew(log, tops, row, every)
        values = np.array([top.found.value for top in tops])
        theta = tops[int(values.argmax())].theta
        begins = [theta, *begins]
        curves.append(values)
        vectors.append([top.theta for top in tops])
    best, window = maximise(log, theta, gain=_GAIN)
    log, kept = without_level(log, best.theta, best.found.information, np.linalg.pinv(log.C))
    if kept.size < best.theta.size:
        best, window = maximise(log, best.theta[kept], gain=_GAIN)
        vectors = [[vector[kept] for vector in each] for each in vectors]
    cells = log.cells(best.theta)
    for row, cell in enumerate(cells):  # a climb over kinks may have gone further
        own = log.evaluate_in(*bounds)(cells)(best.theta).value
        curves[row][cell - first] = max(curves[row][cell - first], own)
        vectors[row][cell - first] = best.theta
    told = np.array(curves), log.acting.size, np.array(vectors)
    start = Start(best.theta[: log.layout.size], cells, first, *told)
    return estimated_of(log, best, window, start)


def _in_cells(
    log: NoisyLog, begins: list[np.ndarray], row: int, every: Int[np.ndarray, " cell"]
) -> list[Maximum]:
    """The likeliest vector with one delay in each of its cells."""
    evaluate_in, tops = log.evaluate_in(*log.bounds), []
    often = max(1, every.size // _MANY)
    for place, cell in enumerate(every.tolist()):
        near = [tops[-1].theta] if tops else []
        own = near if place % often else [*near, *begins]
        tops.append(_highest([_top(log, evaluate_in, theta, row, cell) for theta in own]))
    for place in range(every.size - 2, -1, -1):
        if tops[place + 1].found.value > tops[place].found.value + _SAME:
            again = _top(log, evaluate_in, tops[place + 1].theta, row, int(every[place]))
            tops[place] = _highest([tops[place], again])
    return tops


def _anew(
    log: NoisyLog, tops: list[Maximum], row: int, every: Int[np.ndarray, " cell"]
) -> list[Maximum]:
    """The same of a whole log, where a part of it leaves a cell plausible."""
    evaluate_in, values = log.evaluate_in(*log.bounds), np.array([one.found.value for one in tops])
    fall = values.max() - values
    near = np.flatnonzero(fall <= plausible_fall(log.layout, log.acting.size, every.size, 1.0))
    found = {i: _top(log, evaluate_in, tops[i].theta, row, int(every[i])) for i in near.tolist()}
    most = max(one.found.value for one in found.values())
    return [
        found.get(i, one._replace(found=one.found._replace(value=most - float(fall[i]))))
        for i, one in enumerate(tops)
    ]


def _top(
    log: NoisyLog,
    evaluate_in: Callable[[np.ndarray], Evaluate],
    theta: np.ndarray,
    row: int,
    cell: int,
) -> Maximum:
    """The maximum that a vector leads to with one delay in a cell, the others in theirs."""
    cells, begin = log.cells(theta), theta
    if cells[row] != cell:
        begin, cells[row] = theta.copy(), cell
        begin[log.layout.at_delays][row] = (cell - 0.5) * log.recording.step
    return climb_within(log, evaluate_in(cells), begin, cells, _GAIN)


def _highest(found: list[Maximum]) -> Maximum:
    return max(found, key=lambda one: one.found.value)


def estimate_in_loop(
    recording: Recording, C: Float[np.ndarray, "p n"], exact: Estimate, sure: bool
) -> Estimate:
    """The estimate with noisy sensors; that without noise where it holds, unless noise is sure."""
    found = over_all_cells(*begun_with_noise(recording, C, exact))
    return exact if not sure and exact_holds(exact, found) else found
