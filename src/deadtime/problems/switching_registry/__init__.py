"""The registry of switching models in problem files.

Files know a model once it has an entry in `deadtime.problems.switching_registry.entries`.
"""

from deadtime.problems.switching_registry import entries
from deadtime.problems.switching_registry.entry import SwitchingSection
from deadtime.problems.toml.sections import collect, modules_of

__all__ = ["ENTRIES", "SwitchingSection"]

ENTRIES = collect("switching model", SwitchingSection, modules_of(entries))
