from .sampled_plant import SampledPlant as SampledPlant
from .sampling import Window as Window
from .switched_system import OperatingPoint as OperatingPoint, SwitchedSystem as SwitchedSystem
from .uncertain import UncertainPlant as UncertainPlant
from .weight import Weight as Weight
