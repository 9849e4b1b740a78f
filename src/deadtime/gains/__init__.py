"""Gains of every mode, and the Lyapunov functions that they have in common."""

from deadtime.gains.lyapunov import CommonLyapunov, common_lyapunov
from deadtime.gains.stabilization import stabilize
from deadtime.gains.state_feedback import lqr, place

__all__ = ["CommonLyapunov", "common_lyapunov", "lqr", "place", "stabilize"]
