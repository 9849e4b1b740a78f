"""`identify` where modes were not logged: their number, their plant, how they switch, in words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import number_of
from deadtime.identification.estimate import Estimate
from deadtime.identification.exact_estimate import estimate_exactly
from deadtime.identification.hidden.choice import Fitted, fitted, refined, search_of
from deadtime.identification.hidden.estimated import decoded, estimated, hidden_modes
from deadtime.identification.hidden.hidden_modes import HiddenModes
from deadtime.identification.hidden.hidden_sentences import TriedNumbers, of_numbers, of_sureness
from deadtime.identification.hidden.noisy_choice import (
    NoisyFit,
    fitted_with_noise,
)
from deadtime.identification.hidden.noisy_estimated import (
    decoded_with_noise,
    estimated_with_noise,
)
from deadtime.identification.log.logged_modes import fit_switching
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy.noise import estimate_with_noise
from deadtime.identification.noisy.noise_intervals import exact_holds
from deadtime.identification.parameters import Layout
from deadtime.identification.residuals import alternates
from deadtime.numerics.kernels import expect_many_calls
from deadtime.switching import SwitchingModel
from deadtime.switching.models.semi_markov import SemiMarkov

_CERTAIN = 1e-12  # a stay of so nearly all probability is never left
_Fit = TypeVar("_Fit", Fitted, NoisyFit)
_Found = TypeVar("_Found")


class Hidden(NamedTuple):
    """An estimate, the recording with its likeliest modes, their switching model, and sentences.

    why : there is no model; estimate, modes : None where one mode was chosen
    """

    number: int
    estimate: Estimate | None
    modes: HiddenModes | None
    recording: Recording
    model: SwitchingModel | None
    why: str
    sentences: tuple[str, ...]


class Sensed(NamedTuple):
    """A recording of the states; the same as it was logged, y = C x; and whether sensors are noisy.

    Both are about a level.

    noise : None where that is to be tried if what is left without may be noise of sensors
    """

    states: Recording
    outputs: Recording
    C: Float[np.ndarray, "p n"]
    noise: bool | None


def identify_hidden(
    sensed: Sensed,
    numbers: tuple[int, ...],
    layout: Layout,
    bounds: tuple[float, float],
    within: bool,
    progress: Callable[[str], None],
) -> Hidden:
    """The likeliest plant whose modes are hidden, of one of several numbers of them, by BIC.

    layout : with one mode, as the recording has, and constant terms
    """
    expect_many_calls()
    search = search_of(sensed.states, layout, bounds, within)
    if not sensed.noise:
        tried = _tried(
            numbers, lambda modes: fitted(search, replace(layout, modes=modes)), progress
        )
        progress("looking how well the log tells them")
        found = _without_noise(tried, sensed.states, within)
        if sensed.noise is False or numbers == (1,):
            return found
        exact = found.estimate or estimate_exactly(sensed.states, layout, bounds, within)
        if exact.tests.white and _holds(found, sensed.C, within, bounds):
            return found
    given = sensed.outputs, sensed.C
    noisy = _tried(
        numbers,
        lambda modes: fitted_with_noise(search, replace(layout, modes=modes), *given),
        lambda said: progress(f"{said}, sensors taken for noisy"),
    )
    progress("looking how well the log tells them, sensors taken for noisy")
    return _with_noise(noisy, sensed.outputs, within)


def _holds(
    found: Hidden, C: Float[np.ndarray, "p n"], within: bool, bounds: tuple[float, float]
) -> bool:
    """Whether states may be taken as exact, told as of logged modes, those of the likeliest path.

    That takes seconds where noise behind hidden modes takes minutes. One mode is judged as such.
    """
    exact = found.estimate
    if exact is None or not alternates(list(exact.white)):
        return True
    return exact_holds(exact, estimate_with_noise(found.recording, C, exact, within, bounds))


def _tried(
    numbers: tuple[int, ...], fit: Callable[[int], _Fit], progress: Callable[[str], None]
) -> TriedNumbers[_Fit]:
    """Fits of numbers of modes, as far as they go; of a single number of the next smaller, too.

    Raises
    ------
    ArgumentError
        If not even the first goes.
    """
    fits, refused = [], None
    for number in numbers:
        progress(f"looking for {number_of(number, 'mode')}")
        try:
            fits.append(fit(number))
        except ArgumentError as error:
            if not fits:
                raise
            refused = error
            break  # more are too many, too
    if len(numbers) == 1 and numbers[0] > 1:  # do fewer explain the log as well?
        progress(f"looking whether {number_of(numbers[0] - 1, 'mode')} would do")
        with suppress(ArgumentError):
            fits.insert(0, fit(numbers[0] - 1))
    return TriedNumbers(fits, numbers, refused)


def _without_noise(tried: TriedNumbers[Fitted], recording: Recording, within: bool) -> Hidden:
    """The best of fits of exact states."""
    best, found, left_out = _chosen(tried, lambda fit: decoded(refined(fit)))
    said = of_numbers(best.layout.modes, tried, left_out)
    if found is None:
        return Hidden(1, None, None, recording, None, "", said)
    estimate, of_modes = estimated(found)
    modes = hidden_modes(tried.fits, best, found.log.recording, of_modes)
    return _whole(estimate, modes, found.log.recording, said, within)


def _with_noise(tried: TriedNumbers[NoisyFit], recording: Recording, within: bool) -> Hidden:
    """The best of fits of noisy sensors."""
    best, found, left_out = _chosen(tried, decoded_with_noise)
    said = of_numbers(best.layout.modes, tried, left_out)
    if found is None:
        return Hidden(1, None, None, recording, None, "", said)
    estimate, of_modes = estimated_with_noise(found)
    modes = hidden_modes(tried.fits, best.begun, found.recording, of_modes)
    return _whole(estimate, modes, found.recording, said, within)


def _chosen(
    tried: TriedNumbers[_Fit], decode: Callable[[_Fit], _Found]
) -> tuple[_Fit, _Found | None, list[int]]:
    """The fit of least BIC whose likeliest path visits all modes, and what that path makes of it.

    And the numbers of modes that have less BIC, but no such path. One mode needs none.

    Raises
    ------
    ArgumentError
        If there is no such fit.
    """
    asked = [fit for fit in tried.fits if fit.layout.modes in tried.numbers]
    *order, last = sorted(asked, key=lambda one: one.bic)
    left_out = []
    for fit in order:
        if fit.layout.modes == 1:
            return fit, None, left_out
        with suppress(ArgumentError):
            return fit, decode(fit), left_out
        left_out.append(fit.layout.modes)
    return last, None if last.layout.modes == 1 else decode(last), left_out


def _whole(
    estimate: Estimate,
    modes: HiddenModes,
    recording: Recording,
    said: Sequence[str],
    within: bool,
) -> Hidden:
    """With the model of how modes switch."""
    model, why = _switching(recording, modes.chain)
    said = (*said, *of_sureness(modes, within))
    return Hidden(len(modes.chain), estimate, modes, recording, model, why, said)


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
