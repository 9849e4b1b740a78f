"""Settings to run: plants from the literature, problem files, and the registries of what files know."""

from deadtime.problems.problem import (
    Problem,
    Published,
    comparison_laws,
    follower,
    paper,
    three_mode,
)

__all__ = ["Problem", "Published", "comparison_laws", "follower", "paper", "three_mode"]
