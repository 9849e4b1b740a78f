"""The precision of ball arithmetic, which is global to the process."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

_ONE_THREAD = threading.RLock()


@contextmanager
def precision(bits: int = 128) -> Iterator[None]:
    """A block with this precision in bits; other threads wait, because all share one precision."""
    from flint import ctx

    with _ONE_THREAD:
        before = ctx.prec
        ctx.prec = bits
        try:
            yield
        finally:
            ctx.prec = before
