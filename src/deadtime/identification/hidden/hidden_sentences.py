"""What there is to say, in words, of modes that were not logged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import number_of
from deadtime.identification.hidden.choice import Fitted
from deadtime.identification.hidden.hidden_modes import HiddenModes
from deadtime.identification.hidden.noisy_choice import NoisyFit

_Fit = TypeVar("_Fit", Fitted, NoisyFit)


@dataclass(frozen=True)
class TriedNumbers(Generic[_Fit]):
    """Fits of several numbers of modes, those that were asked for, and why others were refused."""

    fits: Sequence[_Fit]
    numbers: tuple[int, ...]
    refused: ArgumentError | None


def of_numbers(
    number: int, tried: TriedNumbers[Fitted] | TriedNumbers[NoisyFit], left_out: Sequence[int]
) -> tuple[str, ...]:
    """What there is to say of the number of modes; of those left out the path leaves out a mode."""
    numbers, refused = tried.numbers, tried.refused
    bic = {one.layout.modes: one.bic for one in tried.fits}
    table = ", ".join(f"{bic[one]:.1f} with {one}" for one in sorted(bic) if one in numbers)
    said = []
    if len(numbers) > 1:
        most = number_of(number, "mode")
        row = len(numbers) == numbers[-1] - numbers[0] + 1
        asked = f"{numbers[0]} to {numbers[-1]}" if row else ", ".join(map(str, numbers))
        said.append(f"{most} of {asked}: BIC is least, {table}.")
        if left_out:
            others = " and ".join(map(str, left_out))
            said[-1] = (
                f"{most} of {asked}: BIC is least of those whose likeliest path visits every mode, "
                f"{table}; that of {others} leaves one out."
            )
        if number == max(bic) and number > 1 and refused is None:
            said.append("More might do better still: let the numbers go on.")
    elif number > 1 and bic.get(number - 1, np.inf) < bic[number]:
        fewer = number_of(number - 1, "mode")
        said.append(
            f"{fewer} explain{'s' if number == 2 else ''} the log better (BIC "
            f"{bic[number - 1]:.1f}, against {bic[number]:.1f} with {number}): two of the modes "
            "are alike, or the log does not tell them apart, and their matrices are fitted to "
            f"chance. Say modes={number - 1}."
        )
    if len(numbers) > 1 and refused is not None:
        said.append(f"Others were not tried: {refused}")
    return tuple(said)


def of_sureness(modes: HiddenModes, within: bool) -> tuple[str, ...]:
    """How sure the modes are, and what is taken for granted."""
    longer = 100.0 * (modes.widening - 1.0)
    said = [
        "Modes were not logged; they are numbered as the likeliest path visits them. "
        f"{100.0 * modes.sure:.0f} % of rows have one that is at least 95 % sure; not knowing them "
        f"makes intervals up to {longer:.0f} % longer.",
    ]
    if not within:
        said.append("Modes are taken to change at samples only.")
    return tuple(said)
