from .excitation.design import design_experiment as design_experiment
from .excitation.experiment import Experiment as Experiment
from .hidden.found import HiddenModes as HiddenModes
from .identification import Identification as Identification
from .identify import identify as identify
