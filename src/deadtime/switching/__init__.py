"""Switching signals: what they are, how they are drawn at random, how logs are read."""

from deadtime.switching.batch import SignalBatch
from deadtime.switching.models.markov import Markov
from deadtime.switching.models.semi_markov import SemiMarkov
from deadtime.switching.rules.quadratic import QuadraticRegions
from deadtime.switching.rules.rule import FunctionRule, HalfSpace, Polyhedra, Rule
from deadtime.switching.signal import SwitchingSignal

__all__ = [
    "FunctionRule",
    "HalfSpace",
    "Markov",
    "Polyhedra",
    "QuadraticRegions",
    "Rule",
    "SemiMarkov",
    "SignalBatch",
    "SwitchingSignal",
]
