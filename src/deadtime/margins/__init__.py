"""How far a loop is from the edge: delay, gain, dwell time, imperfections."""

from deadtime.margins.chart import StabilityChart, stability_chart
from deadtime.margins.delay import delay_margin
from deadtime.margins.dwell_time import LeastDwellTime, least_dwell_time
from deadtime.margins.gain import GainMargin, gain_margin
from deadtime.margins.robustness.assess import Robustness, robustness
from deadtime.margins.robustness.tolerance import NoisePrice, Tolerance
from deadtime.margins.stability import StabilityMargin, stability_margin

__all__ = [
    "GainMargin",
    "LeastDwellTime",
    "NoisePrice",
    "Robustness",
    "StabilityChart",
    "StabilityMargin",
    "Tolerance",
    "delay_margin",
    "gain_margin",
    "least_dwell_time",
    "robustness",
    "stability_chart",
    "stability_margin",
]
