"""The plant: in continuous time, and at a sampling period as pieces with delayed inputs."""

from deadtime.plant.sampled_plant import SampledPlant
from deadtime.plant.steps import Window
from deadtime.plant.switched_system import SwitchedSystem

__all__ = ["SampledPlant", "SwitchedSystem", "Window"]
