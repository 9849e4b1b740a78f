"""What a law or a filter is given as a switching model, checked."""

from __future__ import annotations

from deadtime.base.errors import ArgumentError
from deadtime.switching.models.markov import Markov
from deadtime.switching.models.semi_markov import SemiMarkov


def require_model(model: object, modes: int) -> None:
    """Refuse what is no switching model, or one for another number of modes."""
    if not isinstance(model, Markov | SemiMarkov):
        raise ArgumentError(
            f"model must be a Markov or a SemiMarkov model, got {type(model).__name__}."
        )
    if model.modes != modes:
        raise ArgumentError(
            f"model must have the plant's {modes} modes, got {model.modes}: give it one sojourn "
            "and one row of transition (or rates) per mode."
        )
