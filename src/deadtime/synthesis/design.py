"""Design for margin: the cheapest gains, filter and period with a requested delay margin.

The message points to units that may be mixed: a delay in milliseconds beside matrices in 1/s, or
gains per degree beside states in radians, give a valid design for another plant. Ratios that no
plant is likely to have show it.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from functools import partial

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import count, instance, number, positive, reporter
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import amount
from deadtime.feedback import Law
from deadtime.feedback.law import require_match
from deadtime.gains import lqr
from deadtime.gains.pole_placement import unseen_pole
from deadtime.gains.state_feedback import check_gains, require_controllable
from deadtime.laws import AveragedPredictor
from deadtime.margins.delay import DelayMargin, constant_delay_margin
from deadtime.plant import SwitchedSystem
from deadtime.plant.weight import Weight, weight_matrix, weight_of
from deadtime.spectrum import growth_rate
from deadtime.spectrum.held_mode_checks import require_affordable
from deadtime.synthesis.design_measures import WIDEST, assess
from deadtime.synthesis.design_result import Design, Floors, TradeOff, sentences
from deadtime.synthesis.design_search import DesignSearch, Exact, MakeLaw, Tried, pairs_of, spend
from deadtime.synthesis.gain_families import Choice, ChoiceFamily
from deadtime.synthesis.input_peak import Source, check_initial, largest_inputs, limits_asked
from deadtime.synthesis.input_sources import InitialStates, StationaryNoise
from deadtime.synthesis.limits import DelayLimit, delay_limit


def check_request(
    plant: SwitchedSystem,
    delay_margin: float | None,
    step: float,
    filtered: bool | None,
    longest_step: float | None,
) -> float:
    """The requested margin, 0 without one, after a check of the arguments."""
    instance("plant", plant, SwitchedSystem)
    asked = 0.0 if delay_margin is None else number("delay_margin", delay_margin)
    if delay_margin is not None and not 0.0 < asked < 1.0:
        raise ArgumentError(
            f"delay_margin must be above 0 and below 1, relative to the delay, got {asked:g}: "
            "0.05 asks for ±5 %; leave it out to ask for none."
        )
    step = positive("step", step)
    if longest_step is not None and positive("longest_step", longest_step) < step:
        raise ArgumentError(
            f"longest_step must be at least the step, {step:g} s, got {longest_step:g}: leave it "
            "out to keep the step."
        )
    if not (filtered is None or isinstance(filtered, (bool, np.bool_))):
        raise ArgumentError(f"filtered must be True, False or None for both, got {filtered!r}.")
    return asked


def decay_asked(decay_rate: float) -> float:
    asked = number("decay_rate", decay_rate)
    if asked < 0.0:
        raise ArgumentError(
            f"decay_rate must be at least 0, in 1/s, got {asked:g}: it says how fast every "
            "constant mode must decay."
        )
    return asked


def require_identified(plant: SwitchedSystem, weight: Weight) -> None:
    """Refuse a weight under which a loop that grows may cost little."""
    weight_matrix("weight.R", weight.R, plant.inputs, "m", strict=True)
    for i, A in enumerate(plant.A):
        if (pole := unseen_pole(A, weight.Q)) is not None:
            raise ArgumentError(
                f"weight.Q must weigh what does not decay, but of mode {i} it does not see the "
                f"eigenvalue {pole:.4g} 1/s: give the other states a weight, too."
            )


def require_table(plant: SwitchedSystem, make: MakeLaw, gains: np.ndarray) -> Law:
    """The plain design's law, after a check that laws of the family can be run."""
    if not callable(make):
        raise ArgumentError(f"law must be a function (plant, gains) -> law, got {make!r}.")
    try:
        takes = inspect.signature(make)
    except (TypeError, ValueError):
        takes = None  # a compiled function may have no signature
    if takes is not None:
        try:
            takes.bind(None, None)
        except TypeError:
            raise ArgumentError(
                "law must be a function (plant, gains) -> law that takes these two by position, "
                f"got one that takes {takes}."
            ) from None
    law = make(plant, gains)
    kind = type(law).__name__
    if not law.is_linear or law.observer is not None:
        raise ArgumentError(
            f"law must make laws that are tables, got {kind}: a delay margin is that of a linear "
            "loop."
        )
    if law.needs_preview:
        raise ArgumentError(
            f"law must make laws that can run, but {kind} needs a preview of the signal: for a "
            "mode's own exact law give a plant of that mode alone."
        )
    require_match(plant, law)
    return law


_GROWTH = 10.0  # p D of an unstable pole: growth by 22,000 within the delay
_SCALES = 1e6  # ratio of the units in which a mode is balanced


def unit_hints(
    plant: SwitchedSystem, gains: Float[np.ndarray, "mode m n"], step: float
) -> tuple[str, ...]:
    """Sentences about ratios that suggest mixed units; none for most plants.

    Parameters
    ----------
    plant : SwitchedSystem
    gains : (modes, m, n)
        Gains of the plain design.
    step : float
        Sampling period h, s.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], delay=250.0)     # meant: 250 ms
    >>> for hint in unit_hints(plant, dt.place(plant, [-1.0]), 0.01):
    ...     print(hint)
    An unstable pole at 1 /s grows 3.7 × 10¹⁰⁸ times within the delay of 250 s, which no gains \
make up for: is the delay in seconds?
    """
    found = [_growth(plant), _step(plant, gains, step), _scales(plant)]
    return tuple(hint for hint in found if hint)


def _growth(plant: SwitchedSystem) -> str:
    pole = float(np.linalg.eigvals(plant.A).real.max())
    delay = plant.longest_delay
    if pole * delay <= _GROWTH:
        return ""
    within = "beyond all numbers"
    if pole * delay < 700.0:  # e^709 is the largest float
        within = f"{amount(math.exp(pole * delay))} times"
    return (
        f"An unstable pole at {pole:.3g} /s grows {within} within the delay of {delay:g} s, which "
        "no gains make up for: is the delay in seconds?"
    )


def _step(plant: SwitchedSystem, gains: np.ndarray, step: float) -> str:
    closed = np.linalg.eigvals(plant.A + plant.B @ gains)
    fastest = float(np.abs(closed).max())
    if step * fastest <= 1.0:
        return ""
    return (
        f"The step of {step:g} s is longer than the loop's fastest motion, 1/|p| = "
        f"{1.0 / fastest:.3g} s: is the step in seconds, and are poles in 1/s?"
    )


def _scales(plant: SwitchedSystem) -> str:
    """A sentence about the first mode with states that balancing scales far apart."""
    from scipy.linalg import matrix_balance

    for mode, A in enumerate(plant.A):
        _, (scale, _) = matrix_balance(A, permute=False, separate=True)
        most, least = int(scale.argmax()), int(scale.argmin())
        ratio = float(scale[most] / scale[least])
        if ratio > _SCALES:
            return (
                f"Of mode {mode} the states {least} and {most} are {amount(ratio)} times apart in "
                "scale: do all modes and rows have the same units (m or mm, rad or degrees)?"
            )
    return ""


def design(
    plant: SwitchedSystem,
    *,
    delay_margin: float | None = None,
    step: float = 0.01,
    law: MakeLaw | None = None,
    gains: ArrayLike | None = None,
    filtered: bool | None = None,
    longest_step: float | None = None,
    decay_rate: float = 0.0,
    budget: int = 800,
    weight: Weight | None = None,
    input_limit: ArrayLike | None = None,
    initial: InitialStates | StationaryNoise | None = None,
    progress: Callable[[str], None] | None = None,
) -> Design:
    r"""Gains and a law with a requested delay margin, decay rate and input limit, at least cost.

    The search varies the gains (with one input the poles of each mode, with several the LQR
    weights), the time constant of a low-pass filter in the law, and, if allowed, the sampling
    period. If no design tried meets the request, the nearest is returned, with the limits of any
    linear controller.

    Parameters
    ----------
    plant : SwitchedSystem
        The plant at its nominal delays, the model of the law.
    delay_margin : float, optional
        The relative error of the true delay, above 0 and below 1, that every constant mode must
        tolerate both ways: 0.05 for ±5 %. Several delays change by the same time, relative to the
        shortest. Without it the margin is reported only.
    step : float
        Sampling period h, seconds.
    law : callable, optional
        The law family: (plant, gains) → law; `AveragedPredictor` by default. For one mode's own
        exact law give a plant of that mode alone.
    gains : array_like, shape (modes, m, n), optional
        The plain design to start from and to compare with; LQR of the cost's weights by default.
    filtered : bool, optional
        True: only laws with a low-pass filter; False: only without; by default both.
    longest_step : float, optional
        Allow periods up to this, seconds: 2, 5, 10, … times `step`.
    decay_rate : float
        The least decay rate of every constant mode at the nominal delays, 1/s. Without it a slow
        loop may have a wide margin at a low cost.
    budget : int
        The number of designs to try. A larger budget tries all designs of a smaller one.
    weight : Weight, optional
        Of the cost :math:`\int x^T Q x + u^T R u \, dt`, the mean over the modes, each held; the
        identity by default. R must be definite and Q weigh the unstable states of
        every mode, so that a loop that grows has a large cost.
    input_limit : array_like, shape () or (m,), optional
        The bound of :math:`|u_j|` in every constant mode, starting from `initial` without inputs in
        the past.
    initial : InitialStates or StationaryNoise, optional
        The initial states, the ball :math:`|x(0)| \le 1` by default. Over a ball or box the
        bound holds in the exact worst case, for a normal x(0) with at least its probability
        (`deadtime.synthesis.input_peak`). Under stationary noise it holds with its probability at
        any one instant.
    progress : callable, optional
        Called with a few words before each of at most `budget` designs that are tried.

    Returns
    -------
    Design

    Raises
    ------
    ArgumentError
        If an argument is malformed, a mode is not controllable or has no `delay_limit`, the law
        family makes laws that are no table or need a preview of the signal, or the delay holds so
        many periods that the search would take long.

    Notes
    -----
    The margin is that of constant modes, exact; switching may destabilise the loop earlier, which
    `delay_margin(…, dwell_time=…)` decides. The search does not prove its result the cheapest.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], delay=1.0)
    >>> found = design(plant, delay_margin=0.2, step=0.05, budget=60)
    >>> found.reached, found.margin.relative >= 0.2, found.cost > found.plain.cost
    (True, True, True)
    """
    progress = reporter("progress", progress)
    asked = check_request(plant, delay_margin, step, filtered, longest_step)
    limit, initial = limits_asked(plant, input_limit), check_initial(initial, plant)
    floors = Floors(asked, decay_asked(decay_rate), limit, initial)
    given = None if gains is None else check_gains(plant, gains, True)
    weight = weight_of(weight, plant)
    if weight is not None:
        require_identified(plant, weight)
    budget = count("budget", budget, 20)
    make = partial(AveragedPredictor, allow_unstable=True) if law is None else law
    for mode in range(plant.modes):
        require_controllable(plant.A[mode], plant.B[mode], mode)
    whole = (weight or Weight()).of(plant)
    start = lqr(plant, whole.Q, whole.R) if given is None else given
    first = require_table(plant, make, start)
    require_affordable("design", plant, first, step, budget)
    limits = tuple(delay_limit(plant, mode) for mode in range(plant.modes))
    plain_cost = assess(plant, first, step, weight=weight)[1]
    plain_margin = constant_delay_margin(plant, first, step)
    plain = _point(plant, first, step, plain_margin, plain_cost, initial)
    search = DesignSearch(plant, make, budget, floors, weight, progress=progress)
    pairs = pairs_of(search, filtered, step, longest_step)
    if not filtered:
        search.plain = _plain_candidate(plain, *pairs[0], start, floors)
        search.tried.append(search.plain)
    spend(search, pairs, start, np.random.default_rng(0))
    exact = Exact(plant, search)
    return _result(plant, exact, exact.choose(), plain, start, limits)


def _point(
    plant: SwitchedSystem,
    law: Law,
    step: float,
    margin: DelayMargin,
    cost: float,
    initial: Source | None,
) -> TradeOff:
    """A design with its exact margin, decay rate and inputs."""
    growth = float(margin.growth.max())
    peak = np.full(plant.inputs, np.inf)
    if growth < 0.0:
        peak = largest_inputs(plant, law, step, initial)
    return TradeOff(law, step, margin.relative or 0.0, cost, -growth, peak)


def _plain_candidate(
    plain: TradeOff, family: ChoiceFamily, step: float, gains: np.ndarray, floors: Floors
) -> Tried:
    """The plain design as the first candidate, with parameters of gains close to its own."""
    return Tried(
        family=family,
        step=step,
        parameters=family.starts(gains)[0],
        choice=Choice(gains, None),
        law=plain.law,
        margin=min(plain.margin, WIDEST),
        cost=plain.cost,
        growth=-plain.decay_rate,
        load=floors.load(plain.input_peak),
    )


def _result(
    plant: SwitchedSystem,
    exact: Exact,
    chosen: Tried | None,
    plain: TradeOff,
    gains: np.ndarray,
    limits: tuple[DelayLimit, ...],
) -> Design:
    """The design chosen, or the plain one where nothing is stable."""
    law, step, cost = plain.law, plain.step, plain.cost
    hints = unit_hints(plant, gains, step)
    if chosen is None:
        margin = constant_delay_margin(plant, law, step)
    else:
        margin, gains = exact.margin(chosen), chosen.choice.gains
        law, step = chosen.law, chosen.step
        search = exact.search
        cost = assess(plant, law, step, weight=search.weight)[1]
    floors = exact.search.floors
    growth = _ends(plant, law, step, floors.margin)
    found = _point(plant, law, step, margin, cost, floors.initial)
    missed = floors.shortfalls(found.margin, found.decay_rate, floors.load(found.input_peak))
    reached = not missed and bool((growth < 0.0).all())
    offered = None if chosen is None else found
    text = sentences(floors, reached, offered, plain, limits, exact.search.spent)
    return Design(
        law=law,
        gains=gains,
        time_constant=found.time_constant,
        step=step,
        margin=margin,
        asked=floors.margin,
        decay_asked=floors.decay_rate,
        reached=reached,
        growth=growth,
        cost=cost,
        decay_rate=found.decay_rate,
        plain=plain,
        limits=limits,
        points=exact.trade_off(offered),
        evaluated=exact.search.spent,
        message=" ".join([text, *hints]),
        weight=exact.search.weight,
        input_peak=found.input_peak,
        input_limit=floors.input_limit,
        initial=floors.initial or InitialStates.ball(),
    )


def _ends(plant: SwitchedSystem, law: Law, step: float, asked: float) -> np.ndarray:
    """The growth rates at both ends of the requested margin, an independent check of it."""
    shortest = plant.shortest_delay
    offsets = plant.delays - shortest
    delays = [shortest * (1.0 + sign * asked) + offsets for sign in (-1.0, 1.0)]
    ends = [plant.like(plant.A, plant.B, one) for one in delays]
    return np.array([[growth_rate(end, law, i, step) for i in range(plant.modes)] for end in ends])
