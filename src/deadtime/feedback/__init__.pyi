from .forecast import Forecast as Forecast
from .law import Law as Law, TableLaw as TableLaw, remembered as remembered
from .table import Factor as Factor, Feedback as Feedback
