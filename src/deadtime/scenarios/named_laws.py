"""The laws of a comparison by name, and counts, checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law


def named_laws(laws: object) -> dict[str, Law]:
    """Laws by name, in their order."""
    if isinstance(laws, Mapping):
        pairs = list(laws.items())
    elif isinstance(laws, Sequence) and not isinstance(laws, str):
        pairs = [(_label_of(law), law) for law in laws]
    else:
        hint = ": for one law, write [law]" if isinstance(laws, Law) else ""
        raise ArgumentError(
            f"laws must be a list of laws, or a dict of names to laws, got "
            f"{type(laws).__name__}{hint}."
        )
    if not pairs:
        raise ArgumentError("laws must hold at least one law, got none.")
    named: dict[str, Law] = {}
    for name, law in pairs:
        if not isinstance(law, Law):
            raise ArgumentError(f"laws must hold laws only, got {type(law).__name__}.")
        if not isinstance(name, str):
            raise ArgumentError(f"laws must have names that are strings, got {name!r}.")
        if name in named:
            raise ArgumentError(
                f"laws must have different labels, got {name!r} twice: "
                "name them yourself, with a dict of names to laws."
            )
        named[name] = law
    return named


def _label_of(law: object) -> str:
    """A law's own name."""
    label = getattr(law, "label", "")
    if not isinstance(label, str):
        raise ArgumentError(
            f"{type(law).__name__}.label must be a text, got a {type(label).__name__}: make it a "
            "property, or name the laws yourself, with a dict of names to laws."
        )
    return label
