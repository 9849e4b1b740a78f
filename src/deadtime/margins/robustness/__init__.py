"""How much a loop tolerates: margins by its spectrum, and tolerances by simulation."""

from deadtime.margins.robustness.assess import Robustness, robustness
from deadtime.margins.robustness.tolerance import NoisePrice, Tolerance

__all__ = ["NoisePrice", "Robustness", "Tolerance", "robustness"]
