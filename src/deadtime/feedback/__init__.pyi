from .ideal_form import Forecast as Forecast, Functional as Functional
from .law import Law as Law, TableLaw as TableLaw, cache_table as cache_table
from .preview import Preview as Preview
from .table import Factor as Factor, Feedback as Feedback
