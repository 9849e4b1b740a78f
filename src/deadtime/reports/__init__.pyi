from .audit import audit as audit
from .certificate_tables import judge as judge
from .design import (
    design_record as design_record,
    design_rows as design_rows,
    limit_rows as limit_rows,
    plot_designs as plot_designs,
    problem_sections as problem_sections,
)
from .figures.certificates import plot_chart as plot_chart, plot_witness as plot_witness
from .figures.loop import plot_loop as plot_loop
from .figures.monte_carlo import plot_monte_carlo as plot_monte_carlo
from .figures.runs import (
    plot_laws as plot_laws,
    plot_norms as plot_norms,
    plot_signal as plot_signal,
    plot_verdict as plot_verdict,
    plot_window as plot_window,
)
from .figures.sweeps import (
    plot_bands as plot_bands,
    plot_heat as plot_heat,
    plot_regret as plot_regret,
    plot_wins as plot_wins,
)
from .fit import plot_fit as plot_fit
from .report import write_report as write_report
from .robustness import plot_robustness as plot_robustness
from .scenario_tables import (
    SweepTable as SweepTable,
    summary as summary,
    sweep_table as sweep_table,
)
from .study import run_study as run_study
from .study.report import write_study as write_study
from .verdict import verdict as verdict
