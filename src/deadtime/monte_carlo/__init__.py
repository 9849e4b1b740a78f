"""Many random signals: every law on the same ones."""

from deadtime.monte_carlo.run import monte_carlo
from deadtime.monte_carlo.source import draw_signals, scenario_seed

__all__ = ["draw_signals", "monte_carlo", "scenario_seed"]
