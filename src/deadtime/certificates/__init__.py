"""Certificates: what can be proved about a loop, and what refutes it."""

from deadtime.certificates.certificate import Certificate
from deadtime.certificates.certify import certify
from deadtime.certificates.theorem.bound import TheoremBound, theorem_bound
from deadtime.certificates.verification import Verification, verify
from deadtime.certificates.worst_case.falsify import falsify
from deadtime.certificates.worst_case.witness import WorstCase

__all__ = [
    "Certificate",
    "TheoremBound",
    "Verification",
    "WorstCase",
    "certify",
    "falsify",
    "theorem_bound",
    "verify",
]
