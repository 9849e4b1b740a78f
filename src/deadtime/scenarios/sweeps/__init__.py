"""Sweeps: laws over a labelled grid of plants and switching, into one store, on many cores.

study ── cells ── monte_carlo, on Dask ── Zarr ── xarray.Dataset ── maps
"""

from deadtime.scenarios.sweeps.file_study import FileStudy
from deadtime.scenarios.sweeps.function_study import FunctionStudy, function_study
from deadtime.scenarios.sweeps.load import load_study
from deadtime.scenarios.sweeps.run_sweep import Progress, sweep
from deadtime.scenarios.sweeps.store import open_sweep
from deadtime.scenarios.sweeps.study import Cell, Loop, Study

__all__ = [
    "Cell",
    "FileStudy",
    "FunctionStudy",
    "Loop",
    "Progress",
    "Study",
    "function_study",
    "load_study",
    "open_sweep",
    "sweep",
]
