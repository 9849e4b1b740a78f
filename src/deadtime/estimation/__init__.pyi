from .belief_predictor import BeliefPredictor as BeliefPredictor
from .mode_filter import ModeFilter as ModeFilter
from .observer import Observer as Observer, kalman as kalman, luenberger as luenberger
from .output_feedback import OutputFeedback as OutputFeedback
from .output_mode_filter import OutputModeFilter as OutputModeFilter
from .running_filter import (
    RunningFilter as RunningFilter,
    RunningOutputFilter as RunningOutputFilter,
)
from .servo import Servo as Servo
