"""Text files that somebody else wrote: read whole, within bounds, or refused in one line."""

from __future__ import annotations

import stat
from os import PathLike, fstat
from pathlib import Path

from deadtime.base.errors import ArgumentError


def read_text(
    path: str | PathLike[str],
    most: int,
    kind: type[ArgumentError] = ArgumentError,
    *,
    called: str = "",
    hint: str = "",
) -> str:
    """The text of a file or pipe in UTF-8, without a byte-order mark.

    Parameters
    ----------
    path : path
        The file.
    most : int
        Bytes that it may have. A device without end is not read at all.
    kind : type of ArgumentError
        What to raise.
    called : str
        How a message begins; with the path by default.
    hint : str
        How to come by such a file, for when there is none to read.

    Raises
    ------
    ArgumentError
        Of the given kind, in one line: if it cannot be read, is neither file nor pipe, is too
        large, or is not UTF-8.

    Examples
    --------
    >>> read_text("/dev/zero", 1000)
    Traceback (most recent call last):
    deadtime.ArgumentError: /dev/zero is neither a file nor a pipe: give a file.
    """
    # A name may hold what no terminal shows, and what would break the line.
    called = called or (str(path) if str(path).isprintable() else ascii(str(path)))
    try:
        with Path(path).open("rb") as file:
            status = fstat(file.fileno())
            if not (stat.S_ISREG(status.st_mode) or stat.S_ISFIFO(status.st_mode)):
                raise kind(f"{called} is neither a file nor a pipe: give a file.")
            # A regular file tells its size; of a pipe one byte too many is enough to know.
            content = b"" if status.st_size > most else file.read(most + 1)
    except OSError as error:
        raise kind(f"{called} cannot be read: {error.strerror}{hint and f'; {hint}'}.") from None
    except ValueError as error:
        if isinstance(error, ArgumentError):
            raise
        raise kind(f"{called} cannot be read: no file can have such a name.") from None
    if max(len(content), status.st_size) > most:
        raise kind(f"{called} has more than {most / 1e6:,.0f} MB: it is no file of this kind.")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise kind(f"{called} is not UTF-8 text: save it as UTF-8.") from None
