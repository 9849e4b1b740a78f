"""How many bits ball arithmetic computes with: one number for the whole process."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

_ONE_THREAD = threading.RLock()


@contextmanager
def precision(bits: int = 128) -> Iterator[None]:
    """Compute with this many bits inside; other threads wait, for all share one precision."""
    from flint import ctx

    with _ONE_THREAD:
        before = ctx.prec
        ctx.prec = bits
        try:
            yield
        finally:
            ctx.prec = before
