"""The registry of laws: what problem files, studies, the page, figures and sentences know of each.

A law is known everywhere once it has an entry: a file in `deadtime.problems.law_registry.entries`.
"""

from deadtime.problems.law_registry.entry import LEVELS, LawSection, Named
from deadtime.problems.law_registry.law_setting import NEEDS, LawSetting
from deadtime.problems.law_registry.registry import (
    ENTRIES,
    LAWS,
    MODEL_KINDS,
    QUICK,
    NamedLaw,
    build_law,
    collect,
    the_law,
    the_problem_law,
)

__all__ = [
    "ENTRIES",
    "LAWS",
    "LEVELS",
    "MODEL_KINDS",
    "NEEDS",
    "QUICK",
    "LawSection",
    "LawSetting",
    "Named",
    "NamedLaw",
    "build_law",
    "collect",
    "the_law",
    "the_problem_law",
]
