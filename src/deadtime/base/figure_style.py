"""Style of figures: sizes, colours, lines and escaped text, for one column of a paper.

The first colours are those of Okabe and Ito, which colour-blind readers can distinguish; all are
legible on a light and on a dark background.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from deadtime.base.wording import one_line

BLUE, VERMILION, GREEN, PINK = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
ORANGE, SKY, BLACK = "#E69F00", "#56B4E9", "#000000"
PURPLE, BROWN, OLIVE, SLATE, GREY = "#7a4fa3", "#8b5a2b", "#7f9f2f", "#4a6b8a", "#8a8a8a"

COLOURS = (BLUE, VERMILION, GREEN, PINK, ORANGE, SKY, BLACK)
LINES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (6.0, 1.5, 1.0, 1.5, 1.0, 1.5)))
WIDTH = 4.6
STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "figure.constrained_layout.use": True,
    "figure.dpi": 180,
}


def plain(text: str) -> str:
    """A user's text for matplotlib, line by line: `$` escaped, unprintable characters replaced.

    A label that begins with an underscore would be left out of legends; a zero-width space before
    it prevents that.

    Examples
    --------
    >>> plain("_cost in $")
    '\u200b_cost in \\\\$'
    """
    text = "\n".join(map(one_line, text.split("\n"))).replace("$", r"\$")
    return f"\u200b{text}" if text.startswith("_") else text


def visible(norm: np.ndarray) -> np.ndarray:
    """|x| for a logarithmic axis, which has no 0."""
    return np.maximum(norm, np.finfo(float).tiny)
