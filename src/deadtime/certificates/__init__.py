"""Certificates: what can be proved about a loop, and what refutes it."""

from deadtime.certificates.certificate import Certificate, Verification, verify
from deadtime.certificates.certify import certify
from deadtime.certificates.margins import (
    StabilityChart,
    StabilityMargin,
    delay_margin,
    stability_chart,
    stability_margin,
)
from deadtime.certificates.theorem import TheoremBound, theorem_bound
from deadtime.certificates.worst_case import WorstCase, falsify

__all__ = [
    "Certificate",
    "StabilityChart",
    "StabilityMargin",
    "TheoremBound",
    "Verification",
    "WorstCase",
    "certify",
    "delay_margin",
    "falsify",
    "stability_chart",
    "stability_margin",
    "theorem_bound",
    "verify",
]
