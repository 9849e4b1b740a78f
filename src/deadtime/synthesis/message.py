"""A design for margin in sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

from deadtime.base.wording import amount, input_names
from deadtime.synthesis.floors import DECAY, LIMIT, MARGIN, Floors
from deadtime.synthesis.limits import DelayLimit
from deadtime.synthesis.result import TradeOff


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
