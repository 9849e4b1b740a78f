"""What every section of a file shares."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, FailFast, Field


class First(FailFast):
    """Of a list with thousands of faults the first is enough; this one can stand in a union."""

    __hash__ = object.__hash__  # pyright: ignore[reportAssignmentType]


Vector = Annotated[list[float], First()]
Matrix = Annotated[list[Vector], First()]
Matrices = Annotated[list[Matrix], First()]
Poles = Annotated[list[float | str], First()]
PolesPerMode = Annotated[list[Poles], First()]
Integers = Annotated[list[int], First()]
Texts = Annotated[list[str], First()]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Probability = Annotated[float, Field(ge=0.0, lt=1.0)]
Count = Annotated[int, Field(strict=True, ge=0)]


class Section(BaseModel):
    """A table that refuses keys it does not know."""

    model_config = ConfigDict(extra="forbid", strict=False, title=None)
