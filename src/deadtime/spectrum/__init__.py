"""Spectra: how fast the loop of a plant and a law grows while one mode lasts for ever."""

from deadtime.spectrum.characteristic import CharacteristicRoots, characteristic_roots
from deadtime.spectrum.gain import GainMargin, gain_margin
from deadtime.spectrum.growth import growth_rate
from deadtime.spectrum.lifted import DENSE, LiftedLoop, aged_row, lifted_loop

__all__ = [
    "DENSE",
    "CharacteristicRoots",
    "GainMargin",
    "LiftedLoop",
    "aged_row",
    "characteristic_roots",
    "gain_margin",
    "growth_rate",
    "lifted_loop",
]
