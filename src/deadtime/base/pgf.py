"""Figures as PGF, which LaTeX sets in the fonts of its document; no TeX is needed to write them.

Matplotlib's own backend asks a TeX for the size of every text. Here sizes are those of the fonts
that other formats have: they decide how much room a text is given, and where the rest of the figure
lies; each text is anchored where it belongs and is as large as LaTeX makes it.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import IO, Any

from matplotlib import image
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.backends.backend_mixed import MixedModeRenderer
from matplotlib.backends.backend_pgf import RendererPgf
from matplotlib.figure import Figure

from deadtime.base.latex import latex

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
    """The backend's renderer, measured by the fonts of PNG files; rasters lie in PNG files."""

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
        return False  # so that images come without a transform

    def draw_image(self, gc: Any, x: Any, y: Any, im: Any, transform: Any = None) -> None:
        target = self._path.with_name(f"{self._path.stem}-{self.image_counter}.png")
        self.image_counter += 1
        image.imsave(target, im[::-1])
        width, height = im.shape[1] / self.dpi, im.shape[0] / self.dpi
        placed = f"left,bottom,x={x / self.dpi:f}in,y={y / self.dpi:f}in"
        size = f"width={width:f}in,height={height:f}in"
        self.fh.write(rf"\pgftext[{placed}]{{\includegraphics[{size}]{{{target.name}}}}}" + "%\n")


def _mixed(text: str) -> str:
    """Text with mathematics between dollars, which stays as it is."""
    parts = re.split(r"(?<!\\)\$", text)
    plain = [latex(part.replace(r"\$", "$")) for part in parts[::2]]
    maths = [f"${part}$" for part in parts[1::2]]
    return "".join(part for pair in zip(plain, [*maths, ""], strict=True) for part in pair)


def write_pgf(figure: Figure, path: Path) -> None:
    """Write a figure for \\input; what of it is a raster goes into PNG files beside it."""
    width, height = figure.get_size_inches()
    sizes = {"%NAME": path.name, "%WIDTH": f"{width:f}", "%HEIGHT": f"{height:f}"}
    head = re.sub("|".join(sizes), lambda found: sizes[found[0]], _HEAD)
    with path.open("w", encoding="utf-8") as file:
        file.write(head)
        renderer = _Renderer(figure, file, path)
        mixed: Any = MixedModeRenderer(figure, width, height, figure.dpi, renderer)
        figure.draw(mixed)
        file.write(_END)
