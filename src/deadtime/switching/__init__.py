"""Switching signals, random models and rules of the state; signals on the sampling grid."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
