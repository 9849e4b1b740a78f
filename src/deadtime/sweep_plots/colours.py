"""The colours of laws: the same law has the same colour in every figure."""

from __future__ import annotations

from collections.abc import Sequence

from deadtime.plotting import COLOURS

HUES = {
    "averaged": COLOURS[0],
    "averaged, dwell-aware": COLOURS[5],
    "mean": COLOURS[1],
    "mean, dwell-aware": COLOURS[4],
    "expected": COLOURS[2],
    "averaged, minimax": COLOURS[3],
    "averaged, one-gain minimax": "#7a4fa3",
    "optimal": "#303030",
}
OTHER = "#8c8c8c"
_SPARE = (*COLOURS[:6], "#7a4fa3", "#8b5a2b", "#7f9f2f", "#4a6b8a")


def colour_of(law: str) -> str:
    """The colour of a law: warm for the mean laws, blue for the averaged ones."""
    return HUES.get(law, OTHER)


def colours_of(laws: Sequence[str], oracle: str = "") -> dict[str, str]:
    """A colour for every law, those without one of their own by what is left over.

    Examples
    --------
    >>> colours_of(["mean", "fast", "truth"], oracle="truth")
    {'mean': '#D55E00', 'fast': '#0072B2', 'truth': '#000000'}
    """
    found = {law: HUES[law] for law in laws if law in HUES} | {oracle: COLOURS[6]}
    spare = [colour for colour in _SPARE if colour not in found.values()]
    others = [law for law in laws if law not in found]
    found |= {law: spare[i] if i < len(spare) else OTHER for i, law in enumerate(others)}
    return {law: found[law] for law in laws}
