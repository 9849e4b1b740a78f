"""Studies: laws over a grid of plants and switching, with maps and answers in plain sentences.

What draws and writes is in `deadtime.study.report`.
"""

from deadtime.study.load import load_study
from deadtime.study.run import run_study
from deadtime.study.study import Cell, Study

__all__ = ["Cell", "Study", "load_study", "run_study"]
