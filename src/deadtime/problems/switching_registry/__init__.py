"""The registry of switching models: what problem files know of each.

A model is known to files once it has an entry: a file in
`deadtime.problems.switching_registry.entries`.
"""

from deadtime.problems.switching_registry.entry import SwitchingSection
from deadtime.problems.switching_registry.registry import ENTRIES, build_model

__all__ = ["ENTRIES", "SwitchingSection", "build_model"]
