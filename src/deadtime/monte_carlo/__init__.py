"""Many random signals: every law on the same ones."""

from deadtime.monte_carlo.run import monte_carlo
from deadtime.monte_carlo.signals import scenario_seed

__all__ = ["monte_carlo", "scenario_seed"]
