from .design import design as design
from .limits import DelayLimit as DelayLimit, delay_limit as delay_limit
from .result import Design as Design, TradeOff as TradeOff
