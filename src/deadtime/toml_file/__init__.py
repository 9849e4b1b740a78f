"""TOML files that users write: read and checked, every error with file, line and key."""

from deadtime.toml_file.errors import SectionError, section
from deadtime.toml_file.read import TomlText, read_toml, require_valid
from deadtime.toml_file.shape import Shape

__all__ = ["SectionError", "Shape", "TomlText", "read_toml", "require_valid", "section"]
