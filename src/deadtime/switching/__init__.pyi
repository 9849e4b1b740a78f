from .batch import SignalBatch as SignalBatch
from .models.model import SwitchingModel as SwitchingModel
from .rules.rule import (
    FunctionRule as FunctionRule,
    HalfSpace as HalfSpace,
    Polyhedra as Polyhedra,
    QuadraticRegions as QuadraticRegions,
    Rule as Rule,
)
from .signal import SwitchingSignal as SwitchingSignal
from .signal_class import SignalClass as SignalClass
