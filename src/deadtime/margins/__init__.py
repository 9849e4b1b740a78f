"""How far a loop is from the edge: delay, gain, dwell time, imperfections."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
