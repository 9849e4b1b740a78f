"""Spectra: how fast the loop of a plant and a law grows in a constant mode."""

from deadtime.spectrum.characteristic import CharacteristicRoots, characteristic_roots
from deadtime.spectrum.growth import GROWS, constant_growth, growth_bounds, growth_rate
from deadtime.spectrum.lifted import DENSE, LiftedLoop, aged_row, lifted_loop

__all__ = [
    "DENSE",
    "GROWS",
    "CharacteristicRoots",
    "LiftedLoop",
    "aged_row",
    "characteristic_roots",
    "constant_growth",
    "growth_bounds",
    "growth_rate",
    "lifted_loop",
]
