"""What a law remembers, as the compiled loop reads it: the maps of its estimate composed."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import read_only
from deadtime.feedback import memory as feedback
from deadtime.scenarios.lane_types import MemoryLanes


def memory_form(memory: feedback.Memory, outputs: Float[np.ndarray, "mode p n"]) -> MemoryLanes:
    """A memory with what moves it over whole periods; `outputs` is the C of the plant."""
    modes, p, n = memory.C.shape
    m, lags = memory.lag.shape[1], np.unique(memory.lag)[::-1]
    rows = []
    for i in range(modes):
        move = np.eye(n, n + lags.size * m)
        for piece in range(memory.first[i], memory.first[i + 1]):
            acting = np.searchsorted(-lags, -memory.lag[piece])
            move = memory.Phi[piece] @ move
            move[:, n + acting * m + np.arange(m)] += memory.Gamma[piece]
        parts = move, -memory.C[i], memory.gain[i], memory.push[i] if memory.push.size else []
        rows.append(np.concatenate([np.ravel(part) for part in parts]))
    at_output = n * (n + lags.size * m)
    at_gain = at_output + p * n
    return MemoryLanes(
        read_only(np.array(rows)),
        at_output,
        at_gain,
        at_gain + n * p,
        read_only(outputs.reshape(modes, -1)),
        read_only(lags.copy()),
        read_only(memory.start[:n]),
        read_only(memory.tracked.ravel()),
        memory.tracked.shape[0],
        read_only(memory.reference.ravel()),
        memory.start.size - n - memory.tracked.shape[0],
        memory.step,
    )
