"""The registry of imperfections for problem files, sweeps and the page.

An imperfection is available everywhere once it has an entry: a module in
`deadtime.problems.imperfection_registry.entries`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from functools import partial
from inspect import isabstract
from types import ModuleType
from typing import Any, NamedTuple

from deadtime import imperfections
from deadtime.base.errors import ArgumentError
from deadtime.imperfections import Imperfection
from deadtime.problems.imperfection_registry import entries
from deadtime.problems.imperfection_registry.entry import (
    ImperfectionAxis,
    ImperfectionSection,
    Slider,
)
from deadtime.problems.toml.sections import collect as entries_in, kinds_of, modules_of, refuse

Entry = type[ImperfectionSection]
_refuse = partial(refuse, "imperfection")


class Swept(NamedTuple):
    """An imperfection with an axis in sweeps, and perhaps a slider on the page."""

    kind: str
    axis: ImperfectionAxis
    slider: Slider | None

    def section(self, value: float) -> dict[str, Any]:
        """The section of a problem file for a value."""
        return {"kind": self.kind, **self.axis.keys(value)}


def build_imperfection(section: ImperfectionSection) -> Imperfection:
    """The imperfection of a section."""
    assert section.made is not None
    return section.made(**section.model_dump(exclude={"kind"}))


def in_comments() -> str:
    """Every kind with its keys, the optional ones in brackets, as comments of a problem file.

    Examples
    --------
    >>> print(in_comments().splitlines()[3])
    #   late-samples                   # periods, (probability): samples that come late
    """
    lines = []
    for entry in ENTRIES:
        keys = {key: field for key, field in entry.model_fields.items() if key != "kind"}
        listed = ", ".join(key if one.is_required() else f"({key})" for key, one in keys.items())
        about = (entry.__doc__ or "").splitlines()[0].rstrip(".")
        kind = f"#   {kinds_of(entry)[0]}"
        lines.append(f"{kind:<35}# {listed}: {about[:1].lower()}{about[1:]}\n")
    return "".join(lines)


def collect(modules: Iterable[ModuleType]) -> tuple[Entry, ...]:
    """The entries of some modules, in their order there; refused if one is incomplete."""
    return entries_in("imperfection", ImperfectionSection, modules, _require_whole, _names)


def _names(entry: Entry) -> list[str]:
    """Unique names: of the class, which keys its random stream, and of the axis."""
    assert entry.made is not None
    own = [entry.made.__name__]
    return own if entry.axis is None else [*own, entry.axis.name]


def _require_whole(entry: Entry) -> None:
    made, axis, slider = entry.made, entry.axis, entry.slider
    if made is None:
        _refuse(entry, "lacks made: give made = the class of the imperfection.")
    keys = [key for key in entry.model_fields if key != "kind"]
    names = [field.name for field in fields(made)]  # pyright: ignore[reportArgumentType]
    if sorted(keys) != sorted(names):
        _refuse(entry, f"has the keys {keys}, {made.__name__} takes {names}: make them the same.")
    unknown = [] if axis is None else [key for key in axis.keys(1.0) if key not in keys]
    if unknown:
        _refuse(entry, f"sets {unknown[0]} by its axis, which is no key of the section.")
    if slider is not None and (axis is None or slider.key not in axis.keys(1.0)):
        _refuse(entry, f"has a slider of {slider.key!r}, which its axis does not set.")


def require_all(known: Iterable[Entry], public: ModuleType = imperfections) -> None:
    """Refuse a public imperfection that no entry makes."""
    made = {entry.made for entry in known}
    for name in public.__all__:
        one = getattr(public, name)
        is_kind = isinstance(one, type) and issubclass(one, Imperfection) and not isabstract(one)
        # The base of all has no abstract method.
        if is_kind and one is not Imperfection and one not in made:
            raise ArgumentError(
                f"imperfection {name} has no entry: add one to {entries.__name__}, for "
                "problem files."
            )


ENTRIES: tuple[Entry, ...] = collect(modules_of(entries))
require_all(ENTRIES)
SWEPT: Mapping[str, Swept] = {
    entry.axis.name: Swept(kinds_of(entry)[0], entry.axis, entry.slider)
    for entry in ENTRIES
    if entry.axis is not None
}
