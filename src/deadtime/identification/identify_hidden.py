"""`identify` where modes were not logged: their number, their plant, how they switch, in words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Generic, NamedTuple

import numpy as np

from deadtime.base.checks import brief
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import number_of
from deadtime.identification.estimate import HiddenModes, IdentifiedLog
from deadtime.identification.exact_estimate import estimate_exactly
from deadtime.identification.hidden_estimate import (
    Decoded,
    ModesEstimate,
    decoded,
    estimated,
    estimated_with_noise,
)
from deadtime.identification.hidden_fit import (
    HiddenFit,
    Log,
    fitted,
    fitted_with_noise,
    refined,
    search_of,
)
from deadtime.identification.log.logged_states import fit_switching
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy_estimate import estimate_with_noise, exact_holds
from deadtime.identification.parameters import Layout, SensorMatrix, Window
from deadtime.identification.residuals import alternates
from deadtime.numerics.kernels import expect_many_calls
from deadtime.switching.models.semi_markov import SemiMarkov

_CERTAIN = 1e-12  # a mode with less probability to leave it is absorbing
_MOST = 20  # modes


class Sensed(NamedTuple):
    """A recording as states and as logged, y = C x, both about a level; and the kind of noise.

    named : names of states
    noise : whether sensors are noisy; None to try it if residuals suggest it
    """

    states: Recording
    outputs: Recording
    C: SensorMatrix
    named: tuple[str, ...]
    noise: bool | None


def identify_hidden(
    sensed: Sensed,
    numbers: tuple[int, ...],
    layout: Layout,
    bounds: Window,
    within: bool,
    progress: Callable[[str], None],
) -> tuple[IdentifiedLog | None, tuple[str, ...]]:
    """The likeliest plant with hidden modes, their number chosen by BIC; and sentences on it.

    The plant is None where one mode is the likeliest.

    layout : with one mode, as in the recording, and constant terms
    """
    expect_many_calls()
    search = search_of(sensed.states, layout, bounds, within)
    if not sensed.noise:
        tried = _tried(
            numbers, lambda modes: fitted(search, replace(layout, modes=modes)), progress
        )
        progress("finding intervals")
        found, said = _chosen(tried, sensed, within, lambda fit: decoded(refined(fit)), estimated)
        if sensed.noise is False or numbers == (1,):
            return found, said
        exact = found.estimate if found else estimate_exactly(sensed.states, layout, bounds, within)
        if exact.tests.white and (found is None or _holds(found)):
            return found, said
    given = sensed.outputs, sensed.C
    noisy = _tried(
        numbers,
        lambda modes: fitted_with_noise(search, replace(layout, modes=modes), *given),
        lambda said: progress(f"{said}, sensors taken for noisy"),
    )
    progress("finding intervals, sensors taken for noisy")
    return _chosen(noisy, sensed, within, decoded, estimated_with_noise)


def _holds(found: IdentifiedLog) -> bool:
    """Whether states may be taken as exact, tested with the modes of the likeliest path as logged.

    This takes seconds where a fit of noisy sensors with hidden modes takes minutes.
    """
    exact = found.estimate
    if not alternates(list(exact.white)):
        return True
    return exact_holds(exact, estimate_with_noise(found.recording, found.C, exact))


def _tried(
    numbers: tuple[int, ...], fit: Callable[[int], HiddenFit[Log]], progress: Callable[[str], None]
) -> TriedNumbers[Log]:
    """Fits of numbers of modes until one is refused; for a single number also of the next smaller.

    Raises
    ------
    ArgumentError
        If the first number is refused.
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


def _chosen(
    tried: TriedNumbers[Log],
    sensed: Sensed,
    within: bool,
    decode: Callable[[HiddenFit[Log]], Decoded[Log]],
    estimate: Callable[[Decoded[Log]], ModesEstimate],
) -> tuple[IdentifiedLog | None, tuple[str, ...]]:
    """The best fit with its estimate and sentences."""
    best, found, left_out = best_of(tried, decode)
    said = of_numbers(best.layout.modes, tried, left_out)
    if found is None:
        return None, said
    by_mode, record, chain = estimate(found), found.recording, found.log.jumps.chain
    modes = HiddenModes(
        np.concatenate([part.time for part in record.parts]),
        np.concatenate([part.mode for part in record.parts]),
        np.vstack(by_mode.node),
        chain,
        np.array([one.layout.modes for one in tried.fits]),
        np.array([one.bic for one in tried.fits]),
        found.fit.values,
        best.begun.starts,
        best.begun.agreed,
        by_mode.widening,
    )
    said = (*said, *of_sureness(modes, within))
    model, why = _switching(record, chain)
    given = by_mode.estimate, record, model, why, sensed.C, sensed.named, said
    return IdentifiedLog(*given, modes=modes), said


def best_of(
    tried: TriedNumbers[Log], decode: Callable[[HiddenFit[Log]], Decoded[Log]]
) -> tuple[HiddenFit[Log], Decoded[Log] | None, list[int]]:
    """The fit of least BIC whose likeliest path visits all modes, decoded if it has several.

    And the numbers of modes with lower BIC whose path does not visit all modes.

    Raises
    ------
    ArgumentError
        If there is no such fit.
    """
    requested = [fit for fit in tried.fits if fit.layout.modes in tried.numbers]
    *order, last = sorted(requested, key=lambda one: one.bic)
    left_out = []
    for fit in order:
        if fit.layout.modes == 1:
            return fit, None, left_out
        with suppress(ArgumentError):
            return fit, decode(fit), left_out
        left_out.append(fit.layout.modes)
    return last, None if last.layout.modes == 1 else decode(last), left_out


def _switching(recording: Recording, chain: np.ndarray) -> tuple[SemiMarkov | None, str]:
    """The switching model of the likeliest path, or of the chain if sojourns are too few."""
    from scipy.stats import expon

    model, why = fit_switching(recording)
    leave = 1.0 - np.diagonal(chain)
    if model is not None or leave.min() < _CERTAIN:
        return model, why
    jumps = chain * ~np.eye(len(chain), dtype=bool)
    sojourns = [expon(scale=recording.step / one) for one in leave]
    return SemiMarkov(sojourns, jumps / jumps.sum(axis=1, keepdims=True)), ""


@dataclass(frozen=True, eq=False)
class TriedNumbers(Generic[Log]):
    """Fits of several numbers of modes, the numbers requested, and why others are refused."""

    fits: Sequence[HiddenFit[Log]]
    numbers: tuple[int, ...]
    refused: ArgumentError | None


def of_numbers(number: int, tried: TriedNumbers, left_out: Sequence[int]) -> tuple[str, ...]:
    """Sentences on the number of modes; `left_out` have paths that do not visit all modes."""
    numbers, refused = tried.numbers, tried.refused
    bic = {one.layout.modes: one.bic for one in tried.fits}
    table = ", ".join(f"{bic[one]:.1f} with {one}" for one in sorted(bic) if one in numbers)
    said = []
    if len(numbers) > 1:
        most = number_of(number, "mode")
        row = len(numbers) == numbers[-1] - numbers[0] + 1
        options = f"{numbers[0]} to {numbers[-1]}" if row else ", ".join(map(str, numbers))
        said.append(f"{most} of {options}: BIC is least, {table}.")
        if left_out:
            others = " and ".join(map(str, left_out))
            said[-1] = (
                f"{most} of {options}: BIC is least of those whose likeliest path visits every "
                f"mode, {table}; that of {others} leaves one out."
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
    """Sentences on the probabilities of modes and on assumptions."""
    longer = 100.0 * (modes.widening - 1.0)
    said = [
        "Modes were not logged; they are numbered as the likeliest path visits them. "
        f"{100.0 * modes.sure:.0f} % of rows have one that is at least 95 % sure; not knowing them "
        f"makes intervals up to {longer:.0f} % longer."
    ]
    if not within:
        said.append("Modes are taken to change at samples only.")
    return tuple(said)


def numbers_of(modes: Any) -> tuple[int, ...] | None:
    """The numbers of hidden modes in `modes`, ascending; None where it names a column.

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
