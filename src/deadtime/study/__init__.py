"""Studies: which law, when? A sweep over plants and switching, with maps and answers in sentences.

The sweep is `deadtime.sweeps`; here is what reads its dataset. What draws and writes is in
`deadtime.study.report`.
"""

from deadtime.study.run import run_study
from deadtime.sweeps import Cell, load_study

__all__ = ["Cell", "load_study", "run_study"]
