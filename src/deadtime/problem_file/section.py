"""What every section of a file shares."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, FailFast


class _First(FailFast):
    """Of a list with thousands of faults the first is enough; this one can stand in a union."""

    __hash__ = object.__hash__


Vector = Annotated[list[float], _First()]
Matrix = Annotated[list[Vector], _First()]
Matrices = Annotated[list[Matrix], _First()]
Poles = Annotated[list[float | str], _First()]
PolesPerMode = Annotated[list[Poles], _First()]
Integers = Annotated[list[int], _First()]
Texts = Annotated[list[str], _First()]


class Section(BaseModel):
    """A table that refuses keys it does not know."""

    model_config = ConfigDict(extra="forbid", strict=False, title=None)
