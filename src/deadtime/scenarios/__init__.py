"""Many random signals: every law on the same ones."""

from deadtime.scenarios.run import monte_carlo
from deadtime.scenarios.source import draw_signals, scenario_seed

__all__ = ["draw_signals", "monte_carlo", "scenario_seed"]
