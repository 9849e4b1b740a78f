"""TOML files that users write: read and checked, every error with file, line and key."""

from deadtime.problems.toml.errors import SectionError, section
from deadtime.problems.toml.read import MOST_BYTES, TomlText, read_toml, require_valid
from deadtime.problems.toml.shape import Shape

__all__ = [
    "MOST_BYTES",
    "SectionError",
    "Shape",
    "TomlText",
    "read_toml",
    "require_valid",
    "section",
]
