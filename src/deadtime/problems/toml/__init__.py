"""TOML files that users write: read and checked, every error with file, line and key."""

from deadtime.problems.toml.sections import Shape
from deadtime.problems.toml.toml_model import (
    MOST_BYTES,
    SectionError,
    TomlText,
    read_toml,
    require_valid,
    section,
)

__all__ = [
    "MOST_BYTES",
    "SectionError",
    "Shape",
    "TomlText",
    "read_toml",
    "require_valid",
    "section",
]
