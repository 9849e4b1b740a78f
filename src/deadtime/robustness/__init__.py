"""How much a loop stands: margins by its spectrum, and tolerances by simulation."""

from deadtime.robustness.assess import Robustness, robustness
from deadtime.robustness.tolerance import NoisePrice, Tolerance

__all__ = ["NoisePrice", "Robustness", "Tolerance", "robustness"]
