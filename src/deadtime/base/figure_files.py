"""Figures of a given width whose files are the same every time, as publishers want them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal, TypeAlias

from matplotlib import rc_context, rcParams
from matplotlib.figure import Figure

from deadtime.base.errors import ArgumentError
from deadtime.base.figure_style import STYLE

Width: TypeAlias = Literal["column", "page"] | float
WIDTHS = {"column": 3.5, "page": 7.16}  # inches: of one and of two columns of a journal
_SMALL = {
    "font.size": 8.0, "legend.fontsize": 7.5, "axes.titlesize": 8.5, "lines.linewidth": 1.2
}  # fmt: skip
# Fonts as TrueType (Type 42), which publishers take and editors can edit; identifiers that are no
# random numbers.
_FILES: dict[Any, Any] = {"pdf.fonttype": 42, "ps.fonttype": 42, "svg.hashsalt": "deadtime"}
_DATES: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}


class PaperFigure(Figure):
    """A matplotlib figure that is written without a date, fonts as Type 42, and as PGF without TeX.

    `savefig` takes what matplotlib's takes.
    """

    def savefig(self, fname: Any, **options: Any) -> None:
        ending = Path(fname).suffix[1:] if isinstance(fname, (str, Path)) else ""
        kind = str(options.get("format") or ending or rcParams["savefig.format"]).lower()
        if kind == "pgf" and isinstance(fname, (str, Path)):
            from deadtime.base.pgf import write_pgf

            return write_pgf(self, Path(fname))
        if kind in _DATES:
            options["metadata"] = _DATES[kind] | (options.get("metadata") or {})
        with rc_context(_FILES):
            super().savefig(fname, **options)


def new_figure(natural: float, height: float, width: Width | None = None) -> PaperFigure:
    """An empty figure, `natural` inches wide unless a `width` is given."""
    return PaperFigure(figsize=(natural if width is None else inches(width), height))


def legend_columns(figure: Figure, names: Iterable[str], most: int, beside: float = 0.0) -> int:
    """How many keys of a legend fit beside each other, where `beside` inches are taken."""
    longest = max(map(len, names), default=1)
    return max(1, min(most, int(16.0 * (figure.get_figwidth() - beside)) // (longest + 7)))


def style_of(width: Width | None) -> dict[Any, Any]:
    """Parameters to draw with: smaller letters in figures that are narrow."""
    return STYLE | _SMALL if width is not None and inches(width) < 4.0 else STYLE


def inches(width: Width) -> float:
    """A width in inches.

    Examples
    --------
    >>> inches("column"), inches(5)
    (3.5, 5.0)
    """
    if isinstance(width, str) and width in WIDTHS:
        return WIDTHS[width]
    if not isinstance(width, (int, float)) or not 1.5 <= width <= 40.0:
        raise ArgumentError(
            f'width must be "column" ({WIDTHS["column"]} in), "page" ({WIDTHS["page"]} in) or '
            f"inches from 1.5 to 40, got {width!r}."
        )
    return float(width)
