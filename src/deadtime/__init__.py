"""deadtime: predictor feedback for plants with a long input delay that switch between linear modes.

    dx/dt = A_σ(t) x(t) + B_σ(t) u(t − D)

Design a law, simulate it exactly, compare laws. The sign of gains is u = +K x; signals are
right-continuous; arrays index (mode, …), (signal, time).
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from deadtime import imperfections, problems
from deadtime.base.errors import (
    ArgumentError,
    CertificateFileError,
    ChatteringError,
    ClusterError,
    DeadtimeError,
    InfeasibleError,
    ProblemFileError,
    SolverError,
    StoreError,
    StudyFileError,
    WorkerError,
)
from deadtime.base.version import __version__
from deadtime.controller import Controller
from deadtime.estimation import Observer, OutputFeedback, Servo, kalman, luenberger
from deadtime.feedback import Factor, Feedback, Law
from deadtime.gains import common_lyapunov, lqr, place, stabilize
from deadtime.laws import (
    AveragedPredictor,
    DelayedStateFeedback,
    ExactPredictor,
    ExpectedPredictor,
    LowPassPredictor,
    MeanPredictor,
    OptimalPredictor,
    SingleModePredictor,
    StateDependentPredictor,
)
from deadtime.margins import Robustness, gain_margin, robustness
from deadtime.plant import SwitchedSystem
from deadtime.scenarios import draw_signals, monte_carlo
from deadtime.simulation import Trajectory, simulate
from deadtime.spectrum import characteristic_roots, growth_bounds, growth_rate
from deadtime.switching import (
    FunctionRule,
    HalfSpace,
    Markov,
    Polyhedra,
    QuadraticRegions,
    SemiMarkov,
    SignalBatch,
    SwitchingSignal,
)
from deadtime.synthesis import DelayLimit, Design, delay_limit, design
from deadtime.weight import Weight

if TYPE_CHECKING:
    from deadtime.certificates import (
        Certificate,
        Verification,
        WorstCase,
        certify,
        falsify,
        theorem_bound,
        verify,
    )
    from deadtime.margins import delay_margin, least_dwell_time, stability_chart, stability_margin
    from deadtime.scenarios.sweeps import (
        FunctionStudy,
        Study,
        function_study,
        load_study,
        open_sweep,
        sweep,
    )

__all__ = [
    "ArgumentError",
    "AveragedPredictor",
    "Certificate",
    "CertificateFileError",
    "ChatteringError",
    "ClusterError",
    "Controller",
    "DeadtimeError",
    "DelayLimit",
    "DelayedStateFeedback",
    "Design",
    "ExactPredictor",
    "ExpectedPredictor",
    "Factor",
    "Feedback",
    "FunctionRule",
    "FunctionStudy",
    "HalfSpace",
    "InfeasibleError",
    "Law",
    "LowPassPredictor",
    "Markov",
    "MeanPredictor",
    "Observer",
    "OptimalPredictor",
    "OutputFeedback",
    "Polyhedra",
    "ProblemFileError",
    "QuadraticRegions",
    "Robustness",
    "SemiMarkov",
    "Servo",
    "SignalBatch",
    "SingleModePredictor",
    "SolverError",
    "StateDependentPredictor",
    "StoreError",
    "Study",
    "StudyFileError",
    "SwitchedSystem",
    "SwitchingSignal",
    "Trajectory",
    "Verification",
    "Weight",
    "WorkerError",
    "WorstCase",
    "__version__",
    "certify",
    "characteristic_roots",
    "common_lyapunov",
    "delay_limit",
    "delay_margin",
    "design",
    "draw_signals",
    "falsify",
    "function_study",
    "gain_margin",
    "growth_bounds",
    "growth_rate",
    "imperfections",
    "kalman",
    "least_dwell_time",
    "load_study",
    "lqr",
    "luenberger",
    "monte_carlo",
    "open_sweep",
    "place",
    "problems",
    "robustness",
    "simulate",
    "stability_chart",
    "stability_margin",
    "stabilize",
    "sweep",
    "theorem_bound",
    "verify",
]


_SWEEPS = ("FunctionStudy", "Study", "function_study", "load_study", "open_sweep", "sweep")


def __getattr__(name: str) -> Any:
    """Certificates and sweeps are half of the package and are imported where they are asked for."""
    if name in __all__:
        home = "deadtime.scenarios.sweeps" if name in _SWEEPS else "deadtime.certificates"
        return getattr(import_module(home), name)
    raise AttributeError(f"module 'deadtime' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(set(globals()) | set(__all__))
