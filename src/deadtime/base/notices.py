"""Notices while something takes long, to be replaced by who has a place to say them."""

from __future__ import annotations

from collections.abc import Callable


def _nothing() -> None:
    """Libraries are silent."""


compiling: Callable[[], None] = _nothing  # once compiling takes a while
