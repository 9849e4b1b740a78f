"""Certificates: what can be proved about a loop, and what refutes it."""

from deadtime.certificates.certificate import Certificate
from deadtime.certificates.certify import certify
from deadtime.certificates.margins import (
    LeastDwellTime,
    StabilityChart,
    StabilityMargin,
    delay_margin,
    least_dwell_time,
    stability_chart,
    stability_margin,
)
from deadtime.certificates.theorem import TheoremBound, theorem_bound
from deadtime.certificates.verification import Verification, verify
from deadtime.certificates.worst_case import WorstCase, falsify

__all__ = [
    "Certificate",
    "LeastDwellTime",
    "StabilityChart",
    "StabilityMargin",
    "TheoremBound",
    "Verification",
    "WorstCase",
    "certify",
    "delay_margin",
    "falsify",
    "least_dwell_time",
    "stability_chart",
    "stability_margin",
    "theorem_bound",
    "verify",
]
