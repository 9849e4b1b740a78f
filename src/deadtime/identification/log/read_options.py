"""Options with which a user says how the files of a log are written."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from deadtime.base.checks import positive
from deadtime.base.errors import ArgumentError


class ReadOptions(NamedTuple):
    """How files are read: see `identify`."""

    time: str | None = None
    step: float | None = None
    sep: str | None = None
    decimal: str | None = None
    on_change: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        time: str | None,
        step: float | None,
        sep: str | None,
        decimal: str | None,
        on_change: Sequence[str],
    ) -> ReadOptions:
        """Checked options; a column's name may have blanks around it."""
        if isinstance(on_change, str):
            raise ArgumentError(
                f"on_change must be a list of columns, such as {[on_change]}, got a text."
            )
        return cls(
            None if time is None else str(time).strip(),
            None if step is None else positive("step, --step,", step),
            sep,
            decimal,
            tuple(str(name).strip() for name in on_change),
        )


PLAIN = ReadOptions()
