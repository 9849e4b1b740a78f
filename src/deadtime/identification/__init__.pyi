from .identification import Identification as Identification
from .identify import identify as identify
