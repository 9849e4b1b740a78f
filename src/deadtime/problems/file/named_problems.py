"""Problems that go by a name, as the commented files that `deadtime init` writes."""

from __future__ import annotations

from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path

from deadtime.base.errors import ArgumentError
from deadtime.problems.literature import NAMED


def is_named(place: Path) -> bool:
    """Whether a problem is asked for by its name, rather than by its file.

    Raises
    ------
    ArgumentError
        If it can be neither, with the nearest name.

    Examples
    --------
    >>> is_named(Path("follower")), is_named(Path("mine.toml"))
    (True, False)
    """
    name = str(place)
    if name in NAMED:
        return True
    if not place.suffix and not place.exists():
        near = get_close_matches(name, NAMED, n=1)
        hint = f" Did you mean {near[0]}?" if near else ""
        raise ArgumentError(
            f"problem must be one of {', '.join(NAMED)}, or a file that exists, got {name!r}.{hint}"
        )
    return False


def template(name: str) -> str:
    """The commented file of a named problem.

    Examples
    --------
    >>> "[plant]" in template("follower")
    True
    """
    return files("deadtime.problems").joinpath("files", f"{name}.toml").read_text(encoding="utf-8")
