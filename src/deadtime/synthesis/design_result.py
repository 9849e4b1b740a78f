"""A design that `design` hands back: what it was to keep, what it does, and in sentences."""

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
_LEAST = 1e-9  # of a floor: less is not told apart


@dataclass(frozen=True)
class Floors:
    """The least that a design must have.

    margin : relative to the delay; 0 where none is asked for
    decay_rate : of the slowest constant mode, 1/s; 0 where none is asked for
    input_limit : (m,), what |u_j| must stay below; None where nothing is asked
    initial : the states at the start, or the noise, for which it must
    """

    margin: float
    decay_rate: float = 0.0
    input_limit: Float[np.ndarray, " m"] | None = None
    initial: InitialStates | StationaryNoise | None = None

    @property
    def asked(self) -> tuple[str, ...]:
        """The names of what is asked for."""
        parts = ((MARGIN, self.margin), (DECAY, self.decay_rate), (LIMIT, self.limited))
        return tuple(name for name, floor in parts if floor)

    @property
    def limited(self) -> bool:
        """Whether the inputs have a limit."""
        return self.input_limit is not None

    def load(self, peak: Float[np.ndarray, " m"] | None) -> float:
        """The largest peak beside its limit; 0 without limits.

        Examples
        --------
        >>> Floors(0.05, input_limit=np.array([10.0, 2.0])).load(np.array([5.0, 3.0]))
        1.5
        """
        if self.input_limit is None or peak is None:
            return 0.0
        return float((peak / self.input_limit).max())

    def shortfalls(self, margin: float, decay_rate: float, load: float = 0.0) -> tuple[str, ...]:
        """The names of the floors that a margin, a decay rate and a load fall short of.

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
        """By how much they fall short in all: the logarithms of floor over value, summed.

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
    """One design: what it tolerates and what it costs (immutable).

    Attributes
    ----------
    law : Law
        The law, with its gains and filter.
    step : float
        Its sampling period, seconds.
    margin : float
        The smallest error of the delay that loses a constant mode, relative to the delay, or to
        the shortest of several; 0 where one is unstable.
    cost : float
        ∫ xᵀQx + uᵀRu with one mode held, mean over |x₀| = 1, mean or worst over the modes; ∞
        where one is unstable.
    decay_rate : float
        How fast the slowest constant mode decays at the nominal delay, 1/s; negative where one
        grows.
    input_peak : (m,) or None
        What :math:`|u_j|` stays at or below in every constant mode, from the states at the start
        that were asked about (`input_peak`); ∞ where one is unstable.
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
    r"""Gains and a law that meet a request, or come nearest to it (immutable).

    Attributes
    ----------
    law : Law
        The law, which holds `gains` and the low-pass filter, if it has one.
    gains : (modes, m, n)
        :math:`K_i` of :math:`u = +K_i x`; with a filter, of :math:`v` in :math:`T \dot u = v - u`.
    time_constant : (m, m) or None
        T, seconds; None without a filter.
    step : float
        The sampling period it is made for, seconds.
    margin : DelayMargin
        The exact margin of constant modes, as by `delay_margin(plant, law, step)`.
    asked : float
        The margin asked for, relative to the delay, or to the shortest of several; 0 for none.
    decay_asked : float
        The decay rate asked for, 1/s; 0 where none was.
    reached : bool
        Whether the margin is at least that, and the spectrum at both ends says so, too; the decay
        rate at least what was asked, and the inputs at most.
    growth : (2, modes)
        The growth rates at the true delays :math:`D (1 - \text{asked})` and
        :math:`D (1 + \text{asked})`, 1/s.
    cost : float
        :math:`\int x^T Q x + u^T R u \, dt`, as in `TradeOff`.
    decay_rate : float
        How fast the slowest constant mode decays at the nominal delay, 1/s, as in `TradeOff`.
    plain : TradeOff
        The design to compare with: given gains, or LQR of the cost's weights, which are best for it
        when the mode never changes and the delay is right.
    limits : tuple of DelayLimit
        Per mode, what any linear controller could reach.
    points : tuple of TradeOff
        The best of what was tried, by growing margin: no other that decays as fast as asked
        tolerates more and costs less. The chosen one is always among them.
    evaluated : int
        How many designs were tried.
    message : str
        The same in sentences.
    weight : Weight or None
        Of the cost; None for the identity.
    input_peak : (m,)
        What :math:`|u_j|` stays at or below in every constant mode, for `initial`.
    input_limit : (m,) or None
        What it was asked to stay below.
    initial : InitialStates or StationaryNoise
        The states at the start, or the noise, for which it does.
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
        """Those of "margin", "decay rate", "input limit" that were asked and are not met."""
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
    """Whether the request is met, at what price, how fast, and what could be reached at all."""
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
        inputs = _inputs(floors, found, plain)
        text += [inputs] if inputs else []
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
    """Which of the requests it misses, and by how much."""
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
    """How fast it is: a low price may be that of a loop that hardly moves."""
    wanted = f" ({slowest:.3g} /s asked)" if slowest else ""
    text = f"In its slowest constant mode it decays at {found.decay_rate:.3g} /s{wanted}"
    if math.isinf(plain.cost) or found.law is plain.law:
        return f"{text}."
    return f"{text}, the plain design at {plain.decay_rate:.3g} /s."


def _inputs(floors: Floors, found: TradeOff, plain: TradeOff) -> str:
    """How far each input goes, beside what it must stay below."""
    limits, initial = floors.input_limit, floors.initial
    if limits is None or initial is None or found.input_peak is None or plain.input_peak is None:
        return ""
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
    return " ".join(parts)


def _limits(limits: Sequence[DelayLimit], asked: float) -> str:
    """The modes with the least room: of which the least is reached, or the least is possible."""
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
