"""A log that came through a browser: its columns, its plant as a problem, and both as HTML."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deadtime.app.documents import Document, file_stem, open_upload
from deadtime.app.page_outcome import MOST_MODES
from deadtime.base.errors import ArgumentError, DeadtimeError
from deadtime.base.text_tables import looks_numeric
from deadtime.identification import Identification, identify
from deadtime.identification.identification_figure import likelihood_figure, quick_figures
from deadtime.identification.log.read_options import PLAIN
from deadtime.identification.log.read_tables import (
    LogTable,
    columns_of,
    table_of,
    texts_of,
    timed,
)
from deadtime.problems import load_problem
from deadtime.reports.identification_report import (
    HEADINGS,
    Picture,
    identification_page,
    interval_rows,
    law_beside,
    pictures_of,
)
from deadtime.reports.report_folder import render

MOST_BYTES = 16_000_000
MOST_ROWS = 200_000
_MOST_COLUMNS = 40
_LONGEST = 2.0  # seconds: the longest delay that is looked for unless another is said,
_PERIODS = 60  # and in periods
_NO_INTERVAL = math.nan, math.nan
# What the page begins with; it offers the others, some of which take seconds.
_LAWS = b"".join(b'\n[[law]]\nkind = "%s"\n' % kind for kind in (b"averaged", b"mean", b"exact"))

Tell = Callable[[Any], None]


class LogRequest(NamedTuple):
    """A question to a log: its columns, and the ranges of modes and delays.

    states, inputs : their columns
    modes : the column of the mode, None for a plant of one, or the least and the largest number
        of modes that were not logged
    delay : the range that delays are looked for in, seconds
    at_samples : whether modes change at samples only
    per_mode : whether every mode has delays of its own
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    modes: str | tuple[int, int] | None
    delay: tuple[float, float]
    at_samples: bool = False
    per_mode: bool = False

    def command(self, name: str) -> str:
        """The command line for this request, which has no limit."""
        words = ["deadtime", "identify", f"{file_stem(name)}.csv"]
        words += [word for one in self.states for word in ("--states", one)]
        words += [word for one in self.inputs for word in ("--inputs", one)]
        if self.modes is None:
            words.append("--one-mode")
        else:
            several = isinstance(self.modes, tuple)
            words += ["--modes", "..".join(map(str, self.modes)) if several else str(self.modes)]
        words += ["--delay", *(f"{end:g}" for end in self.delay)]
        words += ["--switches", "samples"] if self.at_samples else []
        words += ["--per-mode"] if self.per_mode else []
        return shlex.join([*words, "--out", f"{file_stem(name)}.toml"])


class Columns(NamedTuple):
    """The columns of a log, and a guess of the request.

    rows, step : how many, and the median of the time between two, seconds
    names : all columns but that of the time
    numbers : columns that may be states or inputs
    modes : columns that may be of the mode
    guess : states and inputs are none where their names do not tell them
    sure : whether the names of the columns tell everything
    """

    rows: int
    step: float
    names: tuple[str, ...]
    numbers: tuple[str, ...]
    modes: tuple[str, ...]
    guess: LogRequest
    sure: bool


class IdentifiedPlant(NamedTuple):
    """A problem made of a log, and the results of its identification.

    delays : name, estimate and the ends of the interval of each, seconds; NaN if not found
    verdicts : delay errors that the laws tolerate, beside the uncertainty of the log
    rows : every unknown, its estimate and the ends of its interval
    pictures : predictions, modes and what is left
    """

    document: Document
    delays: tuple[tuple[str, float, float, float], ...]
    sentences: tuple[str, ...]
    verdicts: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    pictures: tuple[Picture, ...]


def too_large(name: str, size: int) -> ArgumentError:
    """The refusal of a log that is larger than a page takes."""
    return ArgumentError(
        f"{file_stem(name)}.csv has {size / 1e6:.1f} MB, a page takes logs of at most "
        f"{MOST_BYTES / 1e6:.0f} MB and {MOST_ROWS:,} rows: use `deadtime identify`, which has no "
        "limit, or keep a stretch of the log."
    )


def look_at(name: str, content: bytes, folder: Path) -> Columns:
    """The columns of a log: nothing that it says is trusted.

    Raises
    ------
    ArgumentError
        If it is too large, no table, or has no times.
    """
    source = _write_upload(name, content, folder)
    try:
        table = table_of(source, 0)._replace(name=source.name)
    except DeadtimeError as error:
        raise _without_folder(error, source) from None
    finally:
        source.unlink()
    if len(table.frame) > MOST_ROWS:
        raise ArgumentError(
            f"{source.name} has more than {MOST_ROWS:,} rows, the most that a page takes: use "
            "`deadtime identify`, which has no limit, or keep a stretch of the log."
        )
    table, clock, seconds = timed(table, PLAIN)
    frame, steps = table.frame, np.diff(seconds)
    step = float(np.median(steps)) if steps.size else np.nan
    others = [one for one in frame.columns if one != clock]
    if len(others) > _MOST_COLUMNS:
        raise ArgumentError(
            f"{source.name} has {len(others)} columns beside {clock}, a page offers at most "
            f"{_MOST_COLUMNS}: leave those out that are no states, inputs or modes."
        )
    numbers = tuple(one for one in others if _is_of_numbers(table, one))
    few = tuple(one for one in others if frame[one].drop_duplicates().size <= MOST_MODES)
    states, inputs = columns_of(others, "x"), columns_of(others, "u")
    words = [one for one in few if one not in numbers]
    mode = "mode" if "mode" in others else words[0] if len(words) == 1 else None
    rest = set(others) - {*states, *inputs}
    sure = bool(states and inputs) and (mode == "mode" or not rest)
    reach = _PERIODS * step if step > 0.0 else _LONGEST
    guess = LogRequest(
        tuple(states), tuple(inputs), mode, (0.0, float(f"{min(_LONGEST, reach):.3g}"))
    )
    return Columns(len(frame), step, tuple(others), numbers, few, guess, sure)


def _is_of_numbers(table: LogTable, column: str) -> bool:
    """Whether most values of a column are numbers; `identify` reports the others."""
    cells = [cell for cell in texts_of(table, column) if cell]
    return 2 * sum(map(looks_numeric, cells)) > len(cells)


def open_log(
    name: str, content: bytes, folder: Path, request: LogRequest, tell: Tell = lambda _: None
) -> tuple[IdentifiedPlant, Identification]:
    """Identify the plant of a log, CSV with a column t: nothing that it says is trusted.

    `name` is that on the machine of the person, `folder` an empty one to work in; `tell` is called
    with the stage of the work.

    Raises
    ------
    ArgumentError
        If it is malformed, with the line, or does not determine the plant.
    """
    source = _write_upload(name, content, folder)
    modes = request.modes
    try:
        fit = identify(
            source,
            range(modes[0], modes[1] + 1) if isinstance(modes, tuple) else modes,
            request.delay,
            per_mode=request.per_mode,
            switches="samples" if request.at_samples else "anywhere",
            states=request.states,
            inputs=request.inputs,
            progress=tell,
        )
    except DeadtimeError as error:
        raise _without_folder(error, source) from None
    finally:
        source.unlink()
    tell("computing the delay margins of the laws")
    saved = folder / f"{file_stem(name)}.toml"
    fit.save(saved, title=saved.stem)
    saved.write_bytes(saved.read_bytes() + _LAWS)
    verdicts, text = _verdicts(fit, saved), saved.read_bytes()
    saved.unlink()
    document = open_upload(saved.stem, text, folder)
    missing = fit.delays_not_found
    delays = tuple(
        (called, fit.estimate(one), *(_NO_INTERVAL if one in missing else fit.interval(one)))
        for one, called in _delays(fit)
    )
    low, high = request.delay
    sentences = (*fit.sentences, f"Delays were looked for between {low:g} and {high:g} s.")
    rows = tuple(map(tuple, interval_rows(fit)))
    pictures = pictures_of(quick_figures(fit))
    return IdentifiedPlant(document, delays, sentences, verdicts, rows, pictures), fit


def _delays(fit: Identification) -> list[tuple[str, str]]:
    """Every delay by its name among the unknowns, and in words: whose it is, in which mode."""
    names = [one for one in fit.names if one.startswith("delay")]
    if len(names) == 1:
        return [(names[0], "delay")]
    labels = [f"delay of {one}" for one in fit.inputs]
    if len(names) > len(labels):
        labels = [f"{one} in mode {mode}" for mode in fit.modes for one in labels]
    return list(zip(names, labels, strict=True))


def report_of(fit: Identification, plant: IdentifiedPlant, command: str) -> tuple[Picture, bytes]:
    """The likelihood over the delays, and the report on all, HTML; `command` makes it again."""
    (likelihood,) = pictures_of([likelihood_figure(fit)])
    sentences = (*plant.sentences, *plant.verdicts)
    title = f"A plant from {plant.document.name}.csv"
    page = identification_page(fit, (likelihood, *plant.pictures), sentences, title, command)
    return likelihood, page.encode()


def _write_upload(name: str, content: bytes, folder: Path) -> Path:
    if len(content) > MOST_BYTES:
        raise too_large(name, len(content))
    source = folder / f"{file_stem(name)}.csv"
    source.write_bytes(content)
    return source


def _without_folder(error: DeadtimeError, source: Path) -> ArgumentError:
    return ArgumentError(str(error).replace(str(source), source.name))


def _verdicts(fit: Identification, saved: Path) -> tuple[str, ...]:
    """Delays that each law of the problem tolerates, beside those that the log leaves open."""
    sentences, refused = [], ""
    for name, law in load_problem(saved).laws.items():
        if law.needs_preview:  # to compare with: no plant offers what it knows
            continue
        try:
            sentences.append(law_beside(fit, name, law))
        except DeadtimeError as error:
            refused = f"No margin of law “{name}”: {error}"
    return tuple(sentences) or (refused,)


_OF_DELAY = re.compile(r" is \S+ s, at 95 % within ")  # the headings say so


def identified_html(plant: IdentifiedPlant) -> str:
    """The delays, the sentences, and the delay errors that the laws tolerate."""
    sentences = [one for one in plant.sentences if not _OF_DELAY.search(one)]
    delays = [(*one, _off(*one[1:])) for one in plant.delays]
    return render("found.html.j2", delays=delays, lists=[sentences, plant.verdicts])


def _off(value: float, low: float, high: float) -> str:
    if math.isnan(low):
        return ""
    up, down = f"{1e3 * (high - value):.2g}", f"{1e3 * (value - low):.2g}"
    return f"± {up} ms" if up == down else f"+ {up} / − {down} ms"


def details_html(plant: IdentifiedPlant) -> str:
    """Predictions and modes; folded, the residuals and the table of all unknowns."""
    return render("found.html.j2", pictures=plant.pictures, headings=HEADINGS, rows=plant.rows)


def likelihood_html(picture: Picture | str) -> str:
    """The likelihood over the delays, or why it is not there."""
    return render("found.html.j2", likelihood=picture)
