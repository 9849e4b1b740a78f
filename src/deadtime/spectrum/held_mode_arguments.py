"""What every function of a loop with one mode held asks of its arguments."""

from __future__ import annotations

from deadtime.base.checks import index, instance
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.feedback.law import require_match
from deadtime.plant import SwitchedSystem


def require_constant(plant: SwitchedSystem, law: Law) -> None:
    """Refuse a plant and a law that do not make a loop with one mode held."""
    instance("plant", plant, SwitchedSystem)
    instance("law", law, Law)
    require_match(plant, law)
    if law.foreseen is not None and law.foreseen.switches:
        raise ArgumentError(
            "law must not foresee a signal of its own that switches, when one mode is "
            "held: build the ExactPredictor without one."
        )


def check_mode(plant: SwitchedSystem, law: Law, mode: object) -> int:
    """The mode that is held in a loop, checked."""
    require_constant(plant, law)
    return index("mode", mode, plant.modes)
