"""The audit: what the paper says about its example, held against many random signals."""

from deadtime.audit.audit import STEPS, audit
from deadtime.audit.claim import Claim, Proportion, Sweep

__all__ = ["STEPS", "Claim", "Proportion", "Sweep", "audit"]
