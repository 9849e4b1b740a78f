"""Predictor-feedback laws: one file per law, each a forecast of the switching signal.

Every law is the expectation of the exact predictor feedback under its forecast,

    u(t) = E[ K_σ(t+D) P(t) | what is known at t ],    P(t) = x(t + D) for that future.
"""

from deadtime.laws.averaged import AveragedPredictor
from deadtime.laws.delayed import DelayedStateFeedback
from deadtime.laws.exact import ExactPredictor
from deadtime.laws.expected import ExpectedPredictor
from deadtime.laws.low_pass import LowPassPredictor
from deadtime.laws.mean import MeanPredictor
from deadtime.laws.optimal import OptimalPredictor
from deadtime.laws.single import SingleModePredictor
from deadtime.laws.state_dependent import StateDependentPredictor

__all__ = [
    "AveragedPredictor",
    "DelayedStateFeedback",
    "ExactPredictor",
    "ExpectedPredictor",
    "LowPassPredictor",
    "MeanPredictor",
    "OptimalPredictor",
    "SingleModePredictor",
    "StateDependentPredictor",
]
