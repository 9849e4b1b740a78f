"""Margins: how far a plant may change before a law loses it, between a proof and a witness."""

from deadtime.certificates.margins.chart import StabilityChart, stability_chart
from deadtime.certificates.margins.delay import delay_margin
from deadtime.certificates.margins.dwell_time import LeastDwellTime, least_dwell_time
from deadtime.certificates.margins.stability import StabilityMargin, stability_margin

__all__ = [
    "LeastDwellTime",
    "StabilityChart",
    "StabilityMargin",
    "delay_margin",
    "least_dwell_time",
    "stability_chart",
    "stability_margin",
]
