"""The entries, found and checked, and the model of one."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

from deadtime.base.errors import ArgumentError
from deadtime.problems.switching_registry import entries
from deadtime.problems.switching_registry.entry import SwitchingSection
from deadtime.problems.toml.entries import collect as entries_in, kinds_of, modules_of, refuse
from deadtime.switching import SwitchingModel

Entry = type[SwitchingSection]
_WHAT = "switching model"


def build_model(section: SwitchingSection, modes: int, folder: Path) -> SwitchingModel:
    """The model that a section asks for; refused where it is for another number of modes."""
    model = section.build(modes, folder)
    if model.modes != modes:
        kind = kinds_of(type(section))[0]
        raise ArgumentError(
            f"kind = {kind!r} describes {model.modes} modes, the plant has {modes}."
        )
    return model


def collect(modules: Iterable[ModuleType]) -> tuple[Entry, ...]:
    """The entries of some modules, in their order there; refused if one is not whole."""
    return entries_in(_WHAT, SwitchingSection, modules, _require_whole, lambda entry: ())


def _require_whole(entry: Entry) -> None:
    """Refuse an entry that lacks something."""
    for name in ("build", "promise"):
        if name in entry.__abstractmethods__:
            refuse(_WHAT, entry, f"lacks {name}: define it, as {SwitchingSection.__name__}'s.")


ENTRIES: tuple[Entry, ...] = collect(modules_of(entries))
