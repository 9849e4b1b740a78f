"""The colours of laws: the same law has the same colour in every figure and on every page.

All of them can be read on a light and on a dark ground; laws whose colour repeats are told apart
by their dashes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from deadtime.base import figure_style as style
from deadtime.base.figure_style import GREY
from deadtime.problems.law_registry import LAWS

HUES = {name: known.named.colour for name, known in LAWS.items() if known.named.colour}
_SPARE = (
    style.BLUE, style.VERMILION, style.GREEN, style.PINK, style.ORANGE, style.SKY, style.PURPLE,
    style.BROWN, style.OLIVE, style.SLATE,
)  # fmt: skip


class Look(NamedTuple):
    """How a law is drawn: its colour, and which dash of a list, 0 for the first."""

    colour: str
    dash: int


def colour_of(law: str) -> str:
    """The colour of a law: warm for the mean laws, blue for the averaged ones."""
    return HUES.get(law, GREY)


def colours_of(laws: Sequence[str], oracle: str = "") -> dict[str, str]:
    """A colour for every law, those without one of their own by what is left over.

    Examples
    --------
    >>> colours_of(["mean", "fast", "truth"], oracle="truth")
    {'mean': '#D55E00', 'fast': '#0072B2', 'truth': '#8a8a8a'}
    """
    colours = {law: HUES[law] for law in laws if law in HUES} | {oracle: GREY}
    spare = [colour for colour in _SPARE if colour not in colours.values()]
    others = [law for law in laws if law not in colours]
    colours |= {law: spare[i] if i < len(spare) else GREY for i, law in enumerate(others)}
    return {law: colours[law] for law in laws}


def looks_of(laws: Sequence[str]) -> dict[str, Look]:
    """A colour and a dash for every law; a name that comes twice counts once.

    Examples
    --------
    >>> looks_of(["mean", "oracle"])["oracle"]
    Look(colour='#8a8a8a', dash=0)
    """
    looks, seen = {}, Counter[str]()
    for law, colour in colours_of(list(dict.fromkeys(laws))).items():
        looks[law] = Look(colour, seen[colour])
        seen[colour] += 1
    return looks
