"""From a log to a plant: matrices, delays and noise, each with its interval.

Times in seconds. An input in row k of a log is held from the time of that row to the next one's.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
