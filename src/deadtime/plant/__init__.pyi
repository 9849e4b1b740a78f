from .discretisation import Window as Window
from .sampled_plant import SampledPlant as SampledPlant
from .switched_system import OperatingPoint as OperatingPoint, SwitchedSystem as SwitchedSystem
from .uncertain import UncertainPlant as UncertainPlant
from .weight import Weight as Weight
