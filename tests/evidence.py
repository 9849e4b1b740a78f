"""Evidence that a law stabilises a plant, made once."""

from functools import cache

import certificate_reference as reference
import deadtime as dt

PAPER = dt.problems.paper().plant
ALPHA = {"common": 0.63, "eigenvectors": 0.65, "extended rows": 0.3}
TIMES = ("step", "signals.dwell_time", "signals.maximum_dwell", "signals.clock_tolerance")
ARRAYS = (
    *("P", "Pi", "S", "setting.plants.A", "setting.plants.B", "setting.F", "setting.G"),
    "setting.delays.ends",
    *("centre.E", "centre.row", "centre.R", "centre.T", "centre.Psi", "centre.F"),
)


def designed(alpha, delay=1.0, dwell_time=None):
    near = PAPER.apart(alpha)
    plant = dt.SwitchedSystem(near.A, near.B, delay)
    return plant, dt.AveragedPredictor(plant, dt.place(plant, [-1.0, -2.0]), None, dwell_time)


@cache
def made(name):
    """A plant, a law and its certificate, and the loop of the second method."""
    aged = (0.234, 0.1634) if name == "extended rows" else ()
    plant, law = designed(ALPHA[name], *aged)
    certificate = dt.certify(plant, law, 0.2, 0.1)
    assert certificate.proven, certificate.message
    loop = reference.Loop(plant.A, plant.B, plant.delay, law.digital(0.1))
    return plant, law, certificate, loop
