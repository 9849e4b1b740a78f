from .comparison import Comparison as Comparison, compare as compare
from .file.load import load_problem as load_problem
from .file.schema import json_schema as json_schema
from .literature import (
    NAMED as NAMED,
    comparison_laws as comparison_laws,
    follower as follower,
    paper as paper,
    three_mode as three_mode,
)
from .problem import Problem as Problem, Published as Published
