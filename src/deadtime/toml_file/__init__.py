"""TOML files that users write: read and checked, every error with file, line and key."""

from deadtime.toml_file.errors import SectionError, section
from deadtime.toml_file.read import MOST_BYTES, TomlText, read_toml, require_valid
from deadtime.toml_file.shape import Shape

__all__ = [
    "MOST_BYTES",
    "SectionError",
    "Shape",
    "TomlText",
    "read_toml",
    "require_valid",
    "section",
]
