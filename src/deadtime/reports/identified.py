"""The report on an identification: one HTML file, all figures in it."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from io import BytesIO
from os import PathLike
from pathlib import Path

from deadtime.base.errors import ArgumentError
from deadtime.identification import Identification
from deadtime.identification.report_figures import figures_of
from deadtime.reports.page import render

HEADINGS = ("", "estimate", "from", "to")


def interval_rows(fit: Identification) -> list[tuple[str, str, str, str]]:
    """Every unknown with its estimate and its 95 % interval."""
    rows = []
    for name in fit.names:
        low, high = fit.interval(name)
        rows.append((name, *(f"{value:.5g}" for value in (fit.estimate(name), low, high))))
    return rows


def write_identification(
    fit: Identification,
    path: str | PathLike[str],
    sentences: Sequence[str] = (),
    title: str = "A plant from a log",
    command: str = "",
) -> None:
    """Write the page on an identification.

    Parameters
    ----------
    fit : Identification
    path : path
        The file, HTML; nothing else is written.
    sentences : sequence of str
        What it opens with; those of the identification by default.
    title : str
        Its heading.
    command : str
        How to make it again, for its last line.

    Raises
    ------
    ArgumentError
        If the file cannot be written.
    """
    figures = []
    for name, caption, figure in figures_of(fit):
        buffer = BytesIO()
        figure.savefig(buffer, format="png")
        data = b64encode(buffer.getvalue()).decode("ascii")
        image = f"data:image/png;base64,{data}"
        figures.append({"name": name, "caption": caption, "image": image})
    text = render(
        "identified.html.j2",
        title=title,
        fit=fit,
        sentences=sentences or fit.sentences,
        first=figures[0],
        figures=figures[1:],
        headings=HEADINGS,
        rows=interval_rows(fit),
        command=command,
    )
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise ArgumentError(
            f"report {str(path)!r} cannot be written ({error.strerror}): choose another file."
        ) from None
