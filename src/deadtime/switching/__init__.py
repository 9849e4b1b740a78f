"""Switching signals: what they are, how they are drawn at random, how logs are read."""

from deadtime.switching.batch import SignalBatch
from deadtime.switching.markov import Markov
from deadtime.switching.quadratic import QuadraticRegions
from deadtime.switching.rules import FunctionRule, HalfSpace, Polyhedra, Rule
from deadtime.switching.semi_markov import SemiMarkov
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
