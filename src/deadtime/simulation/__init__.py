"""Simulation of a plant under a law: exact for the digital loop."""

from deadtime.simulation.simulate import simulate
from deadtime.simulation.trajectory import Trajectory

__all__ = ["Trajectory", "simulate"]
