"""Dashes of laws on a page, in the order of those of figures."""

from __future__ import annotations

DASHES = ("solid", "dashed", "dashdot", "dotted")


def dash_of(place: int) -> str:
    """The dash that figures give the same number."""
    return DASHES[place % len(DASHES)]
