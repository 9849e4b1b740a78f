"""Colours and dashes of laws, the same on a page as in the figures; readable on light and dark."""

from __future__ import annotations

from deadtime.plotting import COLOURS

GREY = "#8a8a8a"
PAGE_COLOURS = (*COLOURS[:6], GREY)  # black would be lost on a dark page
DASHES = ("solid", "dashed", "dashdot", "dotted")


def colour_of(place: int) -> str:
    """The colour of the law at a place of the list."""
    return PAGE_COLOURS[place % len(PAGE_COLOURS)]


def dash_of(place: int) -> str:
    """The dash of the law at a place of the list."""
    return DASHES[place // len(PAGE_COLOURS) % len(DASHES)]
