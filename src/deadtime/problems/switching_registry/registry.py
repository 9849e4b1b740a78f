"""The entries, found and checked, and the model of one."""

from __future__ import annotations

from pathlib import Path

from deadtime.base.errors import ArgumentError
from deadtime.problems.switching_registry import entries
from deadtime.problems.switching_registry.entry import SwitchingSection
from deadtime.problems.toml.entries import collect, kinds_of, modules_of
from deadtime.switching import SwitchingModel

ENTRIES = collect("switching model", SwitchingSection, modules_of(entries))


def build_model(section: SwitchingSection, modes: int, folder: Path) -> SwitchingModel:
    """The model that a section asks for; refused where it is for another number of modes."""
    model = section.build(modes, folder)
    if model.modes != modes:
        kind = kinds_of(type(section))[0]
        raise ArgumentError(
            f"kind = {kind!r} describes {model.modes} modes, the plant has {modes}."
        )
    return model
