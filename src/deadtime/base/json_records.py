"""Results as JSON data: dictionaries, lists, texts, numbers, and None for ∞ and NaN."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from os import PathLike
from typing import Any

import numpy as np


def record(result: object, *names: str) -> dict[str, Any]:
    """Attributes of a result, by their names, as plain data.

    Examples
    --------
    >>> record(complex(1.0, float("inf")), "real", "imag")
    {'real': 1.0, 'imag': None}
    """
    return {name: plain(getattr(result, name)) for name in names}


def plain(value: Any) -> Any:
    """A value as plain data: arrays as lists, dataclasses and named tuples by their fields.

    Examples
    --------
    >>> plain({"peak": np.array([1.5, np.inf]), "settles": (None, np.bool_(True))})
    {'peak': [1.5, None], 'settles': [None, True]}
    """
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if is_dataclass(value):
        return record(value, *(field.name for field in fields(value)))
    if hasattr(value, "_fields"):
        return record(value, *value._fields)
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, PathLike):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def json_text(value: Any, indent: int = 2, ascii_only: bool = False) -> str:
    """A value as a JSON document."""
    return json.dumps(plain(value), indent=indent, ensure_ascii=ascii_only, allow_nan=False)
