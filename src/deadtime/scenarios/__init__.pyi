from .batch_run import monte_carlo as monte_carlo
from .source import draw_signals as draw_signals, scenario_seed as scenario_seed
from .sweeps import (
    Cell as Cell,
    FileStudy as FileStudy,
    FunctionStudy as FunctionStudy,
    Loop as Loop,
    Progress as Progress,
    Study as Study,
    function_study as function_study,
    load_study as load_study,
    open_sweep as open_sweep,
    sweep as sweep,
)
from .sweeps.plan import plan_of as plan_of
