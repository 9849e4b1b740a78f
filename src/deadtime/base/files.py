"""Text files: read whole and within bounds, or refused; written whole or not at all.

Files are written under a temporary name beside their target and renamed when all are complete. So
an interrupt, a full disk or a second writer never leaves a half-written file, and a concurrent
reader sees the old file or the new one.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from os import PathLike, fstat
from pathlib import Path
from types import TracebackType
from uuid import uuid4

from deadtime.base.errors import ArgumentError


def read_text(
    path: str | PathLike[str],
    most: int,
    kind: type[ArgumentError] = ArgumentError,
    *,
    called: str = "",
    hint: str = "",
) -> str:
    """The text of a file or pipe in UTF-8, without a byte-order mark: see `read_bytes`.

    Raises
    ------
    ArgumentError
        Of the given kind, in one line: if it cannot be read, or is not UTF-8.
    """
    content = read_bytes(path, most, kind, called=called, hint=hint)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise kind(f"{called or shown(path)} is not UTF-8 text: save it as UTF-8.") from None


def shown(path: str | PathLike[str]) -> str:
    """A path in a message: control characters in it would break the line."""
    return str(path) if str(path).isprintable() else ascii(str(path))


def read_bytes(
    path: str | PathLike[str],
    most: int,
    kind: type[ArgumentError] = ArgumentError,
    *,
    called: str = "",
    hint: str = "",
) -> bytes:
    """The content of a file or pipe.

    Parameters
    ----------
    path : path
        The file.
    most : int
        Largest size, bytes. A device without end is not read at all.
    kind : type of ArgumentError
        The exception to raise.
    called : str
        How a message begins; with the path by default.
    hint : str
        Where to get such a file, for the message if it cannot be read.

    Raises
    ------
    ArgumentError
        Of the given kind, in one line: if it cannot be read, is neither file nor pipe, or is too
        large.

    Examples
    --------
    >>> read_bytes("/dev/zero", 1000)
    Traceback (most recent call last):
    deadtime.ArgumentError: /dev/zero is neither a file nor a pipe: give a file.
    """
    called = called or shown(path)
    try:
        with Path(path).open("rb") as file:
            status = fstat(file.fileno())
            if not (stat.S_ISREG(status.st_mode) or stat.S_ISFIFO(status.st_mode)):
                raise kind(f"{called} is neither a file nor a pipe: give a file.")
            # The size of a pipe is not known before it is read: one byte too many is enough.
            content = b"" if status.st_size > most else file.read(most + 1)
    except OSError as error:
        raise kind(f"{called} cannot be read: {error.strerror}{hint and f'; {hint}'}.") from None
    except ValueError as error:
        if isinstance(error, ArgumentError):
            raise
        raise kind(f"{called} cannot be read: no file can have such a name.") from None
    if max(len(content), status.st_size) > most:
        raise kind(f"{called} has more than {most / 1e6:,.0f} MB: it is no file of this kind.")
    return content


class Staging:
    """Files and folders that appear together, or none of them.

    If one fails, or the user interrupts, nothing is written or changed.

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
        self._moves: list[tuple[Path, Path, str]] = []  # from, to, and its name in messages
        self._parents: list[Path] = []

    def __enter__(self) -> Staging:
        return self

    def folder(self, target: Path) -> Path:
        """An empty folder for new files of `target`, whose other files stay."""
        require_no_root("folder", target)
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

    def file(self, target: Path, name: str = "path") -> Path:
        """An empty file with the suffix of `target`, to write its content to.

        A target that is no regular file, such as a pipe, or that is in a folder where no file can
        be created, is returned itself and written to directly.
        """
        try:
            if target.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            if target.exists():
                if not (target.is_file() and os.access(target.resolve().parent, os.W_OK)):
                    return target
                if not os.access(target, os.W_OK):
                    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            around = [place for place, folder, _ in self._moves if folder == target.parent]
            if around and not target.parent.exists():
                place = around[0] / target.name  # it appears with its folder
            else:
                real = target.resolve()  # a link stays one
                place = self._place(real.parent, real, name, asked=target)
            place.touch(exist_ok=False)
        except OSError as error:
            raise unwritable(name, target, error) from None
        return place

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        try:
            with _alone([target for _, target, _ in self._moves if target.is_dir()]):
                for place, target, name in self._moves if kind is None else ():
                    try:
                        _move(place, target)
                    except OSError as failed:
                        raise unwritable(name, target, failed) from None
        finally:
            # After success only the emptied folders are left of them.
            for place, _, _ in self._moves:
                if place.is_dir():
                    shutil.rmtree(place, ignore_errors=True)
                else:
                    with suppress(OSError):  # never made, or its folder has become read-only
                        place.unlink()
            for parent in reversed(self._parents):
                if not any(parent.iterdir()):
                    parent.rmdir()

    def _make(self, folder: Path) -> None:
        """Create a folder and its parents, noted for removal in case they stay empty."""
        for one in reversed([one for one in (folder, *folder.parents) if not one.exists()]):
            one.mkdir()
            self._parents.append(one)

    def _place(self, beside: Path, target: Path, name: str, asked: Path | None = None) -> Path:
        """A unique name on the same file system; `asked` is the target as the user wrote it."""
        if any(target == other for _, other, _ in self._moves):
            raise ArgumentError(f"{name} {str(asked or target)!r} is given twice: give two names.")
        place = beside / f".deadtime-{uuid4().hex}{target.suffix}"
        self._moves.append((place, target, name))
        return place


@contextmanager
def replacing(target: str | os.PathLike[str], name: str = "path") -> Iterator[Path]:
    """A file to write to, which becomes `target` when the block ends without an error.

    Raises
    ------
    ArgumentError
        If it cannot be written, now or within the block; `name` is the argument in the message.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     target = Path(folder) / "a.txt"
    ...     with replacing(target) as place:
    ...         _ = place.write_text("made")
    ...         before = target.exists()
    ...     before, target.read_text(), len(list(target.parent.iterdir()))
    (False, 'made', 1)
    """
    with Staging() as staging:
        place = staging.file(Path(target), name)
        try:
            yield place
        except OSError as error:
            raise unwritable(name, Path(target), error) from None


@contextmanager
def _alone(folders: list[Path]) -> Iterator[None]:
    """Lock folders against other writers, on systems that have file locks.

    Files of two writers might be mixed otherwise, such as one law's code with another's tables.
    """
    with ExitStack() as held:
        with suppress(ImportError, OSError):
            import fcntl

            for folder in sorted(set(folders)):
                handle = os.open(folder, os.O_RDONLY)
                held.callback(os.close, handle)
                fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def _move(place: Path, target: Path) -> None:
    """Rename a file or folder to its target; into an existing folder, file by file."""
    if place.is_dir() and target.is_dir():
        for one in sorted(place.iterdir()):
            _move(one, target / one.name)
        return
    if target.is_file():
        shutil.copymode(target, place)
    place.replace(target)


def require_no_root(name: str, folder: Path) -> None:
    """Refuse the root of a file system, to which nobody means to write."""
    whole = folder.resolve()
    if whole == whole.parent:
        raise ArgumentError(
            f"{name} must be a folder for what is written, got {str(folder)!r}, the root of the "
            f"file system: name one in it, such as {str(whole / 'out')!r}."
        )


def unwritable(name: str, target: Path, error: OSError) -> ArgumentError:
    return ArgumentError(f"{name} {str(target)!r} cannot be written: {error.strerror or error}.")
