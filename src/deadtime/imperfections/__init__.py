"""Imperfections of a loop: its sensors, actuators and disturbances.

A run takes a list of imperfections (`simulate(..., imperfections=[...], seed=0)`): disturbances
that act on the plant, and, in the order of the list, what the sensors do to what the law is told
of x(t_k) and σ(t_k), and the actuators to what it asks for. The plant stays exact between samples.
Each draws from a stream of its own, made from the seed, the name of its class and how many of that
class come before: adding one changes nothing that the others draw.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
