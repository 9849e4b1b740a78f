from .estimate import HiddenModes as HiddenModes
from .experiment import Experiment as Experiment, design_experiment as design_experiment
from .identification import Identification as Identification
from .identify import identify as identify
from .process_models import Oscillation as Oscillation, Process as Process, Quantity as Quantity
from .validation import Validation as Validation
