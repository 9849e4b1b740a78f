"""The result of `design`: the request, the design and the sentences about it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from deadtime.base.frozen import Frozen
from deadtime.base.wording import amount, input_names
from deadtime.feedback import Law
from deadtime.margins.delay import DelayMargin
from deadtime.plant import Weight
from deadtime.synthesis.input_sources import InitialStates, StationaryNoise
from deadtime.synthesis.limits import DelayLimit

MARGIN, DECAY, LIMIT = "margin", "decay rate", "input limit"
_LEAST = 1e-9  # of a floor: smaller values count as equal


@dataclass(frozen=True)
class Floors:
    """The requirements of a design.

    margin : relative to the delay; 0 for none
    decay_rate : of the slowest constant mode, 1/s; 0 for none
    input_limit : (m,), bounds of |u_j|; None for none
    initial : the initial states, or the noise, under which the limits hold
    """

    margin: float
    decay_rate: float = 0.0
    input_limit: Float[np.ndarray, " m"] | None = None
    initial: InitialStates | StationaryNoise | None = None

    @property
    def asked(self) -> tuple[str, ...]:
        """The names of the requirements."""
        limited = self.input_limit is not None
        parts = ((MARGIN, self.margin), (DECAY, self.decay_rate), (LIMIT, limited))
        return tuple(name for name, floor in parts if floor)

    def load(self, peak: Float[np.ndarray, " m"] | None) -> float:
        """The largest ratio of a peak to its limit; 0 without limits.

        Examples
        --------
        >>> Floors(0.05, input_limit=np.array([10.0, 2.0])).load(np.array([5.0, 3.0]))
        1.5
        """
        if self.input_limit is None or peak is None:
            return 0.0
        return float((peak / self.input_limit).max())

    def shortfalls(self, margin: float, decay_rate: float, load: float = 0.0) -> tuple[str, ...]:
        """The names of the requirements that are not met.

        Examples
        --------
        >>> Floors(0.05, 2.0).shortfalls(margin=0.06, decay_rate=1.5)
        ('decay rate',)
        """
        pairs = ((MARGIN, margin, self.margin), (DECAY, decay_rate, self.decay_rate))
        missed = tuple(name for name, value, floor in pairs if floor and value < floor)
        return (*missed, LIMIT) if load > 1.0 else missed

    def shortfall(
        self, margin: float, decay_rate: float, slack: float = 1.0, load: float = 0.0
    ) -> float:
        """The total shortfall: the sum of the logarithms of requirement over value.

        Examples
        --------
        >>> round(Floors(0.05, 2.0).shortfall(margin=0.06, decay_rate=1.0), 4)   # log 2
        0.6931
        """
        pairs = ((margin, slack * self.margin), (decay_rate, slack * self.decay_rate))
        parts = [value / floor for value, floor in pairs if floor]
        parts += [1.0 / (slack * load)] if load else []
        return -sum(math.log(min(max(part, _LEAST), 1.0)) for part in parts)


@dataclass(frozen=True, eq=False)
class TradeOff:
    """The margin, cost, decay rate and inputs of one design (immutable).

    Attributes
    ----------
    law : Law
        The law, with its gains and filter.
    step : float
        Its sampling period, seconds.
    margin : float
        The smallest error of the delay that destabilises a constant mode, relative to the delay, or
        to the shortest of several; 0 if a mode is unstable.
    cost : float
        ∫ xᵀQx + uᵀRu with one mode held, mean over |x₀| = 1 and the modes; ∞ if a mode is
        unstable.
    decay_rate : float
        The decay rate of the slowest constant mode at the nominal delay, 1/s; negative if one
        grows.
    input_peak : (m,) or None
        The largest :math:`|u_j|` in every constant mode, from the requested initial states
        (`input_peak`); ∞ if a mode is unstable.
    """

    law: Law
    step: float
    margin: float
    cost: float
    decay_rate: float = 0.0
    input_peak: Float[np.ndarray, " m"] | None = None

    @property
    def time_constant(self) -> Float[np.ndarray, "m m"] | None:
        """T of the low-pass filter, seconds; None without one."""
        return getattr(self.law, "time_constant", None)


@dataclass(frozen=True, eq=False)
class Design(Frozen):
    r"""Gains and a law that meet a request, or are the nearest found (immutable).

    Attributes
    ----------
    law : Law
        The law, with `gains` and the low-pass filter, if it has one.
    gains : (modes, m, n)
        :math:`K_i` of :math:`u = +K_i x`; with a filter, of :math:`v` in :math:`T \dot u = v - u`.
    time_constant : (m, m) or None
        T, seconds; None without a filter.
    step : float
        The sampling period of the design, seconds.
    margin : DelayMargin
        The exact margin of constant modes, as by `delay_margin(plant, law, step)`.
    asked : float
        The requested margin, relative to the delay, or to the shortest of several; 0 for none.
    decay_asked : float
        The requested decay rate, 1/s; 0 for none.
    reached : bool
        Whether the margin, confirmed by the spectrum at both ends, the decay rate and the inputs
        meet the request.
    growth : (2, modes)
        The growth rates at the true delays :math:`D (1 - \text{asked})` and
        :math:`D (1 + \text{asked})`, 1/s.
    cost : float
        :math:`\int x^T Q x + u^T R u \, dt`, as in `TradeOff`.
    decay_rate : float
        The decay rate of the slowest constant mode at the nominal delay, 1/s, as in `TradeOff`.
    plain : TradeOff
        The design for comparison: the given gains, or LQR with the cost's weights, which is optimal
        for a constant mode and the nominal delay.
    limits : tuple of DelayLimit
        Per mode, the limits of any linear controller.
    points : tuple of TradeOff
        The best designs tried, by growing margin: no other with the requested decay rate has a
        larger margin and a lower cost. They include the chosen one.
    evaluated : int
        The number of designs tried.
    message : str
        The same in sentences.
    weight : Weight or None
        Of the cost; None for the identity.
    input_peak : (m,)
        The largest :math:`|u_j|` in every constant mode, for `initial`.
    input_limit : (m,) or None
        The requested bound of :math:`|u_j|`.
    initial : InitialStates or StationaryNoise
        The initial states, or the noise, of `input_peak`.
    """

    law: Law
    gains: Float[np.ndarray, "mode m n"]
    time_constant: Float[np.ndarray, "m m"] | None
    step: float
    margin: DelayMargin
    asked: float
    decay_asked: float
    reached: bool
    growth: Float[np.ndarray, "end mode"]
    cost: float
    decay_rate: float
    plain: TradeOff
    limits: tuple[DelayLimit, ...]
    points: tuple[TradeOff, ...]
    evaluated: int
    message: str
    weight: Weight | None = None
    input_peak: Float[np.ndarray, " m"] | None = None
    input_limit: Float[np.ndarray, " m"] | None = None
    initial: InitialStates | StationaryNoise = field(default_factory=InitialStates.ball)

    def missed(self, point: TradeOff) -> tuple[str, ...]:
        """The requested of "margin", "decay rate", "input limit" that a design does not meet."""
        floors = Floors(self.asked, self.decay_asked, self.input_limit)
        return floors.shortfalls(point.margin, point.decay_rate, floors.load(point.input_peak))

    def __repr__(self) -> str:
        return f"Design({self.message})"


def percent(part: float, up: bool = False) -> str:
    """A relative margin, rounded down; a bound from above, rounded up.

    Examples
    --------
    >>> percent(0.05121, up=True), percent(0.05), percent(0.05, up=True)
    ('5.13 %', '5.00 %', '5.00 %')
    >>> percent(0.05126), percent(1.234), percent(float("inf")), percent(1.419e-16)
    ('5.12 %', '123 %', 'more than 100 %', '1.41e-14 %')
    """
    if math.isinf(part):
        return "more than 100 %"
    if part <= 0.0:
        return "none"
    whole = math.ceil if up else math.floor
    if part < 1e-6:
        exponent = math.floor(math.log10(part)) + 2
        return f"{whole(part / 10.0 ** (exponent - 4)) / 100.0:.2f}e{exponent} %"
    places = max(0, 2 - math.floor(math.log10(100.0 * part)))
    slack = -1e-9 if up else 1e-9
    return f"{whole(100.0 * part * 10.0**places + slack) / 10.0**places:.{places}f} %"


def sentences(
    floors: Floors,
    reached: bool,
    found: TradeOff | None,
    plain: TradeOff,
    limits: Sequence[DelayLimit],
    evaluated: int,
) -> str:
    """Result, cost, decay rate, inputs and the limits of any linear controller, in words."""
    if found is None:
        text = [
            f"Not reached: none of {evaluated} designs that were tried is stable in every "
            "constant mode."
        ]
    else:
        text = [
            _answer(floors, reached, found, evaluated),
            _price(found, plain),
            _decay(found, plain, floors.decay_rate),
        ]
        text += _inputs(floors, found, plain)
    return " ".join([*text, _limits(limits, floors.margin)])


def _answer(floors: Floors, reached: bool, found: TradeOff, evaluated: int) -> str:
    filtered = "" if found.time_constant is None else ", with a low-pass filter"
    asked = f" ({percent(floors.margin)} asked)" if floors.margin else ""
    where = f"{asked}{filtered}, at a step of {found.step:g} s."
    if reached:
        return f"Every constant mode stays stable {_while(found)}{where}"
    return (
        f"Not reached: of {evaluated} designs that were tried, the one that comes nearest has a "
        f"delay margin of {percent(found.margin)}{where} {_shortfall(floors, found)}"
    )


def _shortfall(floors: Floors, found: TradeOff) -> str:
    load = floors.load(found.input_peak)
    missed = floors.shortfalls(found.margin, found.decay_rate, load)
    if not missed:
        return "Spectra at both ends of that margin do not confirm it."
    by = {
        MARGIN: f"{percent(floors.margin - found.margin, up=True)} of the delay",
        DECAY: f"{floors.decay_rate - found.decay_rate:.3g} /s",
        LIMIT: percent(load - 1.0, up=True),
    }
    text = "It misses " + " and ".join(f"the {name} asked for by {by[name]}" for name in missed)
    kept = [name for name in floors.asked if name not in missed]
    return f"{text}, not the {' and the '.join(kept)}." if kept else f"{text}."


def _while(found: TradeOff) -> str:
    one = found.law.plant.has_one_delay
    if math.isinf(found.margin):
        return "whatever the true delay" if one else "however late all inputs are together"
    if one:
        return f"while the true delay errs by less than {percent(found.margin)}"
    less = f"less than {percent(found.margin)} of the shortest"
    return f"while all true delays err alike, by {less}"


def _price(found: TradeOff, plain: TradeOff) -> str:
    if math.isinf(plain.cost):
        return f"It costs {amount(found.cost)}; the plain design is unstable in a constant mode."
    if found.law is plain.law:
        return f"It is the plain design, at a cost of {amount(found.cost)}."
    return (
        f"It costs {amount(found.cost / plain.cost)} times as much as the plain design, whose "
        f"margin is {percent(plain.margin)}."
    )


def _decay(found: TradeOff, plain: TradeOff, slowest: float) -> str:
    """The decay rate, since a low cost may be that of a slow loop."""
    wanted = f" ({slowest:.3g} /s asked)" if slowest else ""
    text = f"In its slowest constant mode it decays at {found.decay_rate:.3g} /s{wanted}"
    if math.isinf(plain.cost) or found.law is plain.law:
        return f"{text}."
    return f"{text}, the plain design at {plain.decay_rate:.3g} /s."


def _inputs(floors: Floors, found: TradeOff, plain: TradeOff) -> list[str]:
    """The peak of each input and its limit."""
    limits, initial = floors.input_limit, floors.initial
    if limits is None or initial is None or found.input_peak is None or plain.input_peak is None:
        return []
    reach, parts = "may reach" if initial.kind == "normal" else "reaches", []
    own_and_other = zip(found.input_peak, plain.input_peak, strict=True)
    for name, limit, (peak, other) in zip(
        input_names(len(limits)), limits, own_and_other, strict=True
    ):
        fails = "is not known to stay" if initial.kind == "normal" else "does not stay"
        keeps = "stays below" if peak <= limit else f"{fails} below"
        own = f"it {reach} {amount(peak)}"
        if found.law is not plain.law:
            other = "grows without bound" if math.isinf(other) else f"{reach} {amount(other)}"
            own += f", the plain design's {other}"
        parts.append(f"|{name}| {keeps} {limit:g} for {initial.text}: {own}.")
    return parts


def _limits(limits: Sequence[DelayLimit], asked: float) -> str:
    """The limits of the modes with the least margin reached, and the least possible."""
    modes = range(len(limits))
    least = min(modes, key=lambda i: (limits[i].reached, limits[i].most))
    bound = min(modes, key=lambda i: (limits[i].most, i != least))
    reached, most = limits[least].reached, limits[bound].most
    if math.isinf(reached):
        return "Nothing in the plant limits the margin below 100 %."
    name, other = (f"mode {i}" if len(limits) > 1 else "the mode" for i in (least, bound))
    if reached == 0.0:
        text = f"Small gain promises no linear controller of {name} alone any margin"
    else:
        text = f"Some linear controller of {name} alone reaches {percent(reached)}"
    if math.isfinite(most):
        whose = "" if bound == least else f" of {other} alone"
        text += f", none{whose} more than {percent(most, up=True)}"
    return f"{text}: the margin asked for does not exist." if asked > most else f"{text}."
