"""The law in a loop that runs: one period per call."""

from deadtime.controller.controller import Controller
from deadtime.controller.status import Status

__all__ = ["Controller", "Status"]
