"""Imperfections as tables and sentences name them."""

from __future__ import annotations

import math
import re

import numpy as np

from deadtime.imperfections.base import Imperfection
from deadtime.imperfections.disturbances import StepDisturbance

_LONG = re.compile(r"\b\d+\.\d{6,}(e[+-]?\d+)?\b")


def in_words(each: Imperfection) -> str:
    """What an imperfection is: an offset by its modes, everything else by its class and numbers.

    A constant force that acts all through a run and changes with the mode is an offset, c_σ.

    Examples
    --------
    >>> from deadtime.imperfections import Dropout
    >>> in_words(StepDisturbance([[0.0, 0.0], [0.3, 0.0]])), in_words(Dropout(0.1))
    ('offset [0.3, 0] in mode 1', 'Dropout(probability=0.1)')
    >>> in_words(Dropout(1 / 30))
    'Dropout(probability=0.03333)'
    """
    if not isinstance(each, StepDisturbance) or np.ndim(each.force) != 2:
        return _briefly(each)
    if each.start > 0.0 or math.isfinite(each.end):
        return _briefly(each)
    rows = [
        f"[{', '.join(f'{value:g}' for value in row)}] in mode {mode}"
        for mode, row in enumerate(np.asarray(each.force, dtype=float))
        if row.any()
    ]
    return f"offset {' and '.join(rows) or 0}"


def _briefly(each: Imperfection) -> str:
    """Its class and numbers; of numbers with many digits, such as estimates, the first four."""
    return _LONG.sub(lambda number: f"{float(number[0]):.4g}", repr(each))
