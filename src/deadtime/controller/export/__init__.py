"""A law for the target: C99 of a controller, FMUs of controller and plant."""

from deadtime.controller.export.c_code import Exported, export_c
from deadtime.controller.export.c_text import Names
from deadtime.controller.export.fmu import ExportedFmu, export_fmu, export_plant_fmu

__all__ = [
    "Exported",
    "ExportedFmu",
    "Names",
    "export_c",
    "export_fmu",
    "export_plant_fmu",
]
