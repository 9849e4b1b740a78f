from .estimate import HiddenModes as HiddenModes
from .experiment import Experiment as Experiment, design_experiment as design_experiment
from .identification import Identification as Identification
from .identify import identify as identify
from .validation import Validation as Validation
