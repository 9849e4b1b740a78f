"""States from outputs, references for outputs: observers, output feedback, servos."""

from deadtime.estimation.observer import Observer
from deadtime.estimation.observer_design import kalman, luenberger
from deadtime.estimation.output_feedback import OutputFeedback
from deadtime.estimation.servo import Servo

__all__ = ["Observer", "OutputFeedback", "Servo", "kalman", "luenberger"]
