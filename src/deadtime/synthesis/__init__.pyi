from .design import design as design
from .initial_states import InitialStates as InitialStates
from .input_peak import InputPeak as InputPeak, input_peak as input_peak
from .limits import DelayLimit as DelayLimit, delay_limit as delay_limit
from .result import Design as Design, TradeOff as TradeOff
from .stationary_noise import StationaryNoise as StationaryNoise
