"""Where in a TOML text a key stands: the standard parser does not tell."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path as File

_HEADER = re.compile(r"\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?$")
_KEY = re.compile(r"\s*([A-Za-z0-9_.\-\"']+)\s*=")
_QUIET = re.compile(r'"(?:\\.|[^"\\])*"|\'[^\']*\'|#.*$')

Path = tuple[str | int, ...]


def key_lines(text: str) -> dict[Path, int]:
    """Line, counted from 1, of every table and key of a valid TOML text.

    Keys inside inline tables and arrays are not listed; look up their parents.

    Examples
    --------
    >>> key_lines("a = 1\\n[t]\\nb = [\\n 2,\\n]\\n[[p]]\\nc = 3")
    {('a',): 1, ('t',): 2, ('t', 'b'): 3, ('p', 0): 6, ('p', 0, 'c'): 7}
    """
    lines: dict[Path, int] = {}
    table: Path = ()
    counts: dict[Path, int] = {}
    depth = 0
    for number, line in enumerate(text.splitlines(), 1):
        if depth == 0 and (header := _HEADER.match(line)):
            table = _split(header[2])
            if header[1] == "[[":
                counts[table] = counts.get(table, -1) + 1
                table = (*table, counts[table])
            lines.setdefault(table, number)
            continue
        if depth == 0 and (key := _KEY.match(line)):
            lines.setdefault((*table, *_split(key[1])), number)
        quiet = _QUIET.sub("", line)
        depth += quiet.count("[") + quiet.count("{") - quiet.count("]") - quiet.count("}")
    return lines


def _split(dotted: str) -> Path:
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))


def line_of(lines: Mapping[Path, int], path: Path) -> int | None:
    """Line of the key, or of the nearest table around it."""
    while path:
        if path in lines:
            return lines[path]
        path = path[:-1]
    return None


def at_line(source: File, line: int | None) -> str:
    """A file and a line of it, for the beginning of a message."""
    return str(source) if line is None else f"{source}, line {line}"
