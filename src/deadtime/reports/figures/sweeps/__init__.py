"""Pictures of a sweep's store: heat maps, quantile bands, maps of the best law, and regret.

Each takes the dataset of `deadtime.open_sweep`: the grid's axes, whatever their number and
names, then law and scenario. Laws are compared as in studies: on the same signals, a run that
diverged being worse than any other.
"""

from deadtime.reports.figures.sweeps.bands import plot_bands
from deadtime.reports.figures.sweeps.heat import plot_heat, plot_regret, plot_wins

__all__ = ["plot_bands", "plot_heat", "plot_regret", "plot_wins"]
