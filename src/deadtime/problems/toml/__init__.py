"""TOML files that users write: read and checked, every error with file, line and key."""

from deadtime.problems.toml.file_errors import SectionError, section
from deadtime.problems.toml.shape import Shape
from deadtime.problems.toml.toml_model import MOST_BYTES, TomlText, read_toml, require_valid

__all__ = [
    "MOST_BYTES",
    "SectionError",
    "Shape",
    "TomlText",
    "read_toml",
    "require_valid",
    "section",
]
