"""deadtime: predictor feedback for plants with a long input delay that switch between linear modes.

    dx/dt = A_σ(t) x(t) + B_σ(t) u(t − D)

Design a law, simulate it exactly, compare laws. The sign of gains is u = +K x; signals are
right-continuous; arrays index (mode, …), (signal, time).
"""

from deadtime import problems
from deadtime.certificates import theorem_bound
from deadtime.errors import (
    ArgumentError,
    ChatteringError,
    DeadtimeError,
    InfeasibleError,
    ProblemFileError,
    StudyFileError,
)
from deadtime.feedback import Factor, Feedback
from deadtime.gains import lqr, place
from deadtime.laws import (
    AveragedPredictor,
    DelayedStateFeedback,
    ExactPredictor,
    ExpectedPredictor,
    Law,
    MeanPredictor,
    OptimalPredictor,
    SingleModePredictor,
    StateDependentPredictor,
)
from deadtime.lyapunov import common_lyapunov
from deadtime.monte_carlo import monte_carlo
from deadtime.plant import SwitchedSystem
from deadtime.simulation import Trajectory, simulate
from deadtime.spectrum import growth_rate
from deadtime.stabilization import stabilize
from deadtime.switching import (
    FunctionRule,
    HalfSpace,
    Markov,
    Polyhedra,
    SemiMarkov,
    SwitchingSignal,
)
from deadtime.version import __version__

__all__ = [
    "ArgumentError",
    "AveragedPredictor",
    "ChatteringError",
    "DeadtimeError",
    "DelayedStateFeedback",
    "ExactPredictor",
    "ExpectedPredictor",
    "Factor",
    "Feedback",
    "FunctionRule",
    "HalfSpace",
    "InfeasibleError",
    "Law",
    "Markov",
    "MeanPredictor",
    "OptimalPredictor",
    "Polyhedra",
    "ProblemFileError",
    "SemiMarkov",
    "SingleModePredictor",
    "StateDependentPredictor",
    "StudyFileError",
    "SwitchedSystem",
    "SwitchingSignal",
    "Trajectory",
    "__version__",
    "common_lyapunov",
    "growth_rate",
    "lqr",
    "monte_carlo",
    "place",
    "problems",
    "simulate",
    "stabilize",
    "theorem_bound",
]
