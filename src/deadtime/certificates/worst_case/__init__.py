"""The worst admissible switching signal of a digital loop, and how fast the loop grows along it."""

from deadtime.certificates.worst_case.falsify import falsify
from deadtime.certificates.worst_case.growth_proof import GrowthProof
from deadtime.certificates.worst_case.witness import WorstCase

__all__ = ["GrowthProof", "WorstCase", "falsify"]
