"""Laws designed for a delay margin, a decay rate and a cost, and what could be had at all."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
