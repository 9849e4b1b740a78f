"""States from outputs: switched observers."""

from deadtime.observers.design import kalman, luenberger
from deadtime.observers.observer import Observer

__all__ = ["Observer", "kalman", "luenberger"]
