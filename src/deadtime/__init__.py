"""deadtime: predictor feedback for plants with a long input delay that switch between linear modes.

    dx/dt = A_σ(t) x(t) + B_σ(t) u(t − D)

Design a law, simulate it exactly, compare laws. The sign of gains is u = +K x; signals are
right-continuous; arrays index (mode, …), (signal, time).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
