"""The delay margin: how wrong the delay may be, for constant modes or for every signal.

For every admissible signal the true delays around the nominal one are covered by pieces, each
certified at once for all delays in it (`certify` with `delays`), since the loop's order changes
where the delay passes a multiple of the period. Of several delays a piece is a box: together the
boxes hold every common shift, but not one delay from one box with another from the next. What fails
is halved, down to a small part of the interval that constant modes allow, the most that any
certificate can reach.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import instance
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import error_percent, inwards
from deadtime.certificates import certify
from deadtime.feedback import Law
from deadtime.margins.constant_modes import (
    DelayMargin,
    constant_delay_margin,
    moving_delays,
    of_input,
)
from deadtime.plant import SwitchedSystem
from deadtime.plant.sampling import snap
from deadtime.switching import SignalClass
from deadtime.switching.constraint import PerMode
from deadtime.switching.signal_class import SignalOptions

FINEST = 0.04  # of the interval of constant modes
MOST_PIECES = 16  # certificates tried on each side
LEAST_DELAY = 1e-3  # of a period: the shortest delay that is asked about


def delay_margin(
    plant: SwitchedSystem,
    law: Law,
    step: float | None = 0.01,
    dwell_time: PerMode | SignalClass | None = None,
    upto: float | None = None,
    *,
    input: int | None = None,
    **signals: Unpack[SignalOptions],
) -> DelayMargin:
    """The true delays that a law tolerates: it keeps its table, the plant's delay differs.

    Parameters
    ----------
    plant : SwitchedSystem
        The truth at its nominal delay; the law has a model of its own.
    law : Law
        A law that is a table.
    step : float or None
        Sampling period h, in seconds; None for the ideal loop (constant modes only).
    dwell_time : float, one per mode, or SignalClass, optional
        Without it, the mode is constant: exact, from the spectrum. With it, proved for every
        switching signal with this dwell time and every constant delay between `lower` and
        `upper`, in seconds; of several that move, with all of them wrong by the same time. That
        each is wrong by another time is what `certify` with `delays` proves.
    upto : float, optional
        The longest true delay that is tried, in seconds. By default ten times the nominal one; or
        ten times 1/ω, ω the highest frequency at which the loop's gain may be 1, where that is
        longer. Of several delays, that of the shortest that moves, by default ten times the
        longest.
    input : int, optional
        The input whose delay moves, in every mode by as many seconds, counted from 0; the other
        inputs keep theirs. By default those of all inputs move, by as many seconds. Inputs that
        share one delay have a margin each, too.
    **signals
        With `dwell_time`: of the signals besides it, as `certify` takes them. A mode with a
        `maximum_dwell` is never held, so that its own margin limits nothing.

    Returns
    -------
    DelayMargin
        `lower` and `upper` in seconds, of the one delay or of the shortest that moves; `shorter`
        and `longer` say by how much every delay that moves may be wrong. None where there is no
        margin, and `message` says which mode grows, or what could not be certified.

    Raises
    ------
    ArgumentError
        As by `growth_rate` and `certify`; if there is no such input; if `signals` are given
        without `dwell_time`; if `upto` is no longer than the nominal delay, or the delay holds so
        many periods that the answer would take long.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[0.5]], [[0.6]]], [[[1.0]], [[1.0]]], delay=0.5)
    >>> law = dt.AveragedPredictor(plant, dt.place(plant, [-2.0]))
    >>> alone = delay_margin(plant, law, step=0.5)
    >>> certified = delay_margin(plant, law, step=0.5, dwell_time=0.6)
    >>> alone.lower <= certified.lower < 0.5 < certified.upper <= alone.upper
    True
    """
    if dwell_time is None:
        if signals:
            raise ArgumentError(
                f"dwell_time must be given with {' and '.join(signals)}: without it the mode is "
                "constant."
            )
        return constant_delay_margin(plant, law, step, upto, input)
    instance("plant", plant, SwitchedSystem)
    if step is None:
        raise ArgumentError(
            "step must be given with dwell_time: certificates are of the digital loop."
        )
    asked = SignalClass.of(dwell_time, **signals)
    lasting = asked.limits(plant.modes).lasting
    constant = constant_delay_margin(plant, law, step, upto, input, held=lasting)
    if constant.lower is None or constant.upper is None:
        return constant
    nominal = certify(plant, law, asked, step, decay_rate=0.0)
    if not nominal.stable:
        return replace(
            constant,
            lower=None,
            upper=None,
            message=f"There is no certified margin: {nominal.message}",
        )
    moving, nominal = moving_delays(plant, input), constant.nominal

    def holds(low: float, high: float) -> bool:
        ends: tuple[ArrayLike, ArrayLike] = low, high
        if input is not None or constant.differ:
            ends = _moved(plant, input, low - nominal), _moved(plant, input, high - nominal)
        options: dict[str, Any] = {"delays": ends, "decay_rate": 0.0, "search_signals": False}
        return certify(plant, law, asked, step, **options).stable is True

    offsets = np.unique(moving - nominal).tolist()
    known = bool(lasting)
    lower = _reach(nominal, constant.lower, step, offsets, holds, known)
    upper = _reach(nominal, constant.upper, step, offsets, holds, known)
    message = (
        f"Proved for every signal {_in_words(asked, plant.modes)}: stable for "
        f"{_range(lower, upper, constant)}. Without switches: {constant.message}"
    )
    return replace(constant, lower=lower, upper=upper, certified=True, message=message)


def _in_words(signals: SignalClass, modes: int) -> str:
    """Which signals, after "every signal"."""
    limits = signals.limits(modes)
    if signals.is_plain(modes):
        return f"with a dwell time of {limits.dwell_time[0]:g} s"
    stays, switches = signals.in_words(modes)
    return f"that {stays}" + (
        "" if limits.is_free and signals.at == "anywhere" else f", and {switches}"
    )


def _moved(plant: SwitchedSystem, input: int | None, shift: float) -> np.ndarray:
    """The plant's delays, those of an input or of all longer by a shift."""
    delays = np.array(plant.delays)
    delays[:, slice(None) if input is None else input] += shift
    return delays


def _range(lower: float, upper: float, constant: DelayMargin) -> str:
    """The true delays between two ends of the shortest that moves, in words."""
    nominal, of_one = constant.nominal, of_input(constant.input)
    if constant.differ:
        shorter, longer = inwards(nominal - lower, 0.0), inwards(upper - nominal, 0.0)
        return (
            f"all constant true delays{of_one} from {shorter} s shorter to {longer} s longer, "
            "all by as much"
        )
    return (
        f"every constant true delay{of_one} between {inwards(lower, nominal)} s and "
        f"{inwards(upper, nominal)} s "
        f"({error_percent(lower, nominal)}, {error_percent(upper, nominal)})"
    )


def _reach(
    nominal: float,
    limit: float,
    step: float,
    offsets: list[float],
    holds: Callable[..., bool],
    near: bool,
) -> float:
    """The delay up to which, from the nominal one towards a limit, all pieces hold, in seconds.

    A piece ends where the delay plus one of the offsets is a multiple of the period. Where the
    limit is that of a mode, it is `near`, and pieces begin long. Where no mode may be held the loop
    may be lost long before: they begin short, and double until one fails.
    """
    sign = 1.0 if limit > nominal else -1.0
    farthest = min(abs(limit - nominal), MOST_PIECES * step)
    end = max(nominal + sign * farthest, LEAST_DELAY * step)
    here, failed, length = nominal, False, 0.25 * (farthest if near else min(step, farthest))
    for _ in range(MOST_PIECES):
        finest = FINEST * (farthest if near else max(abs(here - nominal), length))
        multiples = [_next_multiple(here + offset, step, sign) - offset for offset in offsets]
        multiple = min(multiples, key=lambda delay: abs(delay - here))
        nearest = min(end, multiple, key=lambda delay: abs(delay - here))
        piece = min(length, abs(nearest - here))
        if piece <= max(0.5 * finest * near, 1e-9 * step):
            break
        there = nearest if piece < length else here + sign * piece
        if holds(min(here, there), max(here, there)):
            here = there
            length *= 1.0 if near or failed or piece < length else 2.0
        elif piece <= finest:
            break
        else:
            failed, length = True, 0.5 * piece
    return here


def _next_multiple(delay: float, step: float, sign: float) -> float:
    """The next multiple of the period in a direction."""
    ratio = snap(delay / step)
    return step * (math.floor(ratio) + 1 if sign > 0.0 else math.ceil(ratio) - 1)
