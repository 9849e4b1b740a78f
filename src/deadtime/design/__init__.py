"""Design for margin: laws with a requested delay margin, and what could be had at all."""

from deadtime.design.design import design
from deadtime.design.limits import DelayLimit, delay_limit
from deadtime.design.result import Design, TradeOff

__all__ = ["DelayLimit", "Design", "TradeOff", "delay_limit", "design"]
