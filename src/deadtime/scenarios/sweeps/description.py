"""What the attributes of a sweep's store say about it, checked before anything is made of them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from deadtime.base.errors import ArgumentError
from deadtime.problems.toml import require_valid
from deadtime.scenarios.dataset import METRICS
from deadtime.scenarios.sweeps.blocks import BlockLayout
from deadtime.scenarios.sweeps.study import require_axis

MOST = 10**8  # cells of a grid, and scenarios

Strings = Annotated[list[str], Field(min_length=1)]


class _Definition(BaseModel):
    """What all results depend on; more stands there than reading needs."""

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
    """The definition of a store's study, and how its grid is cut.

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
