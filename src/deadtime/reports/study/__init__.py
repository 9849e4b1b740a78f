"""Studies: which law, when? A sweep over plants and switching, with maps and answers in sentences.

`scenarios.sweeps` runs the sweep; `deadtime.reports.study.report` draws and writes the report.
"""

from deadtime.reports.study.study_data import run_study
from deadtime.scenarios.sweeps import Cell, load_study

__all__ = ["Cell", "load_study", "run_study"]
