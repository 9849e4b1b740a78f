"""Problem files: a plant, gains, laws, a signal and a run in TOML."""

from deadtime.problem_file.load import load_problem
from deadtime.problem_file.schema import json_schema

__all__ = ["json_schema", "load_problem"]
