from .forecast import Forecast as Forecast
from .law import Law as Law
from .table import Factor as Factor, Feedback as Feedback
