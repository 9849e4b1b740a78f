"""What a user calls a law, its states and its modes, for headers and descriptions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from deadtime.errors import ArgumentError


@dataclass(frozen=True)
class Names:
    """Names for what is exported (immutable); what is empty is numbered.

    Attributes
    ----------
    title : of the law, or of the plant
    states, modes : with their units, if they have some

    Examples
    --------
    >>> Names("my law", ("position (m)", "speed (m/s)")).state(1)
    'speed (m/s)'
    """

    title: str = ""
    states: Sequence[str] = ()
    modes: Sequence[str] = ()

    def require(self, states: int, modes: int) -> None:
        """Refuse another number of names than there are states or modes."""
        for name, given, wanted in (
            ("names.states", self.states, states),
            ("names.modes", self.modes, modes),
        ):
            if given and len(given) != wanted:
                raise ArgumentError(f"{name} must be {wanted} names, got {len(given)}.")

    def state(self, i: int) -> str:
        """Of a state, or nothing."""
        return self.states[i] if self.states else ""

    def all_modes(self) -> str:
        """The numbers of the modes with their names, or nothing."""
        return ", ".join(f"{i}: {name}" for i, name in enumerate(self.modes))


def plain(text: str) -> str:
    """On one line, and nothing that could end a comment in C."""
    return " ".join(text.split()).replace("*/", "* /").replace("/*", "/ *")
