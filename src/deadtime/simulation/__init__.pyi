from .simulate import simulate as simulate
from .trajectory import Trajectory as Trajectory
