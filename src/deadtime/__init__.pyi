# The public names, and the rooms that they come from; read by type checkers and by `lazy_loader`.
from . import imperfections as imperfections, problems as problems
from .base.errors import (
    ArgumentError as ArgumentError,
    CertificateFileError as CertificateFileError,
    ChatteringError as ChatteringError,
    ClusterError as ClusterError,
    DeadtimeError as DeadtimeError,
    InfeasibleError as InfeasibleError,
    ProblemFileError as ProblemFileError,
    SolverError as SolverError,
    StoreError as StoreError,
    StudyFileError as StudyFileError,
    WorkerError as WorkerError,
)
from .base.version import __version__ as __version__
from .certificates import (
    Certificate as Certificate,
    Verification as Verification,
    WorstCase as WorstCase,
    certify as certify,
    falsify as falsify,
    theorem_bound as theorem_bound,
    verify as verify,
)
from .controller import Controller as Controller
from .estimation import (
    BeliefPredictor as BeliefPredictor,
    ModeFilter as ModeFilter,
    Observer as Observer,
    OutputFeedback as OutputFeedback,
    OutputModeFilter as OutputModeFilter,
    Servo as Servo,
    kalman as kalman,
    luenberger as luenberger,
)
from .feedback import Factor as Factor, Feedback as Feedback, Law as Law
from .gains import (
    common_lyapunov as common_lyapunov,
    lqr as lqr,
    place as place,
    stabilize as stabilize,
)
from .identification import (
    Experiment as Experiment,
    Identification as Identification,
    Validation as Validation,
    design_experiment as design_experiment,
    identify as identify,
)
from .laws import (
    AveragedPredictor as AveragedPredictor,
    DelayedStateFeedback as DelayedStateFeedback,
    ExactPredictor as ExactPredictor,
    ExpectedPredictor as ExpectedPredictor,
    LowPassPredictor as LowPassPredictor,
    MeanPredictor as MeanPredictor,
    OptimalPredictor as OptimalPredictor,
    SingleModePredictor as SingleModePredictor,
    StateDependentPredictor as StateDependentPredictor,
)
from .margins import (
    Robustness as Robustness,
    delay_margin as delay_margin,
    gain_margin as gain_margin,
    least_dwell_time as least_dwell_time,
    longest_mode_lag as longest_mode_lag,
    loop_transfer as loop_transfer,
    robustness as robustness,
    stability_chart as stability_chart,
    stability_margin as stability_margin,
)
from .plant import (
    SwitchedSystem as SwitchedSystem,
    UncertainPlant as UncertainPlant,
    Weight as Weight,
)
from .scenarios import (
    FunctionStudy as FunctionStudy,
    Study as Study,
    draw_signals as draw_signals,
    function_study as function_study,
    load_study as load_study,
    monte_carlo as monte_carlo,
    open_sweep as open_sweep,
    sweep as sweep,
)
from .simulation import Trajectory as Trajectory, simulate as simulate
from .spectrum import (
    characteristic_roots as characteristic_roots,
    growth_bounds as growth_bounds,
    growth_rate as growth_rate,
)
from .switching import (
    FunctionRule as FunctionRule,
    HalfSpace as HalfSpace,
    Polyhedra as Polyhedra,
    QuadraticRegions as QuadraticRegions,
    SignalBatch as SignalBatch,
    SignalClass as SignalClass,
    SwitchingSignal as SwitchingSignal,
)
from .switching.models.markov import Markov as Markov
from .switching.models.markov_chain import MarkovChain as MarkovChain
from .switching.models.semi_markov import SemiMarkov as SemiMarkov
from .synthesis import (
    DelayLimit as DelayLimit,
    Design as Design,
    InitialStates as InitialStates,
    StationaryNoise as StationaryNoise,
    delay_limit as delay_limit,
    design as design,
)
