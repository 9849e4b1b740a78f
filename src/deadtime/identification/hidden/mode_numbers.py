"""What is asked of modes that were not logged: their number, or several to choose from."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from deadtime.base.checks import brief
from deadtime.base.errors import ArgumentError

_MOST = 20  # numbers, and modes


def numbers_of(modes: Any) -> tuple[int, ...] | None:
    """The numbers of hidden modes that `modes` asks for, rising; None where it names a column.

    Examples
    --------
    >>> numbers_of("gear"), numbers_of(2), numbers_of(range(1, 4))
    (None, (2,), (1, 2, 3))
    """
    if modes is None or isinstance(modes, str):
        return None
    given = list(modes) if isinstance(modes, Iterable) else [modes]
    whole = [isinstance(one, int | np.integer) and not isinstance(one, bool) for one in given]
    if not given or not all(whole) or min(given) < 1 or max(given) > _MOST:
        raise ArgumentError(
            "modes must be the column of the mode, None for one mode, or, of modes that were not "
            f"logged, their number, 1 to {_MOST}, or numbers to choose from such as range(1, 4), "
            f"got {brief(modes)}."
        )
    return tuple(sorted({int(one) for one in given}))
