"""The audit: what the paper says about its example, held against many random signals."""

from deadtime.reports.audit.audit import STEPS, audit
from deadtime.reports.audit.claim import Claim, Sweep

__all__ = ["STEPS", "Claim", "Sweep", "audit"]
