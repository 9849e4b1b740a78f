"""Outputs that follow a reference, whatever constant disturbance acts."""

from deadtime.tracking.servo import Servo

__all__ = ["Servo"]
