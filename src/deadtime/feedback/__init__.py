"""What a predictor-feedback law is: a table of rows, a forecast, and the interface of laws."""

from deadtime.feedback.forecast import Forecast
from deadtime.feedback.law import Law
from deadtime.feedback.table import Factor, Feedback

__all__ = ["Factor", "Feedback", "Forecast", "Law"]
