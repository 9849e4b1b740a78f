"""Settings to run: plants from the literature, problem files, and what files know."""

from deadtime.problems.literature import NAMED, comparison_laws, follower, paper, three_mode
from deadtime.problems.problem import Problem, Published

__all__ = ["NAMED", "Problem", "Published", "comparison_laws", "follower", "paper", "three_mode"]
