"""The report on an identification: one HTML file, all figures in it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from os import PathLike
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from deadtime.base.files import replacing
from deadtime.feedback import Law
from deadtime.identification import Identification
from deadtime.identification.identification_figure import figures_of
from deadtime.identification.validation import Validation
from deadtime.reports.report_folder import inlined, render

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEADINGS = ("parameter", "estimate", "lower 95 %", "upper 95 %")
PROCESS_HEADINGS = ("process", "gain", "time constants", "dead time")
VALIDATION_HEADINGS = ("fit, %", "free run", "a row ahead", "last value", "a constant")
_NORMAL = 1.96  # deviations, on both sides of 95 %
_NOTHING = 1e-3  # an estimate of noise below this share of its upper bound is undetermined


class Picture(NamedTuple):
    """A figure of a page; image : its PNG as a data address."""

    name: str
    caption: str
    image: str


def pictures_of(figures: Iterable[tuple[str, str, Figure]]) -> tuple[Picture, ...]:
    """The pictures of figures given as (name, caption, figure)."""
    return tuple(Picture(name, caption, inlined(figure)[1]) for name, caption, figure in figures)


def listed_names(fit: Identification) -> list[str]:
    """The unknowns without constant terms, which are about a level of the log."""
    return [name for name in fit.names if not name.startswith("constant")]


def interval_rows(fit: Identification) -> list[tuple[str, str, str, str]]:
    """Every unknown with its estimate and its 95 % interval: of noise that may be none, from 0.

    The operating point replaces the constant terms: the inputs as chosen, and the states at which
    the plant is at rest under them.
    """
    rows = []
    chosen = "chosen" if fit.plant.modes == 1 else ""  # with one mode, every input has its rest
    if (point := fit.operating_point) is not None:
        rows += [
            (f"{name} at rest", f"{u:.5g}", chosen, "")
            for name, u in zip(fit.inputs, point.u, strict=True)
        ]
        for name, x, error in zip(fit.states, point.x, fit.rest_error, strict=True):
            ends = (f"{x + side * error:.5g}" for side in (-_NORMAL, _NORMAL))
            rows.append(
                (f"{name} at rest", f"{x:.5g}", *(ends if np.isfinite(error) else ("", "")))
            )
    for name in listed_names(fit):
        value, (low, high) = fit.estimate(name), fit.interval(name)
        if name in fit.delays_not_found:
            rows.append((name, f"{value:.5g}", "", ""))
        elif low == 0.0 and value < _NOTHING * high:
            rows.append((name, "undetermined", "0", f"{high:.2g}"))
        else:
            rows.append((name, *(f"{one:.5g}" for one in (value, low, high))))
    return rows


def process_rows(fit: Identification) -> list[tuple[str, str, str, str]]:
    """Gain, time constants and dead time of every process, with 95 % intervals."""
    return [(one.label(fit.plant.modes), *one.cells) for one in fit.processes]


def validation_rows(validation: Validation) -> list[tuple[str, ...]]:
    """The fits in percent of every output, under `VALIDATION_HEADINGS`."""
    figures = validation.free_run, validation.one_step, validation.last_value
    return [
        (name, *(f"{one:.1f}" if np.isfinite(one) else "" for one in each), "0")
        for name, *each in zip(validation.outputs, *figures, strict=True)
    ]


def sampling_of(fit: Identification) -> str:
    """Number of samples of the log and its period."""
    return f"{fit.samples:,} samples, every {fit.step:.4g} s"


def law_beside(fit: Identification, name: str, law: Law, step: float | None = None) -> str:
    """The delay error that a law tolerates, and that of the log; at the log's period by default.

    Raises
    ------
    ArgumentError
        If the law is of another plant, or has no delay margin.
    """
    from deadtime.margins import delay_margin

    margin = delay_margin(fit.plant, law, fit.step if step is None else step)
    return f"Law “{name}”, each mode held: {fit.verdict(margin, law, step)}"


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
        The first sentences; those of the identification by default.
    title : str
        Its heading.
    command : str
        How to make it again, for its last line.

    Raises
    ------
    ArgumentError
        If the file cannot be written.
    """
    text = identification_page(fit, pictures_of(figures_of(fit)), sentences, title, command)
    with replacing(path, "report") as place:
        place.write_text(text, encoding="utf-8")


def identification_page(
    fit: Identification,
    pictures: Sequence[Picture],
    sentences: Sequence[str],
    title: str,
    command: str,
) -> str:
    """The page as text; the first picture is the likelihood's."""
    return render(
        "identified.html.j2",
        title=title,
        fit=fit,
        sampling=sampling_of(fit),
        sentences=sentences or fit.sentences,
        first=pictures[0],
        figures=pictures[1:],
        process_headings=PROCESS_HEADINGS,
        processes=process_rows(fit),
        headings=HEADINGS,
        rows=interval_rows(fit),
        validation_headings=VALIDATION_HEADINGS,
        validation=[] if fit.validation is None else validation_rows(fit.validation),
        command=command,
    )
