"""Laws on outputs in eight scenarios: the outputs of their plants, and observers."""

# Intrinsics take one argument less than the functions that declare them.
# pyright: reportCallIssue=false

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deadtime.feedback.memory import Memory
from deadtime.loop.observer_steps import (
    ObserverState,
    begin_observer,
    correct_observer,
    predict_observer,
    select_mode,
)
from deadtime.numerics.kernels import inner_kernel
from deadtime.numerics.lanes import LANES, lanes_of, load, own_product, same, store
from deadtime.numerics.numbers import arrays_of, where


class OutputLanes(NamedTuple):
    """The outputs of eight plants.

    table : (modes, p n), C of each mode;  own : (p n, lane), of the mode of each plant
    mode : (lane,), which that is;  y : (p, lane), what is measured
    """

    table: np.ndarray
    own: np.ndarray
    mode: np.ndarray
    y: np.ndarray

    @classmethod
    def of(cls, outputs: np.ndarray) -> OutputLanes:
        modes, p, n = outputs.shape
        own, y = arrays_of((p * n,), (p,), lanes=(LANES,))
        return cls(outputs.reshape(modes, -1), own, np.full(LANES, -1), y)


class ObserverLanes(NamedTuple):
    """The observers of eight scenarios: their state, the mode of each, and the modes told."""

    state: ObserverState
    mode: np.ndarray
    told: np.ndarray

    @classmethod
    def of(cls, memory: Memory) -> ObserverLanes:
        return cls(ObserverState.of(memory, LANES), np.full(LANES, -1), np.full(LANES, -1))


@inner_kernel
def look_at_outputs(shape, outputs, mode, x):
    """y of every scenario, by the C of its plant's mode."""
    select_mode(outputs.table, outputs.own, outputs.mode, mode)
    return own_product(outputs.own, 0, x, same(0.0, shape.output))


@inner_kernel
def begin_observers(memory, kept):
    """z before anything is measured, after inputs and answers of 0."""
    state = lanes_of(kept.state)
    begin_observer(memory, state)
    for i in range(state.asked.size):
        state.asked[i] = 0.0


@inner_kernel
def observe_again(shape, memory, kept, outputs, line, row, mode, heard, lost, k):
    """z at sample k of every scenario, from what is heard; `line` are the inputs to row `row`."""
    state, y = lanes_of(kept.state), lanes_of(outputs.y)
    store(outputs.y, 0, heard)
    for i in range(y.size):
        y[i] = where(lost[0] > 0.0, math.nan, y[i])
    if k > 0:
        predict_observer(memory, state, line, row)
    select_mode(memory.matrices, kept.state.own, kept.mode, mode)
    correct_observer(memory, state, y, line[row], memory.reference[k], k)
    return load(kept.state.z, 0, shape.kept)


@inner_kernel
def note_answer(kept, u):
    """Keep what the law asked for."""
    store(kept.state.asked, 0, u)
