"""Design for margin: laws with a requested delay margin, and what could be had at all."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
