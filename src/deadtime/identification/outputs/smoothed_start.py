"""Where to begin from outputs alone: derivatives by a smoother, as if they were measured."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.identification.likelihoods.embedding import Embedding
from deadtime.identification.likelihoods.noisy_log import NoiseLevels
from deadtime.identification.log.recording import Recording
from deadtime.identification.outputs.derivatives import Derivatives, derivatives_of
from deadtime.identification.parameters import Layout
from deadtime.identification.start import start_of


class Guess(NamedTuple):
    """A first plant, and its noise; `size` of the states."""

    theta: Float[np.ndarray, " size"]
    noise: tuple[NoiseLevels, ...]
    size: Float[np.ndarray, " n"]


def guess_of(
    grid: Recording,
    layout: Layout,
    order: tuple[int, ...],
    bounds: tuple[float, float],
    within: bool,
) -> Guess:
    """A first plant from evenly sampled outputs, as if their smoothed derivatives were measured."""
    found = derivatives_of(grid.parts, order, grid.step)
    every = np.vstack(found.states)
    shape = Embedding(order, False, np.sqrt(np.mean(every**2, axis=0)))
    parts = zip(grid.parts, found.states, strict=True)
    measured = grid._replace(parts=tuple(part._replace(output=x) for part, x in parts))
    A, B, delays = layout.split(start_of(measured, layout, bounds, within).theta)
    A, B = A.copy(), B.copy()
    A[:, shape.upper], B[:, shape.upper] = shape.shift()[shape.upper], 0.0
    return Guess(layout.join(A, B, delays), _noises(found, shape, grid.step), shape.size)


def _noises(found: Derivatives, shape: Embedding, step: float) -> tuple[NoiseLevels, ...]:
    """What moves outputs is mostly noise of the plant, or mostly of the sensors."""
    moves = [np.diff(states, axis=0) for states in found.states]
    moves = np.mean(np.vstack(moves) ** 2, axis=0) / step
    deviation = np.maximum(found.deviation, 1e-4 * (shape.C @ shape.size))
    noises = []
    for much, sensor in ((0.3, 0.5), (0.01, 1.0)):
        W = 0.1 * much * moves
        W[shape.last] = much * np.minimum(found.drive, moves[shape.last])
        W = np.maximum(W, 1e-8 * shape.size**2)
        noises.append(NoiseLevels(np.diag(W), sensor * deviation))
    return tuple(noises)
