"""The plant: in continuous time, and at a sampling period as pieces with delayed inputs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
