from .excitation.experiment import Experiment as Experiment
from .excitation.experiment_design import design_experiment as design_experiment
from .hidden_modes import HiddenModes as HiddenModes
from .identification import Identification as Identification
from .identify import identify as identify
