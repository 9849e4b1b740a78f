"""`identify` where modes were not logged: their number, their plant, how they switch, in words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import brief
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import number_of
from deadtime.identification.estimate import Estimate
from deadtime.identification.exact_estimate import estimate_exactly
from deadtime.identification.hidden.choice import Fitted, fitted, refined, search_of
from deadtime.identification.hidden.estimated import decoded, estimated, hidden_modes
from deadtime.identification.hidden.hidden_modes import HiddenModes
from deadtime.identification.hidden.noisy_choice import (
    NoisyFit,
    fitted_with_noise,
)
from deadtime.identification.hidden.noisy_estimated import (
    decoded_with_noise,
    estimated_with_noise,
)
from deadtime.identification.log.logged_states import fit_switching
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy.noise import estimate_with_noise, exact_holds
from deadtime.identification.parameters import Layout
from deadtime.identification.residuals import alternates
from deadtime.numerics.kernels import expect_many_calls
from deadtime.switching import SemiMarkov

_CERTAIN = 1e-12  # a stay of so nearly all probability is never left
_Fit = TypeVar("_Fit", Fitted, NoisyFit)
_Found = TypeVar("_Found")
_MOST = 20  # numbers, and modes


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


def numbers_of(modes: Any) -> tuple[int, ...] | None:
    """The numbers of hidden modes that `modes` asks for, rising; None where it names a column.

    Examples
    --------
    >>> numbers_of("gear"), numbers_of(2), numbers_of(range(1, 4))
    (None, (2,), (1, 2, 3))
    """
    if modes is None or isinstance(modes, str):
        return None
    given = list(modes) if isinstance(modes, Iterable) else [modes]
    whole = [isinstance(one, int | np.integer) and not isinstance(one, bool) for one in given]
    if not given or not all(whole) or min(given) < 1 or max(given) > _MOST:
        raise ArgumentError(
            "modes must be the column of the mode, None for one mode, or, of modes that were not "
            f"logged, their number, 1 to {_MOST}, or numbers to choose from such as range(1, 4), "
            f"got {brief(modes)}."
        )
    return tuple(sorted({int(one) for one in given}))
