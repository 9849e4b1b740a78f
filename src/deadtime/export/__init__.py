"""A law for the target: C99 of a controller, FMUs of controller and plant."""

from deadtime.export.c_code import Exported, export_c

__all__ = ["Exported", "export_c"]
