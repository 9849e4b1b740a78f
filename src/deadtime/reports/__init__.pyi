from .audit import audit as audit
from .figures.comparison import (
    plot_norms as plot_norms,
    plot_signal as plot_signal,
    plot_verdict as plot_verdict,
    plot_window as plot_window,
)
from .figures.design import plot_designs as plot_designs
from .figures.fit import plot_fit as plot_fit
from .figures.loop import plot_loop as plot_loop
from .figures.margins import plot_chart as plot_chart, plot_tightness as plot_tightness
from .figures.monte_carlo import plot_monte_carlo as plot_monte_carlo
from .figures.robustness import plot_robustness as plot_robustness
from .figures.runs import plot_laws as plot_laws
from .figures.sweeps import (
    plot_bands as plot_bands,
    plot_heat as plot_heat,
    plot_regret as plot_regret,
    plot_wins as plot_wins,
)
from .figures.witness import plot_witness as plot_witness
from .report import write_report as write_report
from .study import run_study as run_study
from .study.report import write_study as write_study
from .tables.certificates import judge as judge
from .tables.design import (
    design_record as design_record,
    design_rows as design_rows,
    limit_rows as limit_rows,
    problem_sections as problem_sections,
)
from .tables.monte_carlo import summary as summary
from .tables.sweep import SweepTable as SweepTable, sweep_table as sweep_table
from .tightness import tightness as tightness
from .verdict import verdict as verdict
