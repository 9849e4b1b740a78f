"""Predictor-feedback laws as data: a table of rows, a forecast, and the interface of laws."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
