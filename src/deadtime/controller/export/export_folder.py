"""Where an export may write: nothing of the user's own is replaced."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from deadtime.base.errors import ArgumentError

MARK = "Written by deadtime"


def require_own(folder: Path, names: Iterable[str]) -> None:
    """Refuse to replace a file that does not say that deadtime wrote it."""
    for name in names:
        path = folder / name
        if path.is_symlink() or path.exists():
            try:
                own = MARK.encode() in path.read_bytes()
            except OSError:
                own = False
            if not own:
                raise ArgumentError(
                    f"folder {str(folder)!r} has a {name} that deadtime did not write (it lacks "
                    f'"{MARK}"): move it away, or give another folder.'
                )


def require_suffix(path: Path, suffix: str) -> None:
    """Refuse a path of another suffix."""
    if path.suffix != suffix:
        raise ArgumentError(f"path must end in {suffix}, got {str(path)!r}.")
