"""Imperfections of a loop: its sensors, actuators and disturbances.

A run takes a list of imperfections (`simulate(..., imperfections=[...], seed=0)`): disturbances of
the plant, and, in the order of the list, sensors that change the measurements x(t_k) and σ(t_k) of
the law, and actuators that change its commands. The plant stays exact between samples. Each has a
random stream of its own, from the seed, the name of its class and its number among those of the
class: adding one does not change the numbers of the others.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
