"""Exports are made whole or not at all: beside their places, and moved there when all are made."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path
from types import TracebackType

from deadtime.base.errors import ArgumentError


class Staging:
    """Files and folders that appear together, or none of them.

    If one fails, or the user interrupts, nothing is written, and what was there is as it was.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     target = Path(place) / "new" / "out"
    ...     with Staging() as staging:
    ...         _ = (staging.folder(target) / "a.txt").write_text("made")
    ...         before = target.exists()
    ...     before, (target / "a.txt").read_text()
    (False, 'made')
    """

    def __init__(self) -> None:
        self._moves: list[tuple[Path, Path, str]] = []  # from, to, and what errors call it
        self._parents: list[Path] = []

    def __enter__(self) -> Staging:
        return self

    def folder(self, target: Path) -> Path:
        """An empty folder, for the files of `target`; others that it has stay in it."""
        try:
            if not target.is_dir():
                if os.path.lexists(target):
                    raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
                self._make(target.parent)
            place = self._place(target if target.is_dir() else target.parent, target, "folder")
            place.mkdir()
        except OSError as error:
            raise unwritable("folder", target, error) from None
        return place

    def file(self, target: Path) -> Path:
        """An empty file, for what `target` will hold."""
        try:
            if target.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            around = [place for place, folder, _ in self._moves if folder == target.parent]
            if around and not target.parent.exists():
                place = around[0] / target.name  # it appears with its folder
            else:
                place = self._place(target.parent, target, "path")
            place.touch(exist_ok=False)
        except OSError as error:
            raise unwritable("path", target, error) from None
        return place

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        try:
            for move in self._moves if kind is None else ():
                _move(*move)
        finally:
            for place, _, _ in self._moves:
                if place.is_dir():
                    shutil.rmtree(place, ignore_errors=True)
                else:
                    place.unlink(missing_ok=True)
            for parent in reversed(self._parents):
                if not any(parent.iterdir()):
                    parent.rmdir()

    def _make(self, folder: Path) -> None:
        """A folder and those above it, remembered in case that nothing comes into them."""
        for one in reversed([one for one in (folder, *folder.parents) if not one.exists()]):
            one.mkdir()
            self._parents.append(one)

    def _place(self, beside: Path, target: Path, name: str) -> Path:
        """A name that nobody else uses, on the same file system."""
        if any(target == other for _, other, _ in self._moves):
            raise ArgumentError(f"{name} {str(target)!r} is asked for twice: give two names.")
        place = beside / f".deadtime-{os.getpid()}-{len(self._moves)}"
        self._moves.append((place, target, name))
        return place


def _move(place: Path, target: Path, name: str) -> None:
    """What was made, to where it belongs."""
    try:
        if place.is_dir() and target.is_dir():
            for file in sorted(place.iterdir()):
                file.replace(target / file.name)
        else:
            place.replace(target)
    except OSError as error:
        raise unwritable(name, target, error) from None


def unwritable(name: str, target: Path, error: OSError) -> ArgumentError:
    """The error that says why a place cannot be written."""
    return ArgumentError(f"{name} {str(target)!r} cannot be written: {error.strerror}.")
