"""Design for margin: laws with a requested delay margin, and what could be had at all."""

from deadtime.synthesis.design import design
from deadtime.synthesis.limits import DelayLimit, delay_limit
from deadtime.synthesis.result import Design, TradeOff

__all__ = ["DelayLimit", "Design", "TradeOff", "delay_limit", "design"]
