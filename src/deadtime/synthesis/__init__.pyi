from .design import design as design
from .design_result import Design as Design, TradeOff as TradeOff
from .input_peak import InputPeak as InputPeak, input_peak as input_peak
from .input_sources import InitialStates as InitialStates, StationaryNoise as StationaryNoise
from .limits import DelayLimit as DelayLimit, delay_limit as delay_limit
