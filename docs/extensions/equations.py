"""Equations and functions, linked both ways from one table, that of theory/equations.md.

Every number in the table's first column is an anchor; every name in its last column is told which
numbers it stands for. A reference in a docstring to a number that the table lacks is a warning,
and warnings are errors.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from docutils import nodes

PAGE = "theory/equations"
TABLE = Path(__file__).parents[1] / f"{PAGE}.md"
NUMBER = re.compile(r"\((\d+)\)")
STATEMENT = re.compile(r"\b(Theorem|Lemma) (\d\.\d)\b")
# "equation (5)", "equations (14) to (19), (64)", "inequality (4)" of a docstring, "the law (80)".
CITED = re.compile(
    r"\b((?:in)?equalit(?:y|ies)|equations?|law) (\(\d+\)(?:(?:,| and| to) \(\d+\))*)"
)
LEMMAS = re.compile(r"\b(Theorem|Lemma)(s?) (2\.\d)( (?:to|and) 2\.\d)?")


def labels(cell: str) -> list[tuple[str, str]]:
    """(anchor, as printed) of each number in a cell: (76) to (78) is three."""
    text = re.sub(
        r"\((\d+)\) to \((\d+)\)",
        lambda m: ", ".join(f"({i})" for i in range(int(m[1]), int(m[2]) + 1)),
        cell,
    )
    numbers = [(f"equation-{i}", f"({i})") for i in NUMBER.findall(text)]
    return numbers + [
        (f"{kind}-{at.replace('.', '-')}".lower(), f"{kind} {at}")
        for kind, at in STATEMENT.findall(text)
    ]


@cache
def functions() -> dict[str, list[tuple[str, str]]]:
    """Name of a function, as the table has it: the numbers it stands for."""
    found: dict[str, list[tuple[str, str]]] = {}
    for line in TABLE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 4 and labels(cells[0]):
            prefix = ""
            for name in re.findall(r"`([^`]+)`", cells[-1]):
                name = prefix + name if name.startswith(".") else name
                prefix = name.rpartition(".")[0]
                found.setdefault(name, []).extend(labels(cells[0]))
    return found


def links_of(full: str) -> list[str]:
    """References to the equations of an object, given its full name."""
    return [
        f":ref:`{shown} <{anchor}>`"
        for name, numbers in functions().items()
        if full == name or full.endswith(f".{name}")
        for anchor, shown in numbers
    ]


def cited(text: str) -> str:
    """Escaped prose with references in place of the numbers it cites."""

    def numbers(found: re.Match[str]) -> str:
        linked = NUMBER.sub(r":ref:`(\1) <equation-\1>`", found[2])
        return f"{found[1]} {linked}"

    def statement(found: re.Match[str]) -> str:
        kind, plural, first, more = found.groups()
        shown = f":ref:`{kind}{plural} {first} <{kind.lower()}-{first.replace('.', '-')}>`"
        if more:
            word, last = more.split()
            shown += f" {word} :ref:`{last} <{kind.lower()}-{last.replace('.', '-')}>`"
        return shown

    return LEMMAS.sub(statement, CITED.sub(numbers, text))


def anchor_rows(app, doctree: nodes.document) -> None:
    """An anchor for each number of the table, known to `:ref:`."""
    if app.env.docname != PAGE:
        return
    known = app.env.domains.standard_domain
    seen: set[str] = set()
    for row in doctree.findall(nodes.row):
        first = row[0][0] if len(row[0]) else None
        if first is None:
            continue
        for anchor, shown in labels(first.astext()):
            if anchor not in seen:
                seen.add(anchor)
                first.insert(0, nodes.target("", "", ids=[anchor]))
                known.labels[anchor] = (PAGE, anchor, shown)
                known.anonlabels[anchor] = (PAGE, anchor)


def setup(app) -> dict[str, bool]:
    app.connect("doctree-read", anchor_rows)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
