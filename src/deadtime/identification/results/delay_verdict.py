"""The verdict: whether a law stands every delay, and every plant drawn, that a log allows."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from deadtime.margins import delay_margin, drawn_stability
from deadtime.margins.drawn_plants import has_rates
from deadtime.plant import SwitchedSystem
from deadtime.spectrum import growth_rate

if TYPE_CHECKING:
    from deadtime.feedback import Law
    from deadtime.identification.identified_plant import Findings

_NO_SWITCHES = "; errors that differ while modes switch are for certify(…, delays=…)"
MOST_INPUTS = 4  # of a box whose corners are all looked at


@runtime_checkable
class Margin(Protocol):
    """What a law tolerates: a `margins.DelayMargin`."""

    @property
    def lower(self) -> float | None: ...
    @property
    def upper(self) -> float | None: ...
    @property
    def nominal(self) -> float: ...
    @property
    def input(self) -> int | None: ...
    @property
    def certified(self) -> bool: ...


def verdict_of(fit: Findings, margin: Margin, law: Law | None, step: float) -> str:
    """What `Identification.verdict` says, of a law that acts every `step` seconds."""
    if fit.doubts:
        return delays_beside(fit.delays, fit.delay_interval, margin, doubt=fit.doubts[0])
    failure = None
    several = "delay" not in fit.names and fit.plant.inputs <= MOST_INPUTS
    if law is not None and several and margin.lower is not None:
        failure = failure_of(fit.plant, fit.delay_interval, law, step)
    said = delays_beside(fit.delays, fit.delay_interval, margin, failure)
    if law is None or margin.lower is None or not has_rates(law):
        return said
    drawn = drawn_stability(fit.uncertain, law, step)
    if drawn.all_stable:
        return f"{said} {drawn.sentence}"
    return f"{said} {drawn.sentence} Not enough: log for longer, or design a law that bears more."


def delays_beside(
    delays: np.ndarray,
    interval: np.ndarray,
    margin: Margin,
    failure: str | None = None,
    doubt: str = "",
) -> str:
    """The intervals beside a margin: how far every delay may be off beside how far it is borne.

    A margin is of delays that all err alike. Of several, `failure` says what fails where each errs
    by itself, "" if nothing does; None where that was not looked at. `doubt` says why intervals may
    not hold the delays: beside such nothing is enough.
    """
    j = margin.input
    column = slice(None) if j is None else slice(j, j + 1)
    D, ends = delays[:, column], interval[:, column]
    if (D[0] == D).all() and (ends[0] == ends).all():
        D, ends = D[:1], ends[:1]
    one = D.size == 1
    if one:
        low, high = ends[0, 0]
        said = f"Delay {D[0, 0]:.4g} s ({low:.4g} … {high:.4g})"
    else:
        off = ends - D[..., None]
        said = f"Delays are off by {off.min():+.2g} … {off.max():+.2g} s at 95 %"
    if margin.lower is None or margin.upper is None:
        return f"{said}; the law bears no delay at all, not even the likeliest: design another."
    shift = margin.lower - margin.nominal, margin.upper - margin.nominal
    left, right = float((ends[..., 0] - D).min()), float((ends[..., 1] - D).max())
    enough = shift[0] <= left and right <= shift[1] and not doubt
    why = f"not enough, for {doubt}" if doubt else _end(enough, interval.shape[1] > 1)
    if one:
        return f"{said}; the law bears {margin.lower:.4g} … {margin.upper:.4g} s: {why}."
    together = "" if j is not None else ", of all together"
    said = f"{said}; the law bears {shift[0]:+.2g} … {shift[1]:+.2g} s{together}"
    if failure is None or not enough:
        alike = (
            "enough if all err alike; nothing is said of errors that differ: verdict(margin, law) "
            "looks at them"
        )
        return f"{said}: {alike if enough else why}."
    if failure:
        return f"{said}, but errors differ: {failure}: {_end(False)}."
    return (
        f"{said}, in each mode held the error of every input's delay alone, and every corner of "
        f"the box of intervals: {_end(True)}{_NO_SWITCHES if margin.certified else ''}."
    )


def _end(enough: bool, others: bool = False) -> str:
    if not enough:
        return "not enough, so design a law with a wider margin or log for longer"
    return "enough, if the other delays are what they are taken for" if others else "enough"


def failure_of(
    plant: SwitchedSystem, interval: Float[np.ndarray, "mode m 2"], law: Law, step: float
) -> str:
    """What a law does not stand, in words; "" if nothing: of each input alone, and of corners.

    In a mode that is held its own delays alone act, so that corners are taken in all modes at once.
    """
    for j in range(plant.inputs):
        margin = delay_margin(plant, law, step, input=j)
        if margin.lower is None or margin.upper is None:
            return "a mode grows at the likeliest delays"
        off = interval[:, j] - plant.delays[:, j, None]
        short, long = margin.lower - margin.nominal, margin.upper - margin.nominal
        if off[:, 0].min() < short or off[:, 1].max() > long:
            return f"that of input {j} alone is borne from {short:+.2g} to {long:+.2g} s"
    for corner in itertools.product((0, 1), repeat=plant.inputs):
        delays = interval[:, np.arange(plant.inputs), corner]
        truth = SwitchedSystem(plant.A, plant.B, delays)
        for mode in range(plant.modes):
            if growth_rate(truth, law, mode, step) >= 0.0:
                at = ", ".join(f"{D:.4g}" for D in delays[mode])
                return f"with true delays of {at} s mode {mode} does not decay"
    return ""
