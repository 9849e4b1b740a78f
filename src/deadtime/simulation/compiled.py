"""Imperfections as arrays: those that the compiled loop takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from deadtime.base.checks import read_only
from deadtime.imperfections import Additive, Imperfection, Limiting, Sizes
from deadtime.simulation.imperfect import tells_commands

Pairs = Sequence[tuple[Imperfection, np.random.Generator]]  # imperfections and their streams


class Arrays(NamedTuple):
    """What is added to the measured states, and the limits of the inputs in their order.

    Attributes
    ----------
    noise : (samples, n), or (0, n) for none
    low, high : (count, m)
    relative : (count,)
        Whether the bounds are of the change from the input applied before.
    commanded : bool
        Whether the law takes the inputs that it asked for to be those applied.
    """

    noise: Float[np.ndarray, "sample n"]
    low: Float[np.ndarray, "limit m"]
    high: Float[np.ndarray, "limit m"]
    relative: Bool[np.ndarray, " limit"]
    commanded: bool

    @classmethod
    def of(cls, pairs: Pairs, sizes: Sizes, samples: int, predict: str) -> Arrays:
        """The arrays of a run; everything random is drawn from the streams."""
        sensors = [(each, rng) for each, rng in pairs if isinstance(each, Additive)]
        limits = [each.limits(sizes) for each, _ in pairs if isinstance(each, Limiting)]
        noise = np.zeros((samples if sensors else 0, sizes.states))
        with np.errstate(over="ignore", invalid="ignore"):
            for sensor, rng in sensors:
                noise += sensor.sampler(sizes, rng)(samples)
        shape = len(limits), sizes.inputs
        return cls(
            read_only(noise),
            read_only(np.reshape([limit.low for limit in limits], shape)),
            read_only(np.reshape([limit.high for limit in limits], shape)),
            read_only(np.array([limit.relative for limit in limits], np.bool_)),
            tells_commands(predict),
        )


def takes(pairs: Pairs) -> bool:
    """Whether the compiled loop takes them all.

    Examples
    --------
    >>> from deadtime.imperfections import Dropout, Noise
    >>> rng = np.random.default_rng(0)
    >>> takes([(Noise(0.1), rng)]), takes([(Noise(0.1), rng), (Dropout(0.1), rng)])
    (True, False)
    """
    return all(isinstance(each, Additive | Limiting) for each, _ in pairs)
