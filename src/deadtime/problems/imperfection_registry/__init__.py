"""The registry of imperfections: what problem files, sweeps and the page know of each.

An imperfection is known everywhere once it has an entry: a file in
`deadtime.problems.imperfection_registry.entries`.
"""

from deadtime.problems.imperfection_registry.entry import (
    ImperfectionAxis,
    ImperfectionSection,
    Slider,
)
from deadtime.problems.imperfection_registry.registry import (
    ENTRIES,
    SWEPT,
    Swept,
    build_imperfection,
    collect,
    require_all,
)

__all__ = [
    "ENTRIES",
    "SWEPT",
    "ImperfectionAxis",
    "ImperfectionSection",
    "Slider",
    "Swept",
    "build_imperfection",
    "collect",
    "require_all",
]
