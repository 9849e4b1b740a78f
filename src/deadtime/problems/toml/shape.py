"""What a key of a file holds, where that is a list: for messages about what it holds instead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class Shape:
    """A note on a field whose value is a list (immutable).

    Attributes
    ----------
    form : str
        The shape as messages write it, such as ``(modes, n, n)``; or what it is in words.
    example : list
        A value that fits.

    Examples
    --------
    >>> Shape("(n,)", [1.0, 0.0]).axes, Shape("a number or (n,)", [1.0]).is_array
    (1, False)
    """

    form: str
    example: Any

    @property
    def is_array(self) -> bool:
        """Whether nothing but an array of numbers will do."""
        return self.form.startswith("(") and self.form.endswith(")") and " or " not in self.form

    @property
    def axes(self) -> int:
        """How deep its lists go."""
        return np.ndim(self.example)
