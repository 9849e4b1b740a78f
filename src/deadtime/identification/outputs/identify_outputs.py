"""`identify` from outputs alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from deadtime.base.checks import brief
from deadtime.base.errors import ArgumentError
from deadtime.identification.estimate import Estimate, IdentifiedLog
from deadtime.identification.levels import near_zero
from deadtime.identification.likelihoods.likelihood import maximise
from deadtime.identification.log.logged_states import fit_switching
from deadtime.identification.log.recording import Recording
from deadtime.identification.noisy.noise import estimated_of, start_beside
from deadtime.identification.outputs.chosen import (
    Chosen,
    OutputsRequest,
    chosen_of,
    hardly_tells,
    order_too_high,
    worthier,
    zeros_in_doubt,
)
from deadtime.identification.outputs.other_delays import with_others
from deadtime.identification.parameters import Layout, Window
from deadtime.identification.sampling import nodes_for

_MOST = 12  # states in all


def identify_outputs(
    recording: Recording,
    order: int | Sequence[int],
    zeros: bool | None,
    per_mode: bool,
    bounds: Window,
    within: bool,
    progress: Callable[[str], None],
) -> IdentifiedLog:
    """The likeliest plant with so many states of each output."""
    given = order_of(order, recording.outputs)
    _require_moving(recording)
    constant = recording.level is not None
    layout = Layout(len(recording.modes), sum(given), len(recording.inputs), per_mode, constant)
    request = OutputsRequest(recording, layout, given, zeros, bounds, within, progress)
    found, chosen = estimate_from_outputs(request)
    shape = chosen.shape
    names = state_names(recording.outputs, given, shape.zeros or shape.jumps)
    high = order_too_high(request, chosen) if hardly_tells(found, shape) else []
    found, others = with_others(found)
    unsure = [] if high or others else zeros_in_doubt(chosen, recording.inputs)
    said = high or others or unsure
    doubts = ("a smaller order explains the log better",) if high else ()
    doubts += ("the log hardly tells on which states inputs act",) if unsure else ()
    given = found, found.log.recording, *fit_switching(recording), shape.C, names
    return IdentifiedLog(*given, tuple(said), doubts)


def _require_moving(recording: Recording) -> None:
    """Refuse outputs that never move."""
    every = np.vstack([part.output for part in recording.parts])
    for name, column in zip(recording.outputs, every.T, strict=True):
        known = column[np.isfinite(column)]
        if not known.size or np.ptp(known) == 0.0:
            raise ArgumentError(
                f"{name} must move, got {known[0] if known.size else 'nothing'} throughout: leave "
                "it out by outputs=[…]."
            )


def _about_its_rest(request: OutputsRequest) -> tuple[Chosen, OutputsRequest]:
    """The likeliest plant that rests at 0, or elsewhere if that is likelier than chance makes it.

    Each is sought by itself: a maximum of the one may lead to a lower one of the other.
    """
    if request.layout.constant and not near_zero(request.recording):
        return chosen_of(request), request
    layout = replace(request.layout, constant=False)
    plain = request._replace(recording=request.recording.absolute(), layout=layout)
    chosen = chosen_of(plain)
    if not request.layout.constant:
        return chosen, plain
    other = chosen_of(request)
    level = (other.log.free.size - sum(other.added)) - (chosen.log.free.size - sum(chosen.added))
    other = other._replace(added=(*other.added, level))
    return (other, request) if worthier(chosen, other) is other else (chosen, plain)


def estimate_from_outputs(request: OutputsRequest) -> tuple[Estimate, Chosen]:
    """The likeliest plant with the states that were asked for, and how it was chosen."""
    chosen, request = _about_its_rest(request)
    recording = request.recording
    best, scan = chosen.best, chosen.scan
    nodes = nodes_for(recording.parts, request.layout.split(best.theta[: request.layout.size])[0])
    log = replace(chosen.log, recording=recording, nodes=nodes)
    request.progress("looking how well the log tells it")
    top, window = maximise(log, best.theta)
    curves = scan.curves * (recording.samples / chosen.log.recording.samples)
    start = start_beside(log, top, scan.first, curves)
    try:
        return estimated_of(log, top, window, start), chosen
    except ArgumentError as error:
        raise ArgumentError(" ".join((str(error), *order_too_high(request, chosen)))) from None


def order_of(order: Any, outputs: tuple[str, ...]) -> tuple[int, ...]:
    """How many states each output has; one number is that of every output.

    Examples
    --------
    >>> order_of(2, ("position", "angle")), order_of((2, 1), ("position", "heat"))
    ((2, 2), (2, 1))
    """
    several = isinstance(order, Iterable) and not isinstance(order, str)
    given: list[Any] = list(order) if several else [order] * len(outputs)
    whole = [isinstance(one, int | np.integer) and not isinstance(one, bool) for one in given]
    if not given or not all(whole) or min(given) < 1 or sum(given) > _MOST:
        raise ArgumentError(
            "order must be how many states each output has, such as 2 for a position, or (2, 1), "
            f"at least 1 each and {_MOST} in all, got {brief(order)}."
        )
    if len(given) != len(outputs):
        raise ArgumentError(
            f"order must have a number for each output, {len(outputs)} ({', '.join(outputs)}), "
            f"got {len(given)}: {brief(order)}."
        )
    return tuple(int(one) for one in given)


def is_states(order: Any, outputs: tuple[str, ...]) -> bool:
    """Whether outputs are the states: one of each."""
    return set(order_of(order, outputs)) == {1}


def require_logged(C: Any, noise: bool | None, hidden: bool) -> None:
    """Refuse what outputs alone are not identified with."""
    if C is not None:
        raise ArgumentError(
            "C must be left out beside order: the states are chosen so that outputs are the first "
            "of each chain."
        )
    if noise is False:
        raise ArgumentError(
            "noise must not be False with order: from outputs alone noise of the sensors is always "
            "estimated. Leave it out."
        )
    if hidden:
        raise ArgumentError(
            "modes must be logged where order is given, got a number of hidden ones: they are told "
            "from all states alone. Log the mode, or all states; of one mode say modes=None, "
            "--one-mode."
        )


def state_names(
    outputs: tuple[str, ...], order: tuple[int, ...], numbered: bool
) -> tuple[str, ...]:
    """What states are called: outputs and primes for their derivatives, or numbers.

    Examples
    --------
    >>> state_names(("position", "heat"), (3, 1), False)
    ('position', "position'", "position''", 'heat')
    >>> state_names(("position",), (2,), True)
    ('position', 'position (2)')
    """
    names = []
    for name, count in zip(outputs, order, strict=True):
        more = [
            f"{name} ({k + 1})" if numbered else f"{name}{chr(39) * k}" for k in range(1, count)
        ]
        names += [name, *more]
    return tuple(names)
