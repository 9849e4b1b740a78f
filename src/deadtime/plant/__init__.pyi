from .operating_point import OperatingPoint as OperatingPoint
from .sampled_plant import SampledPlant as SampledPlant
from .steps import Window as Window
from .switched_system import SwitchedSystem as SwitchedSystem
from .uncertain import UncertainPlant as UncertainPlant
from .weight import Weight as Weight
