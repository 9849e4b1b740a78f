"""Certificates: what can be proved about a loop."""

from deadtime.certificates.theorem import TheoremBound, theorem_bound

__all__ = ["TheoremBound", "theorem_bound"]
