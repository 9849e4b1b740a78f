"""Figures of a given width whose files are the same every time, as publishers want them.

LaTeX sets the texts of a PGF file in the fonts of its document. Matplotlib's own backend needs a
TeX installation to measure every text. Here texts are measured in the fonts of the other formats,
which fixes the layout; LaTeX then sets each text at its anchor, in its own size.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any, Literal, TypeAlias

from matplotlib import image, rc_context, rcParams
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.backends.backend_mixed import MixedModeRenderer
from matplotlib.backends.backend_pgf import RendererPgf
from matplotlib.figure import Figure

from deadtime.base.errors import ArgumentError
from deadtime.base.figure_style import STYLE
from deadtime.base.latex import latex

Width: TypeAlias = Literal["column", "page"] | float
WIDTHS = {"column": 3.5, "page": 7.16}  # inches: of one and of two columns of a journal
_SMALL = {
    "font.size": 8.0, "legend.fontsize": 7.5, "axes.titlesize": 8.5, "lines.linewidth": 1.2
}  # fmt: skip
# TrueType fonts (Type 42), which publishers require and editors can edit; no random identifiers.
_FILES: dict[Any, Any] = {"pdf.fonttype": 42, "ps.fonttype": 42, "svg.hashsalt": "deadtime"}
_DATES: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}


class PaperFigure(Figure):
    """A matplotlib figure whose files have no date, Type 42 fonts, and PGF without a TeX.

    `savefig` has the arguments of matplotlib's.
    """

    def savefig(self, fname: Any, **options: Any) -> None:
        ending = Path(fname).suffix[1:] if isinstance(fname, (str, Path)) else ""
        kind = str(options.get("format") or ending or rcParams["savefig.format"]).lower()
        if kind == "pgf" and isinstance(fname, (str, Path)):
            return write_pgf(self, Path(fname))
        if kind in _DATES:
            options["metadata"] = _DATES[kind] | (options.get("metadata") or {})
        with rc_context(_FILES):
            super().savefig(fname, **options)


def new_figure(natural: float, height: float, width: Width | None = None) -> PaperFigure:
    """An empty figure, `natural` inches wide unless a `width` is given."""
    return PaperFigure(figsize=(natural if width is None else inches(width), height))


def legend_columns(figure: Figure, names: Iterable[str], most: int, beside: float = 0.0) -> int:
    """How many legend entries fit beside each other, with `beside` inches taken; at most `most`."""
    longest = max(map(len, names), default=1)
    return max(1, min(most, int(16.0 * (figure.get_figwidth() - beside)) // (longest + 7)))


def style_of(width: Width | None) -> dict[Any, Any]:
    """Matplotlib parameters, with smaller letters in a narrow figure."""
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


_HEAD = r"""% In the preamble: \usepackage{pgf,graphicx}
% then \input{%NAME} where the figure is to stand
\begingroup
\providecommand{\mathdefault}[1]{#1}
\makeatletter
\begin{pgfpicture}
\pgfpathrectangle{\pgfpointorigin}{\pgfqpoint{%WIDTHin}{%HEIGHTin}}
\pgfusepath{use as bounding box, clip}
"""
_END = "\\end{pgfpicture}\n\\makeatother\n\\endgroup\n"


class _Renderer(RendererPgf):
    """Matplotlib's PGF renderer with texts measured by Agg, and images written to PNG files."""

    def __init__(self, figure: Figure, file: IO[str], path: Path) -> None:
        super().__init__(figure, file)
        width, height = figure.bbox.size
        self._path, self._measure = path, RendererAgg(width, height, figure.dpi)

    def get_text_width_height_descent(self, s: str, prop: Any, ismath: Any) -> Any:
        return self._measure.get_text_width_height_descent(s, prop, ismath)

    def draw_text(self, gc: Any, x: Any, y: Any, s: str, *args: Any, **more: Any) -> None:
        ismath = args[2] if len(args) > 2 else more.get("ismath", False)
        super().draw_text(gc, x, y, _mixed(s) if ismath else latex(s), *args, **more)

    def option_scale_image(self) -> Any:
        return False  # then `draw_image` gets images in pixels, without a transform

    def draw_image(self, gc: Any, x: Any, y: Any, im: Any, transform: Any = None) -> None:
        target = self._path.with_name(f"{self._path.stem}-{self.image_counter}.png")
        self.image_counter += 1
        image.imsave(target, im[::-1])
        width, height = im.shape[1] / self.dpi, im.shape[0] / self.dpi
        placed = f"left,bottom,x={x / self.dpi:f}in,y={y / self.dpi:f}in"
        size = f"width={width:f}in,height={height:f}in"
        self.fh.write(rf"\pgftext[{placed}]{{\includegraphics[{size}]{{{target.name}}}}}" + "%\n")


def _mixed(text: str) -> str:
    """Text escaped for LaTeX, except mathematics between dollars."""
    parts = re.split(r"(?<!\\)\$", text)
    plain = [latex(part.replace(r"\$", "$")) for part in parts[::2]]
    maths = [f"${part}$" for part in parts[1::2]]
    return "".join(part for pair in zip(plain, [*maths, ""], strict=True) for part in pair)


def write_pgf(figure: Figure, path: Path) -> None:
    """Write a figure for \\input, its images as PNG files beside it."""
    width, height = figure.get_size_inches()
    sizes = {"%NAME": path.name, "%WIDTH": f"{width:f}", "%HEIGHT": f"{height:f}"}
    head = re.sub("|".join(sizes), lambda found: sizes[found[0]], _HEAD)
    with path.open("w", encoding="utf-8") as file:
        file.write(head)
        renderer = _Renderer(figure, file, path)
        mixed: Any = MixedModeRenderer(figure, width, height, figure.dpi, renderer)
        figure.draw(mixed)
        file.write(_END)
