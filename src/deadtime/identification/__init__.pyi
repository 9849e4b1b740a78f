from .hidden.found import HiddenModes as HiddenModes
from .identification import Identification as Identification
from .identify import identify as identify
