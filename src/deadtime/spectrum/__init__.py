"""Spectra: how fast the loop of a plant and a law grows while one mode lasts for ever."""

from deadtime.spectrum.characteristic import CharacteristicRoots, characteristic_roots
from deadtime.spectrum.growth import growth_rate
from deadtime.spectrum.lifted import DENSE, LiftedLoop, aged_row, lifted_loop

__all__ = [
    "DENSE",
    "CharacteristicRoots",
    "LiftedLoop",
    "aged_row",
    "characteristic_roots",
    "growth_rate",
    "lifted_loop",
]
