"""The delay margin while one mode lasts: true delays for which the law was not made.

The law keeps the table that it was given, made for its own model's delay; only the delay of the
plant changes. Where the loop of a constant mode is stable at the plant's nominal delay, it stays so
until, on the way to another delay, a root first lies on the limit of stability
(`deadtime.margins.crossing`).

Of several delays those of one input move, or all of them, every one by as many seconds. The delay
that is searched for is the shortest of those that move.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import index, positive
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.base.wording import error_percent, inwards
from deadtime.feedback import Law
from deadtime.margins.crossing import first_crossing, unit_bands
from deadtime.margins.loop_gain import Band, bands
from deadtime.plant import SwitchedSystem
from deadtime.spectrum import growth_rate
from deadtime.spectrum.digital_response import digital_response
from deadtime.spectrum.growth import not_decaying
from deadtime.spectrum.held_mode_checks import require_affordable, require_constant
from deadtime.spectrum.response import IdealResponse, LoopResponse, OneInput, Response

FARTHEST = 10.0  # times the nominal delay: as far as longer delays are tried


class _Limit(NamedTuple):
    """An end of the interval, seconds; the mode lost there and the frequency, if one is."""

    delay: float
    mode: int | None
    frequency: float | None


@dataclass(frozen=True, eq=False)
class DelayMargin(Frozen):
    """True delays that leave a loop stable (immutable).

    Attributes
    ----------
    lower, upper : float or None
        The open interval of true delays around the nominal one with every mode stable that may be
        held, seconds. 0: stable down to no delay. ∞: whatever the delay. None: a mode is unstable
        at the nominal delay. Of several delays that move together, the interval of the shortest.
    lower_mode, upper_mode : int or None
        The mode that is lost there; None where none is. Without an interval, the mode that grows
        fastest.
    lower_frequency, upper_frequency : float or None
        The frequency of the root that crosses there, rad/s.
    growth : (modes,)
        The growth rate in each mode at the nominal delay, 1/s.
    nominal : float
        The plant's delay, seconds; of several that move, the shortest.
    message : str
        The same in a sentence. It says where an `upper` without a mode is the end of the search.
    certified : bool
        Whether this is proved for all admissible switching; False for constant modes.
    input : int or None
        The input whose delay moves, in all modes; None where those of all inputs do.
    differ : bool
        Whether several delays move that differ: then `message` says `shorter` and `longer`.
    """

    lower: float | None
    upper: float | None
    lower_mode: int | None
    upper_mode: int | None
    lower_frequency: float | None
    upper_frequency: float | None
    growth: Float[np.ndarray, " mode"]
    nominal: float
    message: str
    certified: bool = False
    input: int | None = None
    differ: bool = False

    @property
    def shorter(self) -> float | None:
        """By how much less every delay that moves may be, seconds; None without a margin."""
        return None if self.lower is None else self.nominal - self.lower

    @property
    def longer(self) -> float | None:
        """By how much more every delay that moves may be, seconds; None without a margin."""
        return None if self.upper is None else self.upper - self.nominal

    @property
    def relative(self) -> float | None:
        """The smallest error of the delay, relative to it, that loses a mode; None without one.

        Where none does, as far as longer delays were tried. Of several delays that move, relative
        to the shortest.
        """
        if self.lower is None or self.upper is None:
            return None
        longer = self.upper / self.nominal - 1.0
        open_below = self.lower_mode is None and not self.certified
        return longer if open_below else min(1.0 - self.lower / self.nominal, longer)


def constant_delay_margin(
    plant: SwitchedSystem,
    law: Law,
    step: float | None = 0.01,
    upto: float | None = None,
    input: int | None = None,
    names: Sequence[str] | None = None,
    held: Sequence[int] | None = None,
) -> DelayMargin:
    """How wrong the delay may be under constant switching signals.

    Parameters
    ----------
    plant : SwitchedSystem
        The truth, at its nominal delay. The law has a model of its own, `law.plant`.
    law : Law
        A law that is a table, or an `OutputFeedback` of one; without a step, one that has a closed
        form in continuous time.
    step : float or None
        Sampling period h, in seconds; None for the ideal loop, updated continuously.
    upto : float, optional
        The longest true delay that is tried, in seconds, above the nominal one. By default ten
        times the nominal one; or ten times 1/ω, ω the highest frequency at which the loop's gain
        may be 1, where that is longer. Of several delays, that of the shortest that moves, by
        default ten times the longest.
    input : int, optional
        The input whose delay moves, in every mode by as many seconds, counted from 0; the other
        inputs keep theirs. By default those of all inputs move, by as many seconds.
    names : sequence of str, optional
        What inputs are called in `message`; by default they are counted.
    held : sequence of int, optional
        The modes that may be held; by default every one. Without any all delays up to `upto` are.

    Returns
    -------
    DelayMargin
        To about 1e-10 relative; to 1e-6 where the loop's gain only touches 1.

    Raises
    ------
    ArgumentError
        As by `growth_rate`; if there is no such input; if `upto` is no longer than the nominal
        delay, or the delay holds so many periods that the answer would take long.

    Notes
    -----
    A root that touches the limit of stability and goes back ends the interval, too: at that delay
    the loop is not asymptotically stable. With several modes the loop may be lost earlier, by
    switching: that needs a certificate.

    References
    ----------
    Mondié and Michiels, IEEE Trans. Automatic Control 48 (2003); Michiels and Niculescu, Stability,
    Control, and Computation for Time-Delay Systems, SIAM 2014, section 7.

    Examples
    --------
    >>> import deadtime as dt
    >>> A, B = [[[2, 1], [0, 1]]], [[[0], [1]]]
    >>> plant = dt.SwitchedSystem(A, B, delay=1.0)
    >>> law = dt.SingleModePredictor(plant, dt.place(plant, [-1, -2]), 0)
    >>> margin = constant_delay_margin(plant, law)
    >>> round(margin.lower, 5), round(margin.upper, 5)
    (0.98644, 1.01351)
    """
    require_constant(plant, law)
    if input is not None:
        input = index("input", input, plant.inputs)
    moving = moving_delays(plant, input)
    nominal = float(moving.min())
    differ = nominal != float(moving.max())
    step = None if step is None else positive("step", step)
    if upto is not None and positive("upto", upto) <= nominal:
        raise ArgumentError(
            f"upto must be longer than the nominal delay, {nominal:g} s, got {upto:g}: it is "
            "the longest true delay that is tried."
        )
    require_affordable("delay margin", plant, law, step)
    growth = np.array([growth_rate(plant, law, mode, step) for mode in range(plant.modes)])
    modes = range(plant.modes) if held is None else held
    worst = max(modes, key=lambda mode: growth[mode], default=None)
    if worst is not None and growth[worst] >= 0.0:
        text = _unstable(plant, worst, float(growth[worst]))
        return DelayMargin(
            None, None, worst, worst, None, None, growth, nominal, text, False, input, differ
        )
    lower, upper = _limits(plant, law, step, upto, input, modes)
    stable = _stable(lower, upper, nominal, of_input(input, names), differ)
    if len(modes) < plant.modes:
        only = f", of the modes that may be held ({', '.join(map(str, modes))})"
        stable = stable + only if modes else "no mode may be held"
    return DelayMargin(
        lower.delay,
        upper.delay,
        lower.mode,
        upper.mode,
        lower.frequency,
        upper.frequency,
        growth,
        nominal,
        stable,
        False,
        input,
        differ,
    )


def moving_delays(plant: SwitchedSystem, input: int | None) -> Float[np.ndarray, "mode moving"]:
    """The delays of an input, or of all."""
    return plant.delays if input is None else plant.delays[:, input : input + 1]


def _limits(
    plant: SwitchedSystem,
    law: Law,
    step: float | None,
    upto: float | None,
    input: int | None,
    modes: Sequence[int],
) -> tuple[_Limit, _Limit]:
    """The nearest limits of any of these modes, below and above."""
    moving = moving_delays(plant, input)
    nominal = float(moving.min())
    responses = [_response(plant, law, mode, step, input) for mode in modes]
    parts = [_bands(response, nominal) for response in responses]
    if upto is None:
        # In a delay shorter than one radian of every motion that matters, ten times is nothing.
        radians = [1.0 / part[-1].samples.omega[-1] for part in parts if part]
        upto = FARTHEST * float(max([moving.max(), *radians]))
    lower, upper = _Limit(0.0, None, None), _Limit(upto, None, None)
    for mode, response, part in zip(modes, responses, parts, strict=True):
        found = first_crossing(response, part, nominal, lower.delay)
        lower = lower if found is None else _Limit(found.delay, mode, found.frequency)
        found = first_crossing(response, part, nominal, upper.delay)
        upper = upper if found is None else _Limit(found.delay, mode, found.frequency)
    return lower, upper if any(parts) or not parts else upper._replace(delay=math.inf)


def _bands(response: Response, delay: float) -> list[Band]:
    """Where some delay may have a root; none if no delay has any."""
    found = bands(response, delay)
    # In the ideal loop the gain is what it is, whatever the delay.
    return unit_bands(response, found, delay) if response.period is None else found


def _response(
    plant: SwitchedSystem, law: Law, mode: int, step: float | None, input: int | None
) -> Response:
    """The loop in one mode, as a function of frequency and the shortest delay that moves."""
    if step is None:
        whole: LoopResponse = IdealResponse.of(plant, law, mode)
    else:
        whole = digital_response(plant, law, mode, step)
    if input is None or plant.inputs == 1:
        return whole
    own = plant.delays[:, input]
    return OneInput(whole, plant.shortest_delay, input, float(own[mode] - own.min()))


def _unstable(plant: SwitchedSystem, mode: int, growth: float) -> str:
    """Why there is no margin."""
    what = not_decaying(plant, growth)
    return f"there is no delay margin, since held in mode {mode} the loop {what}"


def _stable(lower: _Limit, upper: _Limit, nominal: float, of_one: str, differ: bool) -> str:
    """The interval in a sentence, rounded inwards."""
    text = "the loop stays stable in every constant mode"
    if differ:
        return f"{text} {_shifts(lower, upper, nominal, of_one)}"
    if math.isinf(upper.delay):
        return f"{text} whatever the true delay{of_one}"
    low, high = inwards(lower.delay, nominal), inwards(upper.delay, nominal)
    longer = error_percent(upper.delay, nominal)
    longer = "longer ones were not tried" if upper.mode is None else longer
    text = f"{text} while the true delay{of_one} is"
    if lower.mode is None:
        return f"{text} below {high} s ({longer})"
    shorter = error_percent(lower.delay, nominal)
    return f"{text} between {low} s and {high} s ({shorter}, {longer})"


def of_input(input: int | None, names: Sequence[str] | None = None) -> str:
    """Whose delay, in a sentence; nothing where it is that of all inputs.

    Examples
    --------
    >>> of_input(1), of_input(1, ["throttle", "brake"])
    (' of input 1', ' of input “brake”')
    """
    if input is None:
        return ""
    return f" of input {input}" if names is None else f" of input “{names[input]}”"


def _shifts(lower: _Limit, upper: _Limit, nominal: float, of_one: str) -> str:
    """The same for delays that differ, each as wrong as the others."""
    if lower.mode is None and math.isinf(upper.delay):
        return f"whatever the true delays{of_one}, all wrong by as much"
    shorter = f"up to {inwards(nominal - lower.delay, 0.0)} s shorter"
    longer = f"up to {inwards(upper.delay - nominal, 0.0)} s longer"
    if lower.mode is None:
        shorter = "shorter by any time"
    if upper.mode is None:
        longer = f"{longer} (more was not tried)"
    if math.isinf(upper.delay):
        longer = "longer by any time"
    return f"while the true delays{of_one} are all {shorter} or all {longer}, by as much each"
