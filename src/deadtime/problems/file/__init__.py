"""Problem files: a plant, gains, laws, a signal and a run in TOML."""

from deadtime.problems.file.load import load_problem
from deadtime.problems.file.schema import json_schema

__all__ = ["json_schema", "load_problem"]
