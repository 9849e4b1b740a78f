"""Exports: a controller as C99, a controller or a plant as an FMU."""

from deadtime.controller.export.c_code import Exported, export_c
from deadtime.controller.export.c_text import Names
from deadtime.controller.export.fmu import ExportedFmu, export_fmu, export_plant_fmu

__all__ = ["Exported", "ExportedFmu", "Names", "export_c", "export_fmu", "export_plant_fmu"]
