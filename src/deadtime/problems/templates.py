"""Commented problem files: of the named problems, and of other examples."""

from __future__ import annotations

from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path

from deadtime.base.errors import ArgumentError
from deadtime.problems.imperfection_registry import in_comments

NAMES = ("paper", "three-mode", "follower")
OTHERS = ("motor", "quadrotor")  # examples that are files alone


def is_named(place: Path) -> bool:
    """Whether a path is the name of a problem rather than a file.

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
    if name in NAMES:
        return True
    if not place.suffix and not place.exists():
        if name in OTHERS:
            raise ArgumentError(
                f"problem must be a file for the example {name!r}: write it with deadtime init "
                f"{name}.toml -e {name}, and give {name}.toml."
            )
        near = get_close_matches(name, NAMES, n=1)
        hint = f" Did you mean {near[0]}?" if near else ""
        raise ArgumentError(
            f"problem must be one of {', '.join(NAMES)}, or a file that exists, got {name!r}.{hint}"
        )
    return False


def template(name: str) -> str:
    """The commented file of a named problem, or of another example.

    Examples
    --------
    >>> "[plant]" in template("follower")
    True
    """
    place = files("deadtime.problems").joinpath("files", f"{name}.toml")
    return place.read_text(encoding="utf-8").replace("#   (every kind)\n", in_comments())
