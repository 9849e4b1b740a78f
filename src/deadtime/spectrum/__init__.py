"""Spectra: how fast the loop of a plant and a law grows in a constant mode."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
