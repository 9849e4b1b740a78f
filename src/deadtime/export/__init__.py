"""A law for the target: C99 of a controller, FMUs of controller and plant."""

from deadtime.export.c_code import Exported, export_c
from deadtime.export.fmu import ExportedFmu, export_fmu, export_plant_fmu
from deadtime.export.names import Names
from deadtime.export.staging import Staging

__all__ = [
    "Exported",
    "ExportedFmu",
    "Names",
    "Staging",
    "export_c",
    "export_fmu",
    "export_plant_fmu",
]
