"""A log that came through a browser: its plant as a problem, and what to say of it."""

from __future__ import annotations

import html
import io
from base64 import b64encode
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deadtime.app.documents import Document, file_stem, open_upload
from deadtime.base.errors import ArgumentError, DeadtimeError
from deadtime.identification import Identification, identify
from deadtime.identification.recording import read_table
from deadtime.identification.report_figures import figures_of
from deadtime.margins import delay_margin
from deadtime.problems import load_problem
from deadtime.reports.identified import HEADINGS, interval_rows

MOST_BYTES = 4_000_000
MOST_ROWS = 20_000
_LONGEST = 2.0  # seconds: the longest delay that is looked for,
_PERIODS = 60  # and in periods
# What the page begins with; it offers the others, some of which take seconds.
_LAWS = b"".join(b'\n[[law]]\nkind = "%s"\n' % kind for kind in (b"averaged", b"mean", b"exact"))


class FoundPlant(NamedTuple):
    """A problem made of a log, and what was found.

    rows : every unknown, its estimate and the ends of its interval
    picture : the likelihood over the delays, PNG
    """

    document: Document
    sentences: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    picture: bytes


def too_large(name: str, size: int) -> ArgumentError:
    """What to say of a log that is larger than a page takes."""
    return ArgumentError(
        f"{file_stem(name)}.csv has {size / 1e6:.1f} MB, a page takes logs of at most "
        f"{MOST_BYTES / 1e6:.0f} MB: use `deadtime identify`, which has no limit."
    )


def open_log(name: str, content: bytes, folder: Path) -> FoundPlant:
    """Identify the plant of a log: nothing that it says is trusted.

    Parameters
    ----------
    name : str
        Its name on the machine of the person.
    content : bytes
        CSV with columns t, x1, x2, …, u1, u2, …, and mode where there are several.
    folder : Path
        An empty folder to work in.

    Raises
    ------
    ArgumentError
        If it is too large, malformed, or does not tell the plant; the line is named.
    """
    if len(content) > MOST_BYTES:
        raise too_large(name, len(content))
    stem = file_stem(name)
    source = folder / f"{stem}.csv"
    source.write_bytes(content)
    try:
        several, high = _look(source)
        fit = identify(source, "mode" if several else None, (0.0, high))
    except DeadtimeError as error:
        raise ArgumentError(str(error).replace(str(source), source.name)) from None
    finally:
        source.unlink()
    saved = folder / f"{stem}.toml"
    fit.save(saved, title=stem)
    text = saved.read_bytes()
    said = (f"Delays were looked for up to {high:.3g} s.", *fit.sentences, *_verdict(fit, saved))
    saved.unlink()
    _, _, figure = next(figures_of(fit))
    picture = io.BytesIO()
    figure.savefig(picture, format="png")
    rows = tuple(map(tuple, interval_rows(fit)))
    document = open_upload(stem, text + _LAWS, folder)
    return FoundPlant(document, said, rows, picture.getvalue())


def _look(source: Path) -> tuple[bool, float]:
    """Whether a log has a column of the mode, and the longest delay to look for, seconds."""
    import pandas as pd

    frame = read_table(source, MOST_ROWS + 1).rename(columns=lambda c: str(c).strip())
    if len(frame) > MOST_ROWS:
        raise ArgumentError(
            f"{source.name} has more than {MOST_ROWS:,} rows, the most that a page takes: use "
            "`deadtime identify`, which has no limit."
        )
    times = [pd.to_numeric(frame[name], errors="coerce") for name in ("t", "time") if name in frame]
    steps = np.diff(np.asarray(times[0], dtype=float)) if times else np.empty(0)
    step = float(np.median(steps)) if steps.size else np.nan
    reach = _PERIODS * step if np.isfinite(step) and step > 0.0 else _LONGEST
    return "mode" in frame, min(_LONGEST, reach)


def _verdict(fit: Identification, saved: Path) -> list[str]:
    """The first law of the problem that was made, beside what the log leaves open."""
    try:
        name, law = next(iter(load_problem(saved).laws.items()))
        margin = delay_margin(fit.plant, law, fit.step)
        return [f"Law “{name}”, each mode held: {fit.verdict(margin, law)}"]
    except DeadtimeError as error:
        return [f"No margin of a law: {error}"]


def shown(found: FoundPlant) -> str:
    """What a page says of it, as HTML."""
    image = b64encode(found.picture).decode("ascii")
    said = "".join(f"<li>{html.escape(one)}</li>" for one in found.sentences)
    head = "".join(f"<th>{html.escape(one)}</th>" for one in HEADINGS)
    body = "".join(
        f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in found.rows
    )
    return (
        f"<div class='found'><ul>{said}</ul><img alt='log likelihood over the delays' "
        f"src='data:image/png;base64,{image}'><details><summary>Every unknown, with its 95 % "
        f"interval</summary><div class='wide'><table><tr>{head}</tr>{body}</table></div></details>"
        "</div>"
    )


CSS = """
.found ul { margin: 4px 0; padding-left: 1.2em; } .found li { margin: 3px 0; }
.found img { width: 100%; max-width: 460px; background: #fff; border-radius: 6px; }
.found summary { cursor: pointer; margin: 4px 0; } .found .wide { overflow-x: auto; }
.found td, .found th { text-align: right; padding: 2px 8px; white-space: nowrap; }
.found td:first-child { text-align: left; }
"""
