"""The entries, found and checked, and what is asked of all of them."""

from __future__ import annotations

import pkgutil
from collections.abc import Iterable, Iterator, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any, NamedTuple, cast

from deadtime.errors import ArgumentError
from deadtime.law_registry import entries
from deadtime.law_registry.entry import LEVELS, LawSection, Named
from deadtime.law_registry.setting import NEEDS, Setting
from deadtime.laws import Law

Entry = type[LawSection]


class Known(NamedTuple):
    """A law that is known by a name: its entry, and what the entry says of the name."""

    entry: Entry
    named: Named

    @property
    def kind(self) -> str:
        return self.entry.kinds()[0]

    @property
    def usual(self) -> bool:
        """Whether it is what the kind alone makes, not a variant of it."""
        return self.named is self.entry.names[0]

    @property
    def per_mode(self) -> bool:
        return "{mode}" in self.named.name

    @property
    def is_told(self) -> bool:
        """Whether the law is told the dwell time."""
        return self.named.knows == "the dwell time"

    def modes(self, count: int) -> tuple[int | None, ...]:
        """The modes that there is one such law for, or (None,)."""
        return tuple(range(count)) if self.per_mode else (None,)

    def keys(self, mode: int | None = None, dwell_time: float | None = None) -> dict[str, Any]:
        """What its section says beside the kind."""
        told = {"mode": mode} if self.per_mode else {}
        told |= {"dwell_time": dwell_time} if self.is_told else {}
        return {**self.named.keys, **told}

    def build(
        self, setting: Setting, mode: int | None = None, dwell_time: float | None = None
    ) -> Law:
        """The law itself."""
        return build_law(self.entry(**{"kind": self.kind, **self.keys(mode, dwell_time)}), setting)


def build_law(section: LawSection, setting: Setting) -> Law:
    """The law that a section asks for, its filter aside; refused where something is lacking."""
    for need in section.needs:
        setting.require(need, section.kinds()[0])
    return section.law(setting)


def collect(modules: Iterable[ModuleType]) -> tuple[Entry, ...]:
    """The entries of some modules, in their order there; refused if one is not whole.

    Raises
    ------
    ArgumentError
        If a module holds no entry, or an entry lacks something or takes what another one has.
    """
    found: list[Entry] = []
    for module in modules:
        own = [one for one in vars(module).values() if _is_entry(one, module)]
        if not own:
            raise ArgumentError(
                f"{module.__name__} holds no entry of a law: write a subclass of LawSection."
            )
        for entry in own:
            _require_whole(entry)
            for other in found:
                _require_apart(entry, other)
            found.append(entry)
    return tuple(found)


def _is_entry(one: object, module: ModuleType) -> bool:
    return (
        isinstance(one, type) and issubclass(one, LawSection) and one.__module__ == module.__name__
    )


def _refuse(entry: Entry, why: str) -> None:
    raise ArgumentError(f"law entry {entry.__name__} in {entry.__module__} {why}")


def _require_whole(entry: Entry) -> None:
    """Refuse an entry that lacks something."""
    kinds = entry.kinds()
    if len(kinds) != 1 or not isinstance(kinds[0], str):
        _refuse(entry, 'lacks its kind: write kind: Literal["…"], what problem files call it.')
    if not vars(entry).get("__doc__"):
        _refuse(entry, "lacks a docstring: write a line, which editors show beside the kind.")
    if "law" in entry.__abstractmethods__:
        _refuse(entry, "lacks law(self, setting): define it, to build the law from the section.")
    if not entry.names:
        _refuse(entry, "lacks names: give names = (Named(…),), by which studies and figures go.")
    unknown = [need for need in entry.needs if need not in NEEDS]
    if unknown:
        _refuse(entry, f"needs {unknown[0]!r}: it must be one of {', '.join(NEEDS)}.")
    names = [named.name for named in entry.names]
    if len(set(names)) < len(names):
        _refuse(entry, "has a name twice: give each of its names another text.")
    for named in entry.names:
        _require_fit(entry, named)


def _require_fit(entry: Entry, named: Named) -> None:
    """Refuse a name of which no section can be made."""
    name, known = named.name, Known(entry, named)
    if named.knows not in LEVELS:
        _refuse(entry, f"{name!r} knows {named.knows!r}: it must be one of {', '.join(LEVELS)}.")
    given = known.keys()
    for key in given:
        if key not in entry.model_fields:
            _refuse(entry, f"{name!r} sets {key}, which is no key of the section: add the field.")
    for key, value in entry.model_fields.items():
        if value.is_required() and key not in ("kind", *given):
            _refuse(entry, f"{name!r} does not say {key}: give it in keys, or give it a default.")


def _require_apart(entry: Entry, other: Entry) -> None:
    """Refuse an entry that takes what another one has."""
    kind, taken = entry.kinds()[0], {named.name for named in other.names}
    if kind == other.kinds()[0]:
        _refuse(entry, f"takes the kind {kind!r}, which {other.__name__} has: choose another.")
    if entry.__name__ == other.__name__:
        _refuse(entry, f"takes the class name of that in {other.__module__}: choose another.")
    for name in (named.name for named in entry.names):
        if name in taken:
            _refuse(entry, f"takes the name {name!r}, which {other.__name__} has: choose another.")


def _modules() -> Iterator[ModuleType]:
    """The files of the entries, in the order of their names."""
    for name in sorted(info.name for info in pkgutil.iter_modules(entries.__path__)):
        yield import_module(f"{entries.__name__}.{name}")


ENTRIES: tuple[Entry, ...] = collect(_modules())
# Laws by name: those that need no model, those that do, and variants of both.
LAWS: Mapping[str, Known] = {
    known.named.name: known
    for known in sorted(
        (Known(entry, named) for entry in ENTRIES for named in entry.names),
        key=lambda known: 2 if not known.usual else int("model" in known.entry.needs),
    )
}
MODEL_KINDS = frozenset(entry.kinds()[0] for entry in ENTRIES if "model" in entry.needs)
# Periods of the delay up to which laws are tabulated in a moment, by kind; others always are.
QUICK: Mapping[str, int] = {
    entry.kinds()[0]: cast(int, entry.quick) for entry in ENTRIES if entry.quick is not None
}


def the_law(name: str) -> str:
    """A law's name in a sentence.

    Examples
    --------
    >>> the_law("mean, dwell-aware"), the_law("mode 1 only"), the_law("oracle")
    ('the dwell-aware mean law', 'the law “mode 1 only”', 'the oracle')
    """
    name, _, rest = name.partition(", ")
    noun = LAWS[name].named.noun if name in LAWS else ""
    if not noun:
        return f"the law “{name}”"
    return f"the {rest} {noun}" if rest else f"the {noun}"
