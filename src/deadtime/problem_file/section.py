"""What every section of a file shares."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

Vector = list[float]
Matrix = list[Vector]
Matrices = list[Matrix]
Poles = list[float | str]


class Section(BaseModel):
    """A table that refuses keys it does not know."""

    model_config = ConfigDict(extra="forbid", strict=False, title=None)
