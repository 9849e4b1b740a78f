"""What a page says of a plant that was found in a log, as HTML."""

from __future__ import annotations

import re
from collections.abc import Iterable
from html import escape

from deadtime.app.uploaded_log import FoundPlant
from deadtime.reports.identification_report import HEADINGS, Picture

_OF_DELAY = re.compile(r" is \S+ s, at 95 % within ")  # the headings say so
CSS = """
.found { font-size: 0.95rem; color: inherit; }
.found .delay { font-size: 1.15rem; margin: 2px 0 6px; }
.found ul { margin: 4px 0; padding-left: 1.2em; } .found li { margin: 3px 0; }
.found figure { margin: 10px 0; }
.found figcaption { font-size: 0.85rem; opacity: 0.85; margin-top: 3px; }
.found img { width: 100%; display: block; background: #fff; border-radius: 6px; }
.found .pair { display: grid; gap: 0 14px; align-items: start;
               grid-template-columns: repeat(auto-fit, minmax(min(100%, 300px), 1fr)); }
.found .scroll { overflow-x: auto; } .found .scroll img { min-width: 620px; }
.found summary { cursor: pointer; margin: 6px 0; }
.found table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
.found td, .found th { text-align: right; padding: 2px 8px; white-space: nowrap; }
.found td:first-child { text-align: left; }
@media (max-width: 480px) { .found td, .found th { padding: 2px 4px; font-size: 0.8rem; } }
"""


def shown(found: FoundPlant) -> str:
    """The delays, what there is to say, what the laws bear."""
    said = [one for one in found.sentences if not _OF_DELAY.search(one)]
    return (
        f"<div class='found'>{''.join(map(_delay, found.delays))}{_list(said)}"
        f"{_list(found.verdicts)}</div>"
    )


def likelihood(picture: Picture | str) -> str:
    """The likelihood over the delays, or why it is not there."""
    body = f"<p>{escape(picture)}</p>" if isinstance(picture, str) else _figure(picture)
    return f"<div class='found'>{body}</div>"


def details(found: FoundPlant) -> str:
    """Predictions and modes; to be opened, what is left, and the table of all unknowns."""
    head = "".join(f"<th>{escape(one)}</th>" for one in HEADINGS)
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in found.rows
    )
    wide, *left = map(_figure, found.pictures)
    return (
        f"<div class='found'>{wide}<details><summary>What is left of the log</summary>"
        f"<div class='pair'>{''.join(left)}</div></details><details><summary>Every "
        "unknown, with its 95 % interval</summary><div class='scroll'><table>"
        f"<tr>{head}</tr>{body}</table></div></details></div>"
    )


def _delay(one: tuple[str, float, float, float]) -> str:
    name, value, low, high = one
    wide = f"{1e3 * (high - value):.2g}", f"{1e3 * (value - low):.2g}"
    off = f"± {wide[0]} ms" if wide[0] == wide[1] else f"+ {wide[0]} / − {wide[1]} ms"
    return (
        f"<div class='delay'>{escape(name[:1].upper() + name[1:])} <b>{value:.4g} s</b> {off} "
        f"<small>({low:.5g} … {high:.5g} s at 95&nbsp;%)</small></div>"
    )


def _list(sentences: Iterable[str]) -> str:
    return f"<ul>{''.join(f'<li>{escape(one)}</li>' for one in sentences)}</ul>"


def _figure(picture: Picture) -> str:
    """A figure; the widest scrolls where it would be unreadable."""
    kind = " class='scroll'" if picture.name == "predictions" else ""
    return (
        f"<figure><div{kind}><img alt='{escape(picture.name)}' src='{picture.image}'></div>"
        f"<figcaption>{escape(picture.caption)}</figcaption></figure>"
    )
