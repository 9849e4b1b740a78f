"""The law in real time, one period per call, and on a target: C, FMUs, python-control."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
