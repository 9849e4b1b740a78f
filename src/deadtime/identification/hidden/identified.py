"""`identify` where modes were not logged: their number, their plant, how they switch, in words."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import number_of
from deadtime.identification.estimate import Estimate
from deadtime.identification.hidden.choice import Fitted, fitted, refined, search_of
from deadtime.identification.hidden.estimated import decoded, estimated, hidden_modes
from deadtime.identification.hidden.found import HiddenModes
from deadtime.identification.logged_modes import fit_switching
from deadtime.identification.parameters import Layout
from deadtime.identification.recording import Recording
from deadtime.numerics.kernels import expect_many_calls
from deadtime.switching import SemiMarkov

_CERTAIN = 1e-12  # a stay of so nearly all probability is never left


class Hidden(NamedTuple):
    """An estimate, the recording with its likeliest modes, their switching model, and sentences.

    why : there is no model; estimate, modes : None where one mode was chosen
    """

    number: int
    estimate: Estimate | None
    modes: HiddenModes | None
    recording: Recording
    model: SemiMarkov | None
    why: str
    sentences: tuple[str, ...]


def identify_hidden(
    recording: Recording,
    numbers: tuple[int, ...],
    layout: Layout,
    bounds: tuple[float, float],
    within: bool,
) -> Hidden:
    """The likeliest plant whose modes are hidden, of one of several numbers of them, by BIC."""
    expect_many_calls()
    search = search_of(recording, layout, bounds, within)
    fits, refused = [], None
    for number in numbers:
        try:
            fits.append(fitted(search, replace(layout, modes=number)))
        except ArgumentError as error:
            if not fits:
                raise
            refused = error
            break  # more are too many, too
    asked = list(fits)
    if len(numbers) == 1 and numbers[0] > 1:  # do fewer explain the log as well?
        fewer = replace(layout, modes=numbers[0] - 1)
        with suppress(ArgumentError):
            fits.insert(0, fitted(search, fewer))
    best = min(asked, key=lambda one: one.bic)
    said = _numbers(best, fits, numbers, refused)
    if best.layout.modes == 1:
        return Hidden(1, None, None, recording, None, "", said)
    best = refined(best)
    found = decoded(best, recording)
    estimate, told = estimated(found)
    modes = hidden_modes(best, fits, found, told)
    model, why = _switching(found.log.recording, modes.chain)
    said = (*said, *_sureness(modes, within))
    return Hidden(best.layout.modes, estimate, modes, found.log.recording, model, why, said)


def _switching(recording: Recording, chain: np.ndarray) -> tuple[SemiMarkov | None, str]:
    """The model of the likeliest path's sojourns; of the chain where these are too few for one."""
    from scipy.stats import expon

    model, why = fit_switching(recording)
    leave = 1.0 - np.diagonal(chain)
    if model is not None or leave.min() < _CERTAIN:
        return model, why
    jumps = chain * ~np.eye(len(chain), dtype=bool)
    sojourns = [expon(scale=recording.step / one) for one in leave]
    return SemiMarkov(sojourns, jumps / jumps.sum(axis=1, keepdims=True)), ""


def _numbers(
    best: Fitted, fits: list[Fitted], numbers: tuple[int, ...], refused: ArgumentError | None
) -> tuple[str, ...]:
    """What there is to say of the number of modes."""
    number, bic = best.layout.modes, {one.layout.modes: one.bic for one in fits}
    table = ", ".join(f"{bic[one]:.1f} with {one}" for one in sorted(bic) if one in numbers)
    said = []
    if len(numbers) > 1:
        most = number_of(number, "mode")
        row = len(numbers) == numbers[-1] - numbers[0] + 1
        tried = f"{numbers[0]} to {numbers[-1]}" if row else ", ".join(map(str, numbers))
        said.append(f"{most} of {tried}: BIC is least, {table}.")
        if number == max(bic) and number > 1 and refused is None:
            said.append("More might do better still: let the numbers go on.")
    elif number > 1 and bic.get(number - 1, np.inf) < best.bic:
        fewer = number_of(number - 1, "mode")
        said.append(
            f"{fewer} explain{'s' if number == 2 else ''} the log better (BIC "
            f"{bic[number - 1]:.1f}, against {best.bic:.1f} with {number}): two of the modes are "
            "alike, or the log does not tell them apart, and their matrices are fitted to chance. "
            f"Say modes={number - 1}."
        )
    if len(numbers) > 1 and refused is not None:
        said.append(f"Others were not tried: {refused}")
    return tuple(said)


def _sureness(modes: HiddenModes, within: bool) -> tuple[str, ...]:
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
