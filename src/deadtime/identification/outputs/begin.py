"""Where climbs to the likeliest plant of outputs begin; with zeros there are several maxima."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from deadtime.identification.likelihoods.noisy_log import NoiseLevels, NoisyLog
from deadtime.identification.maximum import maximise
from deadtime.identification.noisy.delay_scan import scanned
from deadtime.identification.noisy.largest import of_sensors
from deadtime.identification.outputs.past import chains_by_past
from deadtime.identification.outputs.smoothed_start import Guess
from deadtime.identification.uneven import gridded

_SHARES = 1.0, 1e-2, 1e-4  # of the plant's noise that chains with zeros begin with
_APART = 8, 4, 2, 1  # periods between outputs that stand for states
_NOTHING = 1e-8  # of the plant's noise, where it is left out
_FEW = 1_000  # samples for climbs with noise held
_GAIN = 1e-2  # of log likelihood that is worth a step while noise is held


def begins_of(log: NoisyLog, guess: Guess) -> list[np.ndarray]:
    """Where to begin: of chains with zeros, from integrators, and several noises.

    Derivatives of outputs that inputs make jump are no states: an A of them has poles far out, in
    place of a zero and a part of the delay, where the likelihood has a maximum that is not its
    largest. So it has with much noise in place of a pole that lies near a zero.
    """
    shape, layout = log.embedding, log.layout
    assert shape is not None
    if not (shape.zeros and shape.upper.size):
        return [log.join(guess.theta, noise) for noise in guess.noise]
    A, B, delays = layout.split(guess.theta)
    theta = layout.join(np.broadcast_to(shape.shift(), A.shape), B, delays)
    W, deviation = guess.noise[-1]
    return [log.join(theta, NoiseLevels(share * W, deviation)) for share in _SHARES]


def by_past(log: NoisyLog, guess: Guess) -> list[np.ndarray]:
    """Where each A that outputs' past tells leads to with hardly any noise: of chains with zeros.

    That noise is next to nothing and stays so first: else it takes up what a delay that is a part
    of a period off leaves, and a climb ends there.
    """
    shape, layout, grid = log.embedding, log.layout, gridded(log.recording)
    assert shape is not None
    if not (shape.zeros and shape.upper.size):
        return []
    _, B, delays = layout.split(guess.theta)
    W, deviation = guess.noise[-1]
    lag = grid.lag(log.bounds[1])
    few = replace(log, recording=log.recording.stretches(_FEW, lag))
    even, held = replace(few, recording=gridded(few.recording)), np.arange(log.size) >= layout.size
    begins = []
    for apart in _APART:
        given = shape, deviation, grid.step, lag, layout.modes, apart
        if (A := chains_by_past(grid.parts, *given)) is None:
            continue
        begin = log.join(layout.join(A, B, delays), NoiseLevels(_NOTHING * W, deviation))
        begin = of_sensors(few, scanned(even, begin).moved(begin))
        best, _ = maximise(few, begin, held, log.bounds, _GAIN)
        begins.append(of_sensors(log, best.theta))
    return begins
