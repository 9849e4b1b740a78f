"""The registry of laws for problem files, studies, the page, figures and sentences.

A law is available everywhere once it has an entry in `deadtime.problems.law_registry.entries`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from types import ModuleType
from typing import Any, NamedTuple, cast

from deadtime.base.wording import with_names
from deadtime.feedback import Law
from deadtime.problems.law_registry import entries
from deadtime.problems.law_registry.entry import LEVELS, NEEDS, LawSection, LawSetting, Named
from deadtime.problems.toml.sections import collect as entries_in, kinds_of, modules_of, refuse

Entry = type[LawSection]
_refuse = partial(refuse, "law")


class NamedLaw(NamedTuple):
    """A law with a name: its entry, and the entry's data on the name."""

    entry: Entry
    named: Named

    @property
    def kind(self) -> str:
        return kinds_of(self.entry)[0]

    @property
    def usual(self) -> bool:
        """Whether the kind alone makes it, without further keys."""
        return self.named is self.entry.names[0]

    @property
    def per_mode(self) -> bool:
        return "{mode}" in self.named.name

    @property
    def takes_dwell_time(self) -> bool:
        """Whether the law uses the dwell time."""
        return self.named.knows == "the dwell time"

    def modes(self, count: int) -> tuple[int | None, ...]:
        """The modes with one such law each, or (None,)."""
        return tuple(range(count)) if self.per_mode else (None,)

    def keys(self, mode: int | None = None, dwell_time: float | None = None) -> dict[str, Any]:
        """The keys of its section beside the kind."""
        beside = {"mode": mode} if self.per_mode else {}
        beside |= {"dwell_time": dwell_time} if self.takes_dwell_time else {}
        return {**self.named.keys, **beside}

    def build(
        self, setting: LawSetting, mode: int | None = None, dwell_time: float | None = None
    ) -> Law:
        """The law itself."""
        return build_law(self.entry(**{"kind": self.kind, **self.keys(mode, dwell_time)}), setting)


def build_law(section: LawSection, setting: LawSetting) -> Law:
    """The law of a section without its low-pass filter; refused if a need is not met."""
    for need in section.needs:
        setting.require(need, kinds_of(type(section))[0])
    return section.law(setting)


def collect(modules: Iterable[ModuleType]) -> tuple[Entry, ...]:
    """The entries of some modules, in their order there; refused if one is incomplete."""
    return entries_in("law", LawSection, modules, _require_whole, _names)


def _names(entry: Entry) -> list[str]:
    return [named.name for named in entry.names]


def _require_whole(entry: Entry) -> None:
    if not entry.names:
        _refuse(entry, "lacks names: give names = (Named(…),), which studies and figures use.")
    unknown = [need for need in entry.needs if need not in NEEDS]
    if unknown:
        _refuse(entry, f"needs {unknown[0]!r}: it must be one of {', '.join(NEEDS)}.")
    if len(set(_names(entry))) < len(entry.names):
        _refuse(entry, "has a name twice: give each of its names another text.")
    for named in entry.names:
        _require_fit(entry, named)


def _require_fit(entry: Entry, named: Named) -> None:
    """Refuse a name without a valid section."""
    name, known = named.name, NamedLaw(entry, named)
    if named.knows not in LEVELS:
        _refuse(entry, f"{name!r} knows {named.knows!r}: it must be one of {', '.join(LEVELS)}.")
    given = known.keys()
    for key in given:
        if key not in entry.model_fields:
            _refuse(entry, f"{name!r} sets {key}, which is no key of the section: add the field.")
    for key, value in entry.model_fields.items():
        if value.is_required() and key not in ("kind", *given):
            _refuse(entry, f"{name!r} does not say {key}: give it in keys, or give it a default.")


ENTRIES: tuple[Entry, ...] = collect(modules_of(entries))
# Laws by name: those without a model of the switching, those with one, and variants of both.
LAWS: Mapping[str, NamedLaw] = {
    known.named.name: known
    for known in sorted(
        (NamedLaw(entry, named) for entry in ENTRIES for named in entry.names),
        key=lambda known: 2 if not known.usual else int("model" in known.entry.needs),
    )
}
MODEL_KINDS = frozenset(kinds_of(entry)[0] for entry in ENTRIES if "model" in entry.needs)
# Longest delays, in periods, for which a table takes a moment, by kind; others have no limit.
QUICK: Mapping[str, int] = {
    kinds_of(entry)[0]: cast(int, entry.quick) for entry in ENTRIES if entry.quick is not None
}


def name_of(law: Law, modes: Sequence[str] = ()) -> str:
    """The default name of a law: its label, with the names of modes if these are unique.

    A file observes all laws or none, so that the name leaves out "observed".

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.follower()
    >>> name_of(dt.SingleModePredictor(problem.plant, problem.gains, 1), problem.modes)
    'brake only'
    """
    names = modes if len(set(modes)) == len(modes) else ()
    return with_names(law.label.removesuffix(", observed"), names)


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


def the_problem_law(name: str) -> str:
    """A law's name in a sentence about a problem, whose file may give a law any name.

    A law that files run by default and that does not know the future gets the noun of `the_law`.

    Examples
    --------
    >>> the_problem_law("mean"), the_problem_law("oracle")
    ('the mean law', 'the law “oracle”')
    """
    known = LAWS.get(name)
    usual = known is not None and known.named.in_files and known.named.knows != LEVELS[-1]
    return the_law(name) if usual else f"the law “{name}”"
