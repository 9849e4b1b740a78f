"""The delay margin: the true delays that a loop tolerates, for constant modes or every signal.

The law keeps its table, made for its own model's delay; only the delay of the plant changes. If the
loop of a constant mode is stable at the plant's nominal delay, it stays stable until a root first
lies on the limit of stability (`deadtime.margins.crossing`).

For every admissible signal the true delays around the nominal one are covered by pieces. One
certificate holds for all delays in a piece (`certify` with `delays`), and a piece ends where the
delay passes a multiple of the period, since the loop's order changes there. Of several delays a
piece is a box: together the boxes hold every common shift, but not one delay from one box with
another from the next. A piece that fails is halved, down to a small part of the interval of
constant modes, the most that any certificate can reach.

Of several delays those of one input change, or all of them, by the same time. The search is over
the shortest delay that changes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Unpack

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import index, instance, positive
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.base.wording import error_percent, inwards
from deadtime.feedback import Law
from deadtime.margins.crossing import bands, first_crossing, unit_bands
from deadtime.plant import SwitchedSystem
from deadtime.plant.discretisation import snap
from deadtime.spectrum import growth_rate
from deadtime.spectrum.digital_response import digital_response
from deadtime.spectrum.growth import not_decaying
from deadtime.spectrum.held_mode_checks import require_affordable, require_constant
from deadtime.spectrum.response import IdealResponse, LoopResponse, OneInput, Response
from deadtime.switching import SignalClass
from deadtime.switching.constraint import PerMode
from deadtime.switching.signal_class import SignalOptions

FARTHEST = 10.0  # times the nominal delay: the longest delay that is tried
FINEST = 0.04  # of the interval of constant modes: the shortest piece
MOST_PIECES = 16  # certificates tried on each side
LEAST_DELAY = 1e-3  # of a period: the shortest delay that is certified


class _Limit(NamedTuple):
    """An end of the interval, seconds; the mode that is lost there and its frequency, or None."""

    delay: float
    mode: int | None
    frequency: float | None


@dataclass(frozen=True, eq=False)
class DelayMargin(Frozen):
    """True delays that leave a loop stable (immutable).

    Attributes
    ----------
    lower, upper : float or None
        The open interval of true delays around the nominal one in which every mode that may be
        held is stable, seconds. 0: stable down to no delay. ∞: stable for any delay. None: a mode
        is unstable at the nominal delay. Of several delays that change together, the interval of
        the shortest.
    lower_mode, upper_mode : int or None
        The mode that is lost there; None if none is. Without an interval, the mode that grows
        fastest.
    lower_frequency, upper_frequency : float or None
        The frequency of the root that crosses there, rad/s.
    growth : (modes,)
        The growth rate in each mode at the nominal delay, 1/s.
    nominal : float
        The plant's delay, seconds; of several that change, the shortest.
    message : str
        The same in a sentence. It says where an `upper` without a mode is the end of the search.
    certified : bool
        Whether this is proved for all admissible switching; False for constant modes.
    input : int or None
        The input whose delay changes, in all modes; None if the delays of all inputs change.
    differ : bool
        Whether the delays that change differ; then `message` states `shorter` and `longer`.
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
        """The largest common decrease of the delays that change, s; None without a margin."""
        return None if self.lower is None else self.nominal - self.lower

    @property
    def longer(self) -> float | None:
        """The largest common increase of the delays that change, s; None without a margin."""
        return None if self.upper is None else self.upper - self.nominal

    @property
    def relative(self) -> float | None:
        """The smallest relative error of the delay that loses a mode; None without a margin.

        If no error does, up to the longest delay that was tried. Of several delays that change,
        relative to the shortest.
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
    """`delay_margin` of constant modes, to 1e-10 relative; to 1e-6 where the gain only touches 1.

    `names` are the inputs' names in `message`, numbers by default. `held` are the modes that may be
    held, all by default; without any, all delays up to `upto` are tolerated.

    A root that touches the limit of stability and goes back ends the interval, too: at that delay
    the loop is not asymptotically stable.

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
        what = not_decaying(plant, float(growth[worst]))
        text = f"there is no delay margin, since {held_in(plant, worst)}the loop {what}"
        return DelayMargin(
            None, None, worst, worst, None, None, growth, nominal, text, False, input, differ
        )
    responses = [_response(plant, law, mode, step, input) for mode in modes]
    parts = [bands(response, nominal) for response in responses]
    if step is None:  # |λ| does not depend on the delay: fewer bands remain
        parts = [unit_bands(*each, nominal) for each in zip(responses, parts, strict=True)]
    if upto is None:
        # Ten times a delay that is short beside 1/ω of the loop would show no crossing at all.
        radians = [1.0 / part[-1].samples.omega[-1] for part in parts if part]
        upto = FARTHEST * float(max([moving.max(), *radians]))
    lower, upper = _Limit(0.0, None, None), _Limit(upto, None, None)
    for mode, response, part in zip(modes, responses, parts, strict=True):
        found = first_crossing(response, part, nominal, lower.delay)
        lower = lower if found is None else _Limit(found.delay, mode, found.frequency)
        found = first_crossing(response, part, nominal, upper.delay)
        upper = upper if found is None else _Limit(found.delay, mode, found.frequency)
    if parts and not any(parts):  # no delay puts a root on the limit of stability
        upper = upper._replace(delay=math.inf)
    message = _stable(lower, upper, nominal, of_input(input, names), differ, in_every(plant))
    if len(modes) < plant.modes:
        only = f", of the modes that may be held ({', '.join(map(str, modes))})"
        message = message + only if modes else "no mode may be held"
    return DelayMargin(
        lower=lower.delay,
        upper=upper.delay,
        lower_mode=lower.mode,
        upper_mode=upper.mode,
        lower_frequency=lower.frequency,
        upper_frequency=upper.frequency,
        growth=growth,
        nominal=nominal,
        message=message,
        input=input,
        differ=differ,
    )


def moving_delays(plant: SwitchedSystem, input: int | None) -> Float[np.ndarray, "mode moving"]:
    return plant.delays if input is None else plant.delays[:, input : input + 1]


def _response(
    plant: SwitchedSystem, law: Law, mode: int, step: float | None, input: int | None
) -> Response:
    """The loop in one mode, as a function of frequency and the shortest delay that changes."""
    if step is None:
        whole: LoopResponse = IdealResponse.of(plant, law, mode)
    else:
        whole = digital_response(plant, law, mode, step)
    if input is None or plant.inputs == 1:
        return whole
    own = plant.delays[:, input]
    return OneInput(whole, plant.shortest_delay, input, float(own[mode] - own.min()))


def _stable(
    lower: _Limit, upper: _Limit, nominal: float, of_one: str, differ: bool, every: str
) -> str:
    """The interval in a sentence, rounded inwards."""
    text = f"the loop stays stable{every}"
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


def in_every(plant: SwitchedSystem) -> str:
    """The modes of a margin, for sentences; empty for a plant of one mode."""
    return " in every constant mode" if plant.modes > 1 else ""


def held_in(plant: SwitchedSystem, mode: int) -> str:
    """The mode that is held, before "the loop" in sentences; empty for a plant of one mode."""
    return f"held in mode {mode} " if plant.modes > 1 else ""


def of_input(input: int | None, names: Sequence[str] | None = None) -> str:
    """The input whose delay is meant, for sentences; empty for all inputs.

    Examples
    --------
    >>> of_input(1), of_input(1, ["throttle", "brake"])
    (' of input 1', ' of input “brake”')
    """
    if input is None:
        return ""
    return f" of input {input}" if names is None else f" of input “{names[input]}”"


def _shifts(lower: _Limit, upper: _Limit, nominal: float, of_one: str) -> str:
    """The common change of delays that differ from each other, in words."""
    text = f"if the true delays{of_one} all change by the same time"
    if lower.mode is None and math.isinf(upper.delay):
        return f"{text}, however long"
    shorter = f"up to {inwards(nominal - lower.delay, 0.0)} s shorter"
    longer = f"up to {inwards(upper.delay - nominal, 0.0)} s longer"
    if lower.mode is None:
        shorter = "any time shorter"
    if upper.mode is None:
        longer = f"{longer} (more was not tried)"
    if math.isinf(upper.delay):
        longer = "any time longer"
    return f"{text}: {shorter} or {longer}"


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
    r"""The true delays that a law tolerates: its table stays, the plant's delay changes.

    Parameters
    ----------
    plant : SwitchedSystem
        The true plant at its nominal delay; the law has a model of its own.
    law : Law
        A law that is a table.
    step : float or None
        Sampling period h, in seconds; None for the ideal loop (constant modes only).
    dwell_time : float, one per mode, or SignalClass, optional
        Without it, the mode is constant: exact, from the spectrum. With it, proved for every
        switching signal with this dwell time and every constant delay between `lower` and
        `upper`, in seconds; several delays change by the same time. For delays that change by
        different times, use `certify` with `delays`.
    upto : float, optional
        The longest true delay that is tried, in seconds. By default ten times the nominal one or
        ten times :math:`1/\omega`, whichever is longer, with :math:`\omega` the highest frequency
        at which the loop's gain may be 1. Of several delays, a value of the shortest that changes,
        by default ten times the longest.
    input : int, optional
        The input whose delay changes, by the same time in every mode, counted from 0; the other
        inputs keep their delays. By default the delays of all inputs change by the same time.
    **signals
        With `dwell_time`: further properties of the signals, as `certify` takes them. A mode with
        a `maximum_dwell` is never held, so its own margin limits nothing.

    Returns
    -------
    DelayMargin
        `lower` and `upper` in seconds, of the one delay or of the shortest that changes; `shorter`
        and `longer` bound the common change. None without a margin; `message` then names the mode
        that grows, or the reason why nothing was certified.

    Raises
    ------
    ArgumentError
        As by `growth_rate` and `certify`; if there is no such input; if `signals` are given
        without `dwell_time`; if `upto` is no longer than the nominal delay, or the delay holds so
        many periods that the search would take long.

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
    from deadtime.certificates import certify

    instance("plant", plant, SwitchedSystem)
    if step is None:
        raise ArgumentError(
            "step must be given with dwell_time: certificates are of the digital loop."
        )
    admissible = SignalClass.of(dwell_time, **signals)
    lasting = admissible.limits(plant.modes).lasting
    constant = constant_delay_margin(plant, law, step, upto, input, held=lasting)
    if constant.lower is None or constant.upper is None:
        return constant
    at_nominal = certify(plant, law, admissible, step, decay_rate=0.0)
    if not at_nominal.stable:
        message = f"There is no certified margin: {at_nominal.message}"
        return replace(constant, lower=None, upper=None, message=message)
    moving, nominal = moving_delays(plant, input), constant.nominal

    def holds(low: float, high: float) -> bool:
        ends: tuple[ArrayLike, ArrayLike] = low, high
        if input is not None or constant.differ:
            ends = _moved(plant, input, low - nominal), _moved(plant, input, high - nominal)
        options: dict[str, Any] = {"delays": ends, "decay_rate": 0.0, "search_signals": False}
        return certify(plant, law, admissible, step, **options).stable is True

    offsets = np.unique(moving - nominal).tolist()
    known = bool(lasting)
    lower = _reach(nominal, constant.lower, step, offsets, holds, known)
    upper = _reach(nominal, constant.upper, step, offsets, holds, known)
    stays, switches = admissible.in_words(plant.modes)
    limits = admissible.limits(plant.modes)
    free = limits.is_free and admissible.at == "anywhere"
    words = f"that {stays}" + ("" if free else f", and {switches}")
    if admissible.is_plain(plant.modes):
        words = f"with a dwell time of {limits.dwell_time[0]:g} s"
    message = (
        f"Proved for every signal {words}: stable for {_range(lower, upper, constant)}. "
        f"Without switches: {constant.message}"
    )
    return replace(constant, lower=lower, upper=upper, certified=True, message=message)


def _moved(plant: SwitchedSystem, input: int | None, shift: float) -> np.ndarray:
    delays = np.array(plant.delays)
    delays[:, slice(None) if input is None else input] += shift
    return delays


def _range(lower: float, upper: float, constant: DelayMargin) -> str:
    nominal, of_one = constant.nominal, of_input(constant.input)
    if constant.differ:
        shorter, longer = inwards(nominal - lower, 0.0), inwards(upper - nominal, 0.0)
        return (
            f"every constant common change of the true delays{of_one} from {shorter} s shorter to "
            f"{longer} s longer"
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
    """The farthest delay from the nominal one towards a limit with all pieces certified, seconds.

        nominal  |--piece--|--piece--|-·-|        limit
                           a multiple of the period less an offset

    If the limit is that of a mode, it is `near`, and pieces begin long. If no mode may be held the
    loop may be lost long before it: pieces begin short, and double until one fails.
    """
    sign = 1.0 if limit > nominal else -1.0
    farthest = min(abs(limit - nominal), MOST_PIECES * step)
    end = max(nominal + sign * farthest, LEAST_DELAY * step)
    here, failed, length = nominal, False, 0.25 * (farthest if near else min(step, farthest))
    for _ in range(MOST_PIECES):
        finest = FINEST * (farthest if near else max(abs(here - nominal), length))
        ratios = [snap((here + offset) / step) for offset in offsets]
        whole = [math.floor(r) + 1 if sign > 0.0 else math.ceil(r) - 1 for r in ratios]
        multiples = [step * n - offset for n, offset in zip(whole, offsets, strict=True)]
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
