"""Blocks of cells, the pieces of work and of storage: their costs, and their entries in a store."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from deadtime.base.checks import read_only
from deadtime.base.errors import ArgumentError, DeadtimeError
from deadtime.feedback import Law
from deadtime.imperfections import Disturbance, Relaying, TimingImperfection
from deadtime.imperfections.received import is_batched
from deadtime.plant import Window
from deadtime.plant.weight import PLAIN, text_of
from deadtime.problems.toml import require_valid
from deadtime.scenarios.dataset import METRICS
from deadtime.scenarios.sweeps.study import Loop, Study, require_axis
from deadtime.switching import SwitchingSignal

# Measured seconds on one core of the machine of benchmarks/README.md, of a period of a scenario
# under one law, times n m / 2 for the first three:
_FACTORED = 3e-9  # with factorised rows
_TAP = 1.5e-10  # for every past input of a dense row
_PREVIEWED = 1.2e-8  # of a law that knows the signal
_RECEIVED = 2e-8  # with imperfect sensors
_FELT = 5e-8  # for each disturbance
_KEPT = 3e-8  # of a law with an observer or a filter
_SEEN = 1e-7  # with measurements within periods
_ALONE = 2e-6  # by `simulate`
_CALLED = 2.5e-5  # by `simulate`, a call of Python at each sample
_CELL = 0.01  # plant, laws and tables of a cell
_SHORTEST, _LONGEST = 1.0, 20.0  # seconds of a block: longer than its overhead, short to repeat
_PIECES = 20_000  # blocks, at most, unless they were longer than 20 s
_BYTES = 2.0**26  # of a chunk
_LOOKED_AT = 64  # cells whose cost is estimated; those of other cells are products


@dataclass(frozen=True)
class BlockLayout:
    """How the grid is cut into blocks of neighbouring cells.

    Attributes
    ----------
    shape : tuple of int
        Of the grid.
    block : tuple of int
        Of a block; those at the far ends may be smaller.
    """

    shape: tuple[int, ...]
    block: tuple[int, ...]

    @property
    def counts(self) -> tuple[int, ...]:
        """Blocks along each axis."""
        pairs = zip(self.shape, self.block, strict=True)
        return tuple(-(-size // width) for size, width in pairs)

    @property
    def size(self) -> int:
        """Number of blocks."""
        return math.prod(self.counts)

    def slices(self, number: int) -> tuple[slice, ...]:
        """The cells of a block, along each axis."""
        where = np.unravel_index(number, self.counts) if self.counts else ()
        return tuple(
            slice(int(i) * width, min((int(i) + 1) * width, size))
            for i, width, size in zip(where, self.block, self.shape, strict=True)
        )

    def cells(self, number: int) -> Iterator[tuple[int, ...]]:
        """Places of a block's cells, in the order of arrays."""
        return itertools.product(*(range(s.start, s.stop) for s in self.slices(number)))


def layout_of(study: Study, costs: Float[np.ndarray, ...]) -> BlockLayout:
    """Blocks of about a second of work: the same for every number of workers.

    If there would be more than some 20,000, blocks are larger, up to 20 s. The last axes are filled
    first, so that a block's cells are neighbours in the arrays.

    Examples
    --------
    >>> BlockLayout((4, 5, 6), (1, 2, 6)).counts, BlockLayout((4, 5, 6), (1, 2, 6)).slices(2)
    ((4, 3, 1), (slice(0, 1, None), slice(4, 5, None), slice(0, 6, None)))
    """
    target = float(np.clip(costs.sum() / _PIECES, _SHORTEST, _LONGEST))
    cells = target / float(costs.mean())
    cells = min(cells, _BYTES / (8.0 * len(study.laws) * study.scenarios))
    block: list[int] = []
    for size in reversed(study.shape):
        room = max(1, math.floor(cells))
        block.append(math.ceil(size / math.ceil(size / room)))
        cells /= block[-1]
    return BlockLayout(study.shape, tuple(reversed(block)))


@lru_cache(4)
def costs_of(study: Study) -> Float[np.ndarray, ...]:
    """Estimated seconds of every cell on one core; computed once for a study.

    In a large grid costs are estimated along lines through its middle, one per axis, and a cell's
    cost is the product of the factors of its places. A cell that cannot be built costs `_CELL`.
    """
    if study.size <= _LOOKED_AT:
        found = [_cost(study, index) for index in np.ndindex(study.shape)]
        return read_only(np.array(found).reshape(study.shape))
    middle = tuple(size // 2 for size in study.shape)
    base = _cost(study, middle)
    whole = np.full(study.shape, base)
    for axis, size in enumerate(study.shape):
        places = np.unique(np.linspace(0, size - 1, min(size, 8)).round().astype(int))
        seen = [_cost(study, (*middle[:axis], int(i), *middle[axis + 1 :])) for i in places]
        along = np.interp(np.arange(size), places, seen) / base
        whole *= along.reshape([-1 if i == axis else 1 for i in range(len(study.shape))])
    return read_only(whole)


def _cost(study: Study, index: tuple[int, ...]) -> float:
    try:
        loop = study.loop(study.cell(index))
    except DeadtimeError:
        return _CELL
    periods = study.scenarios * loop.horizon / loop.step
    return _CELL + periods * sum(_of_law(loop, law) for law in loop.laws.values())


def _of_law(loop: Loop, law: Law) -> float:
    """Seconds of a period of a scenario."""
    if not law.is_linear and law.filter is None:
        return _CALLED
    if not all(map(is_batched, loop.imperfections)):
        return _ALONE
    extra = _FELT * sum(isinstance(one, Disturbance) for one in loop.imperfections)
    for kind, cost in ((Relaying, _RECEIVED), (TimingImperfection, _SEEN)):
        if any(isinstance(one, kind) for one in loop.imperfections):
            extra += cost
    if law.filter is not None or law.observer is not None:
        return _ALONE if law.needs_preview else extra + _KEPT
    taps = Window.of(law.plant.longest_delay, loop.step).count
    size = max(1.0, loop.plant.states * loop.plant.inputs / 2.0)
    if law.needs_preview:
        return extra + size * _PREVIEWED
    try:
        table = law.digital(loop.step, SwitchingSignal.constant(0), 1)
    except DeadtimeError:
        return 0.0
    return extra + size * (_FACTORED if table.factor is not None else _FACTORED + _TAP * taps)


def example_loop(study: Study, tries: int = 20) -> Loop | None:
    """The first loop of the grid that can be built, if one of the first few can."""
    for cell in itertools.islice(study.cells(), tries):
        try:
            return study.loop(cell)
        except DeadtimeError:
            continue
    return None


def facts_of(study: Study) -> dict[str, Any]:
    """The store's attributes of loops: the oracle's name, |x(0)|, and the cost's formula."""
    loop = example_loop(study)
    if loop is None:
        return {"oracle": "", "start": float("nan")}
    oracles = [name for name in study.laws if name in loop.laws and loop.laws[name].needs_preview]
    facts = {"oracle": oracles[0] if oracles else "", "start": float(np.linalg.norm(loop.x0))}
    # The last cell beside the first: an axis may change the weight.
    try:
        last = study.loop(study.cell(tuple(size - 1 for size in study.shape)))
    except DeadtimeError:
        last = loop
    texts = {text_of(each.weight) for each in (loop, last)}
    if len(texts) > 1:
        facts["cost"] = "∫xᵀQx + uᵀRu, Q and R by cell"
    elif texts != {PLAIN}:
        facts["cost"] = texts.pop()
    return facts


MOST = 10**8  # cells of a grid, and scenarios

Strings = Annotated[list[str], Field(min_length=1)]


class _Definition(BaseModel):
    """The entries of a study's definition that reading needs; others are allowed."""

    model_config = ConfigDict(extra="allow", strict=True)

    grid: dict[str, Annotated[list[Any], Field(min_length=1)]]
    laws: Strings
    scenarios: Annotated[int, Field(ge=1, le=MOST)]
    metrics: Strings


class _StoreAttributes(BaseModel):
    """The attributes that reading needs."""

    model_config = ConfigDict(extra="allow", strict=True)

    definition: _Definition
    block: list[Annotated[int, Field(ge=1)]]


def read_description(attributes: Mapping[str, Any]) -> tuple[dict[str, Any], BlockLayout]:
    """The definition of a store's study, and the layout of its blocks.

    Raises
    ------
    ArgumentError
        If they are missing or malformed, or contradict each other.

    Examples
    --------
    >>> read_description({"block": [1]})
    Traceback (most recent call last):
    deadtime.ArgumentError: its definition is no JSON.
    """
    known = dict(attributes)
    try:
        known["definition"] = json.loads(str(known.get("definition")))
    except (ValueError, RecursionError):
        raise ArgumentError("its definition is no JSON.") from None
    checked = require_valid(_StoreAttributes, known)
    definition: dict[str, Any] = checked.definition.model_dump()
    shape = tuple(map(len, definition["grid"].values()))
    if unknown := set(definition["metrics"]) - set(METRICS):
        raise ArgumentError(f"its metric {min(unknown)!r:.80} is not known.")
    for name in definition["grid"]:
        require_axis(name, ())
    if math.prod(shape) > MOST:
        raise ArgumentError(f"its grid has more than {MOST:,} cells.")
    block = tuple(checked.block)
    if len(block) != len(shape) or any(b > s for b, s in zip(block, shape, strict=True)):
        raise ArgumentError(f"block is {list(block)}, of a grid of the shape {shape}.")
    return definition, BlockLayout(shape, block)
