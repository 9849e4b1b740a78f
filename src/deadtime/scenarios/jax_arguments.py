"""What the compiled loop of `deadtime.scenarios.jax_kernel` is given.

Tuples of NumPy's arrays or of JAX's; a None in one is part of the shape it is compiled for.
"""

from __future__ import annotations

from typing import Any, NamedTuple


class Sizes(NamedTuple):
    """What a compiled function is made for, beside the shapes of its arguments.

    `wide` is how much acts over a period; `back` and `taps` are how many inputs the plant and the
    law look back; `window` is W, the periods of a block of factorised rows, and 0 for dense rows;
    `own` says that each scenario looks up its row, rather than choosing among all of them.
    """

    samples: int
    late: int
    wide: int
    back: int
    taps: int
    window: int
    own: bool
    path: bool


class Law(NamedTuple):
    """A law's rows, and of factorised ones the rest of their `WindowForm`, None of dense ones.

    A dense row acts on x and on past inputs, the latest first, a factorised one on x, on the sum
    over the block so far and on the oldest input: table (rows, m, n + …).
    """

    table: Any
    transition: Any = None
    enter: Any = None
    ahead: Any = None
    behind: Any = None


class Signals(NamedTuple):
    """Maps (size, map), and for each period and scenario its map and, where there are several, its
    row of the law (period, scenario)."""

    maps: Any
    index: Any
    row: Any


class Run(NamedTuple):
    """x0 (n,), the weight of the last input, and per actuator: whether relative to the input
    before, low and high (actuator, m)."""

    x0: Any
    rest: Any
    rate: Any
    low: Any
    high: Any
