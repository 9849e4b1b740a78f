"""Predictor-feedback laws: one file per law, each a forecast of the switching signal.

Every law is the expectation of the exact predictor feedback under its forecast,

    u(t) = E[ K_σ(t+D) P(t) | what is known at t ],    P(t) = x(t + D) for that future.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
