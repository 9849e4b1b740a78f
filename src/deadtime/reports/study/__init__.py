"""Studies: which law, when? A sweep over plants and switching, with maps and answers in sentences.

The sweep is `scenarios.sweeps`; here is what reads its dataset. What draws and writes is in
`deadtime.reports.study.report`.
"""

from deadtime.reports.study.study_data import run_study
from deadtime.scenarios.sweeps import Cell, load_study

__all__ = ["Cell", "load_study", "run_study"]
