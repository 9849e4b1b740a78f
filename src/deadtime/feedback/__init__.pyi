from .ideal_form import Forecast as Forecast, Functional as Functional
from .law import Law as Law, TableLaw as TableLaw, remember_table as remember_table
from .preview import Foresight as Foresight
from .table import Factor as Factor, Feedback as Feedback
