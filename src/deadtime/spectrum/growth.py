"""Growth rates of constant modes: in floating point, and between bounds that are proved."""

from __future__ import annotations

import math

from deadtime.base.checks import count, instance, positive
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Feedback, Law
from deadtime.feedback.recurrence import recurrence_of
from deadtime.plant import SwitchedSystem
from deadtime.spectrum.held_mode_checks import check_mode
from deadtime.spectrum.lifted import LiftedLoop, aged_row, with_memory
from deadtime.spectrum.loop_units import least_growth, pace_of
from deadtime.switching import SwitchingSignal

_PRECISION = 1e-4  # of the ideal loop, per delay
_DOUBT = 1e-9  # of the rate or the plant's pace: what is less certain is computed beyond doubt
_FADED = -25.0  # growth over the memory of the loop below which all is round-off


def growth_rate(
    plant: SwitchedSystem,
    law: Law,
    mode: int,
    step: float | None = 0.01,
    *,
    mode_lag: int = 0,
) -> float:
    """How fast the loop grows in a constant mode, in 1/s.

        max Re s = ln(spectral radius of the lifted loop)/h,

    and for the ideal loop, which the digital one tends to with order h, max Re s over its
    characteristic roots (`characteristic_roots`). Negative for a loop that decays. The row of a
    law that tells ages apart is the one of a mode that has lasted; an oracle knows that
    nothing will switch.

    Parameters
    ----------
    plant : SwitchedSystem
        The truth. The law has a model of its own, `law.plant`; delay and matrices may differ.
    law : Law
        A law that is a table, or an `OutputFeedback` of one, whose loop has its observer and its
        sum of errors in it; without a step, one that has a closed form in continuous time.
    mode : int
        The mode.
    step : float or None
        Sampling period h, in seconds; None for the ideal loop, updated continuously.
    mode_lag : int
        How many periods late the law is told the mode. One that lasts is told in the end, and its
        age is past all that a table tells apart: no lag changes the rate. It is a parameter so that
        whoever asks about a loop with a lag may ask for its rates, too.

    Returns
    -------
    float
        The growth rate. With a step to about 1e-9/D: eigenvalues that double precision cannot
        tell so well, such as multiple ones, are enclosed in ball arithmetic (`growth_bounds`) up
        to the order 3,000; not those of a loop with an observer. A double precision loop cannot
        show that it decays much faster than −30/D, where round-off takes over; there the rate is
        that of round-off. Without a step to round-off, of which large gains over the delay make
        more (`CharacteristicRoots.errors`); at worst 1e-4 of 1/D or of the plant's own rate,
        whichever is less.

    Raises
    ------
    ArgumentError
        If the law and the plant do not belong together, the law is no table, or it foresees a
        signal of its own that switches; without a step, if the law has no closed form, or its
        gains over the delay are so large that the roots cannot be told from round-off.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> law = dt.AveragedPredictor(problem.plant, problem.gains)
    >>> [round(growth_rate(problem.plant, law, mode), 3) for mode in (0, 1)]
    [0.128, 0.282]
    >>> [round(growth_rate(problem.plant, law, mode, step=None), 6) for mode in (0, 1)]
    [0.128182, 0.28213]
    """
    mode = check_mode(plant, law, mode)
    count("mode_lag", mode_lag, 0)
    if step is None:
        return _ideal(plant, law, mode)
    step = positive("step", step)
    rows = law if law.observer is None else law.inner
    feedback = rows.digital(step, SwitchingSignal.constant(mode), 1)
    row = aged_row(feedback, mode)
    if law.observer is not None:
        from deadtime.spectrum.lifted import observed_loop

        law.require_step(step)
        return observed_loop(plant, law, feedback, mode, row).growth_rate(step)
    return constant_growth(plant, feedback, mode, row)


def constant_growth(plant: SwitchedSystem, feedback: Feedback, mode: int, row: int) -> float:
    """The growth rate of a mode under a row of a table, 1/s, to about 1e-9 of it or of the pace."""
    from deadtime.spectrum.root_enclosure import LARGEST, enclose_growth

    step, loop = feedback.step, LiftedLoop.of(plant, feedback, mode, row).balance()
    values, radius = loop.leading_eigenvalues()
    rate = math.log(radius) / step if radius > 0.0 else -math.inf
    if rate * loop.past * step < _FADED or loop.order > LARGEST:
        return rate
    if loop.doubt(values) <= _DOUBT * step * max(pace_of(plant), abs(rate)):
        return rate
    low, high = enclose_growth(plant, feedback, mode, row)
    return rate if low <= rate <= high or math.isinf(low) else 0.5 * (low + high)


def growth_bounds(
    plant: SwitchedSystem, law: Law, mode: int, step: float = 0.01
) -> tuple[float, float]:
    """Two numbers, 1/s, between which the growth rate of one mode lies beyond doubt.

    A proof by computation: ball arithmetic on the characteristic polynomial of the lifted loop
    (`spectrum.root_enclosure`), of the matrices and of the law's table as stored, binary64,
    and of the loop as `simulate` cuts it. They lie about 1e-11/D apart; two numbers of
    one sign prove that the loop grows, or decays, in this mode.

    Parameters
    ----------
    plant, law, mode
        As `growth_rate` takes them; the law must be a table, or an `OutputFeedback` of one.
    step : float
        Sampling period h, in seconds.

    Returns
    -------
    (float, float)
        The lower bound, −∞ where every solution may end after finitely many periods, and the
        upper one.

    Raises
    ------
    ArgumentError
        As by `growth_rate`; also if the loop is of an order n + N m above 3,000; with q numbers
        that the law remembers n + N (q + m). An order of 1,000 takes about a second.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> law = dt.AveragedPredictor(problem.plant, problem.gains)
    >>> low, high = growth_bounds(problem.plant, law, mode=1)
    >>> 0.0 < low < high < low + 1e-10, round(low, 9), round(high, 9)
    (True, 0.281670215, 0.281670215)
    """
    from deadtime.spectrum.root_enclosure import LARGEST, enclose_growth

    instance("law", law, Law)
    mode, step = check_mode(plant, law, mode), positive("step", step)
    feedback = recurrence_of(law, step, SwitchingSignal.constant(mode))
    if feedback is None:
        raise ArgumentError(
            f"law must be a table, got {type(law).__name__}: bounds of its growth are not known; "
            "`growth_rate` has a number where there is one."
        )
    plant = with_memory(plant, feedback)
    row = aged_row(feedback, mode)
    order = LiftedLoop.of(plant, feedback, mode, row).order
    if order > LARGEST:
        raise ArgumentError(
            f"step must leave a loop of an order up to {LARGEST}, got {order}: lengthen it."
        )
    return enclose_growth(plant, feedback, mode, row)


def not_decaying(plant: SwitchedSystem, rate: float) -> str:
    """What a loop does in a constant mode in which it does not decay, to follow "the loop".

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], delay=0.2)
    >>> not_decaying(plant, 0.28167), not_decaying(plant, 2e-16)
    ('grows at +0.282 /s already', 'neither grows nor decays')
    """
    if rate > least_growth(plant):
        return f"grows at {rate:+.3g} /s already"
    return "neither grows nor decays"


def _ideal(plant: SwitchedSystem, law: Law, mode: int) -> float:
    """The rightmost characteristic root's real part."""
    from deadtime.spectrum.characteristic import rightmost
    from deadtime.spectrum.ideal import IdealLoop

    loop = IdealLoop.of(plant, law, mode)
    found = rightmost(loop, 1)
    if not found.complete or found.errors[0] > _PRECISION * loop.unit:
        raise ArgumentError(
            "step must be given: the characteristic roots of the ideal loop could not be told "
            f"apart, so large are the law's gains over a delay of {law.plant.longest_delay:g} s."
        )
    return float(found.roots[0].real)
