"""Changes of a file: its bytes, its lines, its numbers, its words, and the tree that it says."""

from __future__ import annotations

import copy
import json
import math
import re
from collections.abc import Callable
from random import Random
from typing import Any

NUMBER = re.compile(rb"-?\d[\d_]*(?:\.\d+)?(?:[eE][+-]?\d+)?")
NUMBERS = (
    *(b"0", b"-0.0", b"1", b"-1", b"2", b"0.5", b"1e308", b"-1e308", b"1e-308", b"5e-324"),
    *(b"1e400", b"inf", b"-inf", b"nan", b"1e18", b"9223372036854775808", b"-9223372036854775809"),
    *(b"1e9", b"1e-9", b"1e5", b"1000000", b"0.1", b"0x10", b"07:32:00", b"1979-05-27", b"true"),
    *(b"1" * 400, b"1" * 5000, b"0." + b"3" * 400, b'"1"', b"[]", b"{}", b'"-4+2i"', b'"1+1j"'),
)
VALUES: tuple[Any, ...] = (
    *(0, -1, 1, 2, 3, 7, 1000, 10**6, 10**9, 2**63, -(2**63) - 1, 10**400, True, False),
    *(0.0, -0.0, 0.5, 1e-9, 1e9, 1e100, -1e100, 1e308, -1e308, 5e-324),
    *(math.inf, -math.inf, math.nan, "none", "averaged", "mean", "1+1j", "-4+2i"),
    *("", "x", "1.5", "\x00", "a\nb", "é∞", "a" * 3000),
    *([], {}, [[]], [[[]]], [0.0], [[0.0]], [[[0.0]]], [1, "x"], [[1.0], [1.0, 2.0]], {"kind": 1}),
    *({"": 0}, {"distribution": "expon"}, {"distribution": "norm", "scale": {}}, [0] * 300),
)  # fmt: skip
MARKS = (
    *(b"[", b"]", b"{", b'"', b"'", b'"""', b"=", b".", b",", b"#", b"\\", b"\x00", b"\r", b"\n"),
    *(b"\xef\xbb\xbf", b"\xed\xa0\x80", b" " * 3000, b"[" * 600, b".a" * 600, b"\\ud800", b"-"),
)
Bytes = Callable[[Random, bytes, bytes], bytes]


def flip(rng: Random, text: bytes, other: bytes) -> bytes:
    """Another byte at some places."""
    changed = bytearray(text or b"x")
    for _ in range(rng.choice((1, 1, 2, 8))):
        changed[rng.randrange(len(changed))] = rng.randrange(256)
    return bytes(changed)


def cut(rng: Random, text: bytes, other: bytes) -> bytes:
    """Without a part, or without an end."""
    a = rng.randrange(len(text) + 1)
    b = rng.choice((len(text), min(len(text), a + rng.choice((1, 2, 5, 40)))))
    return text[:a] + text[b:]


def lines(rng: Random, text: bytes, other: bytes) -> bytes:
    """A line twice, often, gone, or in the place of another."""
    rows = text.split(b"\n")
    i, j = rng.randrange(len(rows)), rng.randrange(len(rows))
    match rng.randrange(4):
        case 0:
            rows.insert(j, rows[i])
        case 1:
            del rows[i]
        case 2:
            rows[i], rows[j] = rows[j], rows[i]
        case _:
            rows[i:i] = [rows[i]] * rng.choice((2, 30, 300))
    return b"\n".join(rows)


def splice(rng: Random, text: bytes, other: bytes) -> bytes:
    """The beginning of one file and the end of another, or a piece of that inside."""
    a, b = rng.randrange(len(text) + 1), rng.randrange(len(other) + 1)
    if rng.random() < 0.5:
        return text[:a] + other[b:]
    return text[:a] + other[b : b + rng.choice((3, 20, 200))] + text[a:]


def numbers(rng: Random, text: bytes, other: bytes) -> bytes:
    """Extreme numbers, and what is none, in the places of some."""
    found = list(NUMBER.finditer(text))
    if not found:
        return text + rng.choice(NUMBERS)
    for one in sorted(
        rng.sample(found, min(len(found), rng.choice((1, 1, 2)))), key=lambda m: -m.start()
    ):
        text = text[: one.start()] + rng.choice(NUMBERS) + text[one.end() :]
    return text


def insert(rng: Random, text: bytes, other: bytes) -> bytes:
    """Something that parsers look at, in any place."""
    a = rng.randrange(len(text) + 1)
    return text[:a] + rng.choice(MARKS) + text[a:]


BYTES: tuple[Bytes, ...] = (flip, cut, lines, splice, numbers, numbers, numbers, insert)


def of_bytes(rng: Random, text: bytes, other: bytes) -> bytes:
    """One change of the bytes, seldom several."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        text = rng.choice(BYTES)(rng, text, other)
    return text


def of_tree(rng: Random, tree: Any, other: Any, words: tuple[str, ...] = ()) -> Any:
    """One value of a tree of dictionaries and lists made another, seldom several."""
    tree = copy.deepcopy(tree)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        found = places(tree)
        if not found:
            return tree
        owner, key = rng.choice(found)
        spare, inside = rng.choice(places(other) or [({"x": 0}, "x")])
        match rng.randrange(8):
            case 0 | 1 | 2:
                owner[key] = copy.deepcopy(rng.choice(VALUES))
            case 3:
                owner[key] = copy.deepcopy(spare[inside])
            case 4:
                del owner[key]
            case 5 if isinstance(owner, list):
                owner.insert(key, copy.deepcopy(owner[key]))
            case 6 if words:
                owner[key] = rng.choice(words)
            case 7 if isinstance(owner[key], (int, float)) and abs(owner[key]) < 1e300:
                owner[key] = owner[key] * rng.choice((-1.0, 1e-6, 0.5, 2.0, 1e3, 1e6, 1e300))
            case _:
                owner[key] = [copy.deepcopy(owner[key])]
    return tree


def places(tree: Any) -> list[tuple[Any, Any]]:
    """Every (owner, key) inside a tree."""
    found: list[tuple[Any, Any]] = []
    pending = [tree]
    while pending:
        owner = pending.pop()
        if isinstance(owner, (dict, list)):
            keys = list(owner) if isinstance(owner, dict) else range(len(owner))
            found += [(owner, key) for key in keys]
            pending += [owner[key] for key in keys]
    return found


def toml(tree: dict[str, Any]) -> str:
    """A tree as TOML, every table inline."""
    return "\n".join(f"{json.dumps(str(key))} = {_value(value)}" for key, value in tree.items())


def _value(value: Any) -> str:
    if isinstance(value, dict):
        inner = ", ".join(f"{json.dumps(str(key))} = {_value(one)}" for key, one in value.items())
        return f"{{ {inner} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, str):
        return json.dumps(value).replace("\x7f", "\\u007f")
    return repr(value).lower()
