"""Tables in text files of any program: encoding, separator, header and units are recognised.

The separator is the first of ; tab | , blanks that divides most lines into the same number of
cells, two at the least, beneath a header: a line of so many cells without numbers. Lines before the
header and comments are left out, and so are rows of units beneath it, which hold text alone. All
that differs from a plain CSV file is listed in `read_as`.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from itertools import zip_longest
from os import PathLike
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.base.files import read_bytes, shown

_MOST_BYTES = 500_000_000
_LOOKED_AT = 400  # lines that a separator and a header are found in
_MOST_UNITS = 3  # rows beneath a header: units, descriptions, types
_SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", " ": "blanks"}
_PLAIN = frozenset("0123456789+-eE")
_SWAPPED = str.maketrans(",.", ".,")
_COMMENT = re.compile(r"\s*(?:#(?!N/A|NUM!|VALUE!|DIV/0!|REF!)|%|//)\s*(.*)", re.IGNORECASE)
_POINT = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")
_COMMA = re.compile(r"[+-]?(?:\d+,\d*|,\d+)(?:[eE][+-]?\d+)?")
_STAMP = re.compile(r"\d{1,4}[-/.:]\w{1,3}[-/.:]?\d")
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x19\x1b-\x1f]")
_MARKS = (  # the longer ones first: UTF-32 begins as UTF-16 does
    (b"\xff\xfe\0\0", "utf-32"),
    (b"\0\0\xfe\xff", "utf-32"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
    (b"\xef\xbb\xbf", "utf-8-sig"),
)
_THOUSANDS = re.compile(
    r"[+-]?[1-9]\d{0,2}(?:(?:,\d{3}){2,}|(?:,\d{3})+\.\d+|(?:\.\d{3}){2,}|(?:\.\d{3})+,\d+"
    r"|(?:[ '’\u00a0\u202f]\d{3})+(?:[.,]\d+)?)"
)
_PERHAPS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")  # a thousand, or three decimals
# Texts that historians and spreadsheets write in place of a number.
_MISSING = frozenset(
    (
        *("nan", "null", "none", "na", "n/a", "-", "--", "---", "?", "bad", "error", "missing"),
        *("#n/a", "#num!", "#value!", "#ref!", "#div/0!", "invalid", "bad data", "bad input"),
        *("bad quality", "bad total", "i/o timeout", "no data", "no sample", "no result"),
        *("no value", "scan off", "scan timeout", "pt created", "calc failed", "comm fail"),
        *("intf shut", "not connect", "configure", "shutdown", "arc off-line", "equip fail"),
    )
)


class TextTable(NamedTuple):
    """The cells of a file, column by column, without blanks around them.

    name : of the file, for messages
    columns : cells by the name of their column
    lines : of every row, as an editor counts them
    decimal : "." or ","
    read_as : phrases on what differs from a plain CSV file
    """

    name: str
    columns: dict[str, list[str]]
    lines: list[int]
    decimal: str = "."
    read_as: tuple[str, ...] = ()

    def place(self, row: int) -> str:
        return f"{self.name}, line {self.lines[row]}"

    def rows(self, kept: Sequence[int]) -> TextTable:
        columns = {name: [cells[k] for k in kept] for name, cells in self.columns.items()}
        return self._replace(columns=columns, lines=[self.lines[k] for k in kept])


def read_text_table(
    path: str | PathLike[str],
    sep: str | None = None,
    decimal: str | None = None,
    wanted: Sequence[str] = (),
) -> TextTable:
    """The table in a text file.

    Parameters
    ----------
    path : path
        The file: UTF-8, UTF-16 or, as a last resort, Windows-1252.
    sep, decimal : str, optional
        The separator of columns and the sign of decimals, as in pandas.read_csv; found by default.
    wanted : sequence of str
        Names of which the header has one, which decide between two lines that may be the header.

    Raises
    ------
    ArgumentError
        If the file is no table; the message names the line and what to do.
    """
    name = shown(path)
    if decimal not in (None, ".", ","):
        raise ArgumentError(f'decimal, --decimal, must be "." or ",", got {decimal!r}.')
    text, encoding = _decoded(name, read_bytes(path, _MOST_BYTES))
    every = re.split(r"\r\n|\n|\r", text)
    marked = {k: match[1] for k, line in enumerate(every, 1) if (match := _COMMENT.match(line))}
    kept = [k for k, line in enumerate(every, 1) if k not in marked and line.strip()]
    lines = _Lines(kept, [every[k - 1] for k in kept])
    if kept and (match := re.fullmatch(r"\s*sep=(.)\s*", lines.rows[0])):  # Excel's own line
        sep = sep or match[1]
        lines = lines.since(1)
    if not lines.rows:
        raise ArgumentError(f"{name} is no CSV table with one header line: it is empty.")
    before, below, sep = _divided(name, sep, lines, marked, wanted)
    header, rows = below.numbers[0], below.rows[1:]
    names, last = _names(below.rows[0], rows)
    width, units = len(names), _units(rows[: 1 + _MOST_UNITS])
    phrases = [*encoding]
    if above := sorted(number for number in (*marked, *before) if number < header):
        phrases.append(f"{_listed('line', above)} before the header left out")
    if units:
        phrases.append(f"{_listed('line', below.numbers[1 : 1 + units])} (units) left out")
    if last:
        phrases.append("separators at the ends of lines ignored")
    numbers, rows = below.since(1 + units)
    if not all(map(any, rows)):  # spreadsheets end in rows of empty cells
        numbers = [k for k, row in zip(numbers, rows, strict=True) if any(row)]
        rows = [row for row in rows if any(row)]
    whole = len(rows) < 2 or len(rows[-1]) >= width or len(rows[-2]) < width
    if not (whole or text.endswith(("\n", "\r"))):
        phrases.append(f"line {numbers[-1]}, cut short, left out")
        numbers, rows = numbers[:-1], rows[:-1]
    for number, cells in zip(numbers, rows, strict=True):
        if len(cells) > width and any(cells[width:]):
            raise ArgumentError(
                f"{name}, line {number} has {len(cells)} cells, and the header, line {header}, "
                f"has {width} names: name every column. Numbers with decimal commas need another "
                "separator of columns, such as semicolons."
            )
    each = zip_longest(*rows, fillvalue="") if rows else ([] for _ in names)
    columns = {one: list(cells) for one, cells in zip(names, each, strict=False)}
    columns |= {one: [""] * len(rows) for one in names if one not in columns}
    table = TextTable(name, columns, numbers)
    sign = _decimal_sign(columns) if decimal is None else decimal
    form = [] if sep == "," else [f"columns separated by {_SEPARATORS.get(sep, repr(sep))}"]
    form += ["decimal commas"] if sign == "," else []
    phrases = [", ".join(form), *phrases] if form else phrases
    return table._replace(decimal=sign, read_as=tuple(phrases))


def numbers_in(
    cells: Sequence[str], decimal: str
) -> tuple[Float[np.ndarray, " row"], dict[str, int], int | None]:
    """The numbers in cells, NaN for missing ones; how often each text stood for one; a bad row.

    Examples
    --------
    >>> numbers_in(["1,5", "Bad", "", "-2"], ",")
    (array([ 1.5,  nan,  nan, -2. ]), {'Bad': 1}, None)
    """
    if set("".join(cells)) <= _PLAIN | {decimal}:
        points = cells if decimal == "." else [cell.replace(",", ".") for cell in cells]
        with suppress(ValueError):
            return np.array(list(map(float, points))), {}, None
    values, missing = np.full(len(cells), np.nan), Counter()
    for row, cell in enumerate(cells):
        if not cell:
            continue
        text = cell.translate(_SWAPPED) if decimal == "," else cell  # points are of thousands
        if _POINT.fullmatch(text):
            values[row] = float(text.replace("d", "e").replace("D", "e"))
        elif cell.lower() in _MISSING:
            missing[cell] += 1
        else:
            return values, dict(missing), row
    return values, dict(missing), None


def with_points(cells: Sequence[str], decimal: str) -> list[str]:
    """Cells, of which numbers have decimal points; others, such as stamps, are as they were."""
    if decimal == ".":
        return list(cells)
    swapped = [cell.translate(_SWAPPED) for cell in cells]
    each = zip(cells, swapped, strict=True)
    # A point that separates thousands becomes a comma, which makes the cell no number.
    return [new if looks_numeric(cell) else cell for cell, new in each]


def looks_numeric(cell: str) -> bool:
    """Whether a cell is a number in some notation."""
    return bool(_POINT.fullmatch(cell) or _COMMA.fullmatch(cell) or _THOUSANDS.fullmatch(cell))


def is_missing(cell: str) -> bool:
    """Whether a cell is empty or one of the texts for no value."""
    return not cell or cell.lower() in _MISSING


def advice_on(cell: str) -> str:
    """Advice on a cell that is no number."""
    if _COMMA.fullmatch(cell):
        return (
            'say decimal=",", --decimal ",", if its comma is of decimals, in all numbers alike, or '
            "write numbers without signs of thousands."
        )
    if _THOUSANDS.fullmatch(cell):
        return "write numbers without signs of thousands."
    return "leave the cell empty where nothing was measured."


class _Lines(NamedTuple):
    """Lines, or their cells, with their numbers."""

    numbers: list[int]
    rows: list

    def since(self, first: int) -> _Lines:
        return _Lines(self.numbers[first:], self.rows[first:])


def _decoded(name: str, content: bytes) -> tuple[str, list[str]]:
    """The text of a file, and a phrase on its encoding unless it is UTF-8."""
    start = content[:1000]
    marked = [code for mark, code in _MARKS if content.startswith(mark)]
    odd, even = start[1::2].count(0), start[::2].count(0)
    if marked or max(odd, even) > len(start) // 4:
        code = marked[0] if marked else "utf-16-le" if odd > even else "utf-16-be"
        phrases = [] if code == "utf-8-sig" else [f"encoding {code[:6].upper()}"]
    else:
        code, phrases = "utf-8", []
    try:
        text = content.decode(code)
    except UnicodeDecodeError:
        if code != "utf-8":
            called = code.removesuffix("-sig").upper()
            raise ArgumentError(f"{name} is not {called} text: save it as UTF-8.") from None
        text = content.decode("cp1252", errors="replace")
        phrases = ["encoding Windows-1252, as it is not UTF-8"]
    if _CONTROL.search(text):
        raise ArgumentError(f"{name} is no text: save it as a CSV file in UTF-8.")
    return text, phrases


def _cells(name: str, lines: _Lines, sep: str) -> _Lines:
    """The cells of lines."""
    if sep == " ":
        return _Lines(lines.numbers, [line.split() for line in lines.rows])
    reader, rows, numbers = csv.reader(lines.rows, delimiter=sep, skipinitialspace=True), [], []
    try:
        for cells in reader:
            rows.append(cells)
            numbers.append(reader.line_num)
    except csv.Error as error:
        number = lines.numbers[min(reader.line_num, len(lines.rows) - 1)]
        raise ArgumentError(f"{name}, line {number}: {error}.") from None
    if any(" " in line or "\t" in line for line in lines.rows):
        rows = [[cell.strip() for cell in cells] for cells in rows]
    return _Lines([lines.numbers[k - 1] for k in numbers], rows)


def _divided(
    name: str, sep: str | None, lines: _Lines, comments: dict[int, str], wanted: Sequence[str]
) -> tuple[list[int], _Lines, str]:
    """The lines before the header, the rows from it on, and the separator."""
    given = [" " if sep in (r"\s+", "whitespace") else sep] if sep else list(_SEPARATORS)
    unnamed = None
    for one in given:
        if len(one) != 1 or one in '"\r\n':
            raise ArgumentError(
                r'sep, --sep, must be one character, such as ";", or "\s+" for blanks, got '
                f"{one!r}."
            )
        some = _cells(name, _Lines(lines.numbers[:_LOOKED_AT], lines.rows[:_LOOKED_AT]), one)
        counts = Counter(map(_width, some.rows[len(some.rows) // 2 :]))
        width = max(counts, key=lambda size: (counts[size], size))
        if width < 2 and not (sep and len(some.rows) > 1):
            continue
        header = _header(some.rows, width, wanted)
        if header is not None:
            return lines.numbers[:header], _cells(name, lines.since(header), one), one
        # NumPy and MATLAB write names as the last comment before the numbers.
        above = [number for number in comments if number < some.numbers[0]][-1:]
        if above:
            called = _cells(name, _Lines(above, [comments[above[0]]]), one)
            if len(called.rows) == 1 and len(called.rows[0]) == width:
                rows = _cells(name, lines, one)
                return [], _Lines(above + rows.numbers, called.rows + rows.rows), one
        if counts[width] > len(some.rows) // 4 and any(map(looks_numeric, some.rows[0])):
            first = next(k for k, row in enumerate(some.rows) if _width(row) == width)
            unnamed = unnamed or some.numbers[first]
    if unnamed is not None:
        raise ArgumentError(
            f"{name} has no header: name the columns in its first line, such as t,x1,u1, before "
            f"the numbers of line {unnamed}."
        )
    one = sep or ","
    return [], _cells(name, lines, one), one


def _width(cells: list[str]) -> int:
    """The number of cells, without an empty last one."""
    return len(cells) - (len(cells) > 1 and not cells[-1])


def _header(rows: list[list[str]], width: int, wanted: Sequence[str]) -> int | None:
    """The first row that may be a header, one with a wanted name if there is one."""
    may = []
    for place, cells in enumerate(rows):
        if _width(cells) != width and len(cells) != width and len(cells) != width + 1:
            continue
        if any(looks_numeric(cell) or _STAMP.search(cell) for cell in cells):
            break
        if 2 * sum(map(bool, cells)) >= width:
            may.append(place)
    named = [place for place in may if set(wanted) & set(rows[place])]
    return next(iter(named or may), None)


def _names(header: list[str], rows: list[list[str]]) -> tuple[list[str], bool]:
    """Names of columns, each its own; and whether lines end with a separator that ends no cell."""
    cells, longest = list(header), max(map(len, rows), default=0)
    last = longest >= len(cells) + (bool(cells[-1]))
    last &= not any(any(row[len(cells) - (not cells[-1]) :]) for row in rows)
    if last and not cells[-1]:
        cells = cells[:-1]
    # Of two columns with one name it is not known which is meant: each gets another.
    names = [
        f"{cell} (column {place})".strip() if cells.count(cell) > 1 or not cell else cell
        for place, cell in enumerate(cells, 1)
    ]
    return names, last


def _units(rows: list[list[str]]) -> int:
    """How many rows beneath a header hold texts alone where a later one has numbers."""
    for count, cells in enumerate(rows):
        if any(looks_numeric(cell) or _STAMP.search(cell) for cell in cells):
            return count
        if not any(cells) or all(map(is_missing, cells)):
            return 0
    return 0


def _decimal_sign(columns: dict[str, list[str]]) -> str:
    """A comma if numbers have one, none a point, and not all may be of thousands; else a point."""
    sure = False
    for cells in columns.values():
        found = [cell for cell in cells if "," in cell and _COMMA.fullmatch(cell)]
        if not found and any("." in cell and _POINT.fullmatch(cell) for cell in cells):
            return "."
        sure |= any(not _PERHAPS.fullmatch(cell) for cell in found)
        # Thousands have a sign in every number that has them.
        sure |= bool(found) and any(cell.isdecimal() and len(cell) > 3 for cell in cells)
    return "," if sure else "."


def _listed(noun: str, numbers: Sequence[int]) -> str:
    """Line numbers in words.

    Examples
    --------
    >>> _listed("line", [2]), _listed("line", [1, 2, 3]), _listed("line", [1, 3])
    ('line 2', 'lines 1 to 3', 'lines 1, 3')
    """
    if len(numbers) == 1:
        return f"{noun} {numbers[0]}"
    if numbers[-1] - numbers[0] == len(numbers) - 1:
        return f"{noun}s {numbers[0]} to {numbers[-1]}"
    shown_ones = ", ".join(map(str, numbers[:5]))
    return f"{noun}s {shown_ones}{', …' if len(numbers) > 5 else ''}"
