"""`identify` where modes were not logged: their number, their plant, and how they switch.

Plants of every number of modes are fitted by maximum likelihood, and BIC selects one (Schwarz,
Annals of Statistics 6(2), 1978). Noisy sensors are tried if residuals of exact states suggest them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Generic

import numpy as np

from deadtime.base.checks import brief
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import number_of
from deadtime.identification.estimate import HiddenModes, IdentifiedLog
from deadtime.identification.exact_estimate import estimate_exactly
from deadtime.identification.hidden_estimate import (
    DecodedFit,
    ModesEstimate,
    decode,
    estimate_hidden,
    estimate_hidden_noisy,
)
from deadtime.identification.hidden_fit import (
    HiddenFit,
    Log,
    fit_hidden,
    fit_hidden_noisy,
    refine,
    search_of,
)
from deadtime.identification.log.logged_states import as_states, fit_switching
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy_estimate import estimate_with_noise, may_be_exact
from deadtime.identification.parameters import Layout, SensorMatrix, Window
from deadtime.identification.residuals import alternates
from deadtime.numerics.kernels import expect_many_calls
from deadtime.switching.models.semi_markov import SemiMarkov

_CERTAIN = 1e-12  # a mode with less probability to leave it is absorbing
_MOST = 20  # modes


def identify_hidden(
    recording: Recording,
    C: SensorMatrix,
    states: tuple[str, ...],
    noise: bool | None,
    numbers: tuple[int, ...],
    layout: Layout,
    bounds: Window,
    within: bool,
    progress: Callable[[str], None],
) -> tuple[IdentifiedLog | None, tuple[str, ...]]:
    """The likeliest plant with hidden modes, their number chosen by BIC; and sentences on it.

    The plant is None where one mode is the likeliest.

    recording : of y = C x, about a level; states : names
    noise : whether sensors are noisy; None to try it if residuals suggest it
    layout : with one mode, as in the recording, and constant terms
    """
    expect_many_calls()
    exact_states = as_states(recording, C)
    search = search_of(exact_states, layout, bounds, within)

    def choose(
        fit: Callable[[Layout], HiddenFit[Log]],
        decode: Callable[[HiddenFit[Log]], DecodedFit[Log]],
        estimate: Callable[[DecodedFit[Log]], ModesEstimate],
        assumption: str = "",
    ) -> tuple[IdentifiedLog | None, tuple[str, ...]]:
        tried = _try_numbers(
            numbers,
            lambda modes: fit(replace(layout, modes=modes)),
            lambda stage: progress(f"{stage}{assumption}"),
        )
        progress(f"finding intervals{assumption}")
        best, decoded, left_out = best_of(tried, decode)
        sentences = of_numbers(best.layout.modes, tried, left_out)
        if decoded is None:
            return None, sentences
        by_mode, record, chain = estimate(decoded), decoded.recording, decoded.log.jumps.chain
        logged = np.concatenate([part.logged for part in record.parts])
        modes = HiddenModes(
            time=np.concatenate([part.time for part in record.parts])[logged],
            mode=np.concatenate([part.mode for part in record.parts])[logged],
            probability=np.vstack(by_mode.node)[logged],
            chain=chain,
            numbers=np.array([one.layout.modes for one in tried.fits]),
            bic=np.array([one.bic for one in tried.fits]),
            likelihoods=decoded.fit.values,
            starts=best.start.draws,
            agreed=best.start.agreed,
            widening=by_mode.widening,
        )
        sentences = (*sentences, *of_sureness(modes, within))
        model, why = _switching(record, chain)
        given = by_mode.estimate, record, model, why, C, states, sentences
        return IdentifiedLog(*given, modes=modes), sentences

    if not noise:
        chosen, sentences = choose(
            lambda own: fit_hidden(search, own), lambda fit: decode(refine(fit)), estimate_hidden
        )
        if noise is False or numbers == (1,):
            return chosen, sentences
        exact = (
            chosen.estimate if chosen else estimate_exactly(exact_states, layout, bounds, within)
        )
        if exact.tests.white and (chosen is None or _holds(chosen)):
            return chosen, sentences
    return choose(
        lambda own: fit_hidden_noisy(search, own, recording, C),
        decode,
        estimate_hidden_noisy,
        ", sensors taken for noisy",
    )


def _holds(chosen: IdentifiedLog) -> bool:
    """Whether states may be taken as exact, tested with the modes of the likeliest path as logged.

    This takes seconds where a fit of noisy sensors with hidden modes takes minutes.
    """
    exact = chosen.estimate
    if not alternates(list(exact.white)):
        return True
    return may_be_exact(exact, estimate_with_noise(chosen.recording, chosen.C, exact))


def _try_numbers(
    numbers: tuple[int, ...], fit: Callable[[int], HiddenFit[Log]], progress: Callable[[str], None]
) -> TriedNumbers[Log]:
    """Fits of numbers of modes until one is refused; for a single number also of the next smaller.

    An error of the first number is raised.
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


def best_of(
    tried: TriedNumbers[Log], decode: Callable[[HiddenFit[Log]], DecodedFit[Log]]
) -> tuple[HiddenFit[Log], DecodedFit[Log] | None, list[int]]:
    """The fit of least BIC whose likeliest path visits all modes, decoded if it has several.

    And the numbers of modes with lower BIC whose path does not visit all modes. An error of the
    last is raised.
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
    sentences = []
    if len(numbers) > 1:
        row = len(numbers) == numbers[-1] - numbers[0] + 1
        options = f"{numbers[0]} to {numbers[-1]}" if row else ", ".join(map(str, numbers))
        least = "BIC is least"
        if left_out:
            others = " and ".join(map(str, left_out))
            least = "BIC is least of those whose likeliest path visits every mode"
            table += f"; that of {others} leaves one out"
        sentences.append(f"{number_of(number, 'mode')} of {options}: {least}, {table}.")
        if number == max(bic) and number > 1 and refused is None:
            sentences.append("More might do better still: let the numbers go on.")
    elif number > 1 and bic.get(number - 1, np.inf) < bic[number]:
        fewer = number_of(number - 1, "mode")
        sentences.append(
            f"{fewer} explain{'s' if number == 2 else ''} the log better (BIC "
            f"{bic[number - 1]:.1f}, against {bic[number]:.1f} with {number}): two of the modes "
            "are alike, or the log does not tell them apart, and their matrices are fitted to "
            f"chance. Say modes={number - 1}."
        )
    if len(numbers) > 1 and refused is not None:
        sentences.append(f"Others were not tried: {refused}")
    return tuple(sentences)


def of_sureness(modes: HiddenModes, within: bool) -> tuple[str, ...]:
    """Sentences on the probabilities of modes and on assumptions."""
    longer = 100.0 * (modes.widening - 1.0)
    sentence = (
        "Modes were not logged; they are numbered as the likeliest path visits them. "
        f"{100.0 * modes.sure:.0f} % of rows have one that is at least 95 % sure; not knowing them "
        f"makes intervals up to {longer:.0f} % longer."
    )
    return (sentence,) if within else (sentence, "Modes are taken to change at samples only.")


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
