"""What the compiled loop of `scenarios.kernel` is given: sizes as types, law, plant and run."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Shape(NamedTuple):
    """Sizes, as the lengths of tuples: state, input, both, the inputs that act over a period, these
    and the state, window, its blocks, the inputs that the law's rows ask for, m (n + m) for the
    heads of dense rows; n², the inputs that act on the model over a period, these and the state;
    two inputs. `dense`, `limited`, `foreseeing` and `told` are empty where rows are factorised,
    where no actuator limits the input, where the law does not know the signal, and where it is told
    of every sample as it is."""

    x: tuple
    u: tuple
    both: tuple
    acting: tuple
    z: tuple
    b: tuple
    block: tuple
    rows: tuple
    head: tuple
    square: tuple
    entering: tuple
    model: tuple
    pair: tuple
    dense: tuple
    limited: tuple
    foreseeing: tuple
    told: tuple


class Rows(NamedTuple):
    """A law. Of a factorised one `length` is the window, and `head` and `dense` are empty.

    state (rows, m, n), out (rows, m, q), last (rows, m, m), transition (q, block), enter (q, m),
    ahead (length, q, m) and behind (length, rows, m, q), flat. Of dense rows, `head`
    (rows, m, n + m): what x and the latest input, and `dense` (rows, m, width): what the others,
    the latest first, are multiplied by, padded. `kind` 0 one row, 1 a row per mode, 2 per mode and
    age.
    """

    length: int
    taps: int
    state: np.ndarray
    out: np.ndarray
    last: np.ndarray
    transition: np.ndarray
    enter: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray
    head: np.ndarray
    dense: np.ndarray
    width: int
    kind: int
    ages: int


class Plant(NamedTuple):
    """The truth: l of the inputs u_{k−l} that act, oldest first, and signals laid on its periods
    (`loop.Laid`)."""

    lags: np.ndarray
    maps: np.ndarray
    first: np.ndarray
    step: np.ndarray
    mode: np.ndarray
    map: np.ndarray
    age: np.ndarray


class Run(NamedTuple):
    """samples, the weight of the last one's input, where the late half begins, x0, actuators, root.

    Energy is |root u|², root (m, m) flat, or |u|² where that is empty. Actuator
    a clips to [low[a], high[a]], relative to the input before where `rate[a]`.
    """

    samples: int
    rest: float
    late: int
    x0: np.ndarray
    rate: np.ndarray
    low: np.ndarray
    high: np.ndarray
    root: np.ndarray


class Told(NamedTuple):
    """What reaches a law in every scenario, flat; of a perfect loop all is empty.

    sample : (scenario, sample), whose measurement is used, −1 for none: the last command is held
    reach : how many samples back these go, at most
    noise : (scenario, sample, n), what was added to it; empty for nothing
    row : (scenario, sample), the row of the law's table; empty where that is the plant's mode's
    """

    sample: np.ndarray
    reach: int
    noise: np.ndarray
    row: np.ndarray


PERFECT = Told(np.zeros(0, np.int32), 0, np.zeros(0), np.zeros(0, np.int32))
