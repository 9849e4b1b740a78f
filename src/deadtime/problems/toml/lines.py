"""Where in a TOML text a key stands: the standard parser does not tell."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path as File

# What follows a repetition may be missing, so that none is gone back on and no text costs more than
# its length. (To forbid it, `*+`, is wrong for groups before Python 3.11.5.)
_TOKEN = re.compile(
    r"""
    (?P<long>  "{3} (?:[^"\\] | \\. | "(?!""))* (?:"{3,5})?
             | '{3} (?:[^'] | '(?!''))* (?:'{3,5})? )
  | (?P<quiet> "(?:[^"\\\n] | \\[^\n])* "? | '[^'\n]*+ '? | \#[^\n]*+ )
  | (?P<open> [\[{] ) | (?P<close> [\]}] ) | (?P<dot> \. ) | (?P<end> [\n=,] )
    """,
    re.VERBOSE | re.DOTALL,
)
_HEADER = re.compile(r"[ \t]*+(\[\[?+)([^\[\]]++)\]\]?+\s*+(?:#.*)?\Z")
_KEY = re.compile(r"[ \t]*+([A-Za-z0-9_.\-\"' \t]++)=")

MOST_KEYS = 20_000
DEEPEST = 20  # of brackets within brackets, and of keys with dots

Path = tuple[str | int, ...]


def excess(text: str) -> str:
    """What of a text is more than anything a file of ours says, if anything; before it is parsed.

    Examples
    --------
    >>> excess("a.b = [[1.0, 2.0], [3.0, 4.0]]"), excess("a = " + 30 * "[")
    ('', 'is nested too deeply: no key needs more than a few brackets or dots')
    """
    depth = dots = keys = 0
    for token in _TOKEN.finditer(text):
        kind = token.lastgroup
        keys += token[0] == "=" or (kind == "open" and depth == 0)
        depth += (kind == "open") - (kind == "close")
        dots = dots + 1 if kind == "dot" else dots if kind == "quiet" else 0
        if max(depth, dots) > DEEPEST:
            return "is nested too deeply: no key needs more than a few brackets or dots"
    return f"has more than {MOST_KEYS:,} keys and tables" if keys > MOST_KEYS else ""


def key_lines(text: str) -> dict[Path, int]:
    """Line, counted from 1, of every table and key of a valid TOML text.

    Keys inside inline tables and arrays are not listed; look up their parents.

    Examples
    --------
    >>> key_lines("a = 1\\n[t]\\nb = [\\n 2,\\n]\\n[[p]]\\nc = 3")
    {('a',): 1, ('t',): 2, ('t', 'b'): 3, ('p',): 6, ('p', 0): 6, ('p', 0, 'c'): 7}
    """
    lines: dict[Path, int] = {}
    table: Path = ()
    counts: dict[Path, int] = {}
    depth = 0
    for number, line in enumerate(_TOKEN.sub(_without_long, text).split("\n"), 1):
        if depth == 0 and (header := _HEADER.match(line)):
            table = _split(header[2])
            lines.setdefault(table, number)
            if header[1] == "[[":
                counts[table] = counts.get(table, -1) + 1
                table = (*table, counts[table])
                lines[table] = number
            continue
        if depth == 0 and (key := _KEY.match(line)):
            lines.setdefault((*table, *_split(key[1])), number)
        kinds = [token.lastgroup for token in _TOKEN.finditer(line)]
        depth += kinds.count("open") - kinds.count("close")
    return lines


def _without_long(token: re.Match[str]) -> str:
    """Of a string over several lines its lines alone."""
    return '""' + "\n" * token[0].count("\n") if token["long"] else token[0]


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
