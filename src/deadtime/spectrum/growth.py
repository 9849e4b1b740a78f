"""Growth rates: one mode for ever."""

from __future__ import annotations

from deadtime.checks import positive
from deadtime.errors import ArgumentError
from deadtime.laws.base import Law
from deadtime.output_feedback import OutputFeedback
from deadtime.plant import SwitchedSystem
from deadtime.spectrum.arguments import checked_mode
from deadtime.spectrum.lifted import LiftedLoop, aged_row
from deadtime.switching import SwitchingSignal

_PRECISION = 1e-4


def growth_rate(plant: SwitchedSystem, law: Law, mode: int, step: float | None = 0.01) -> float:
    """How fast the loop grows if the plant stays in one mode for ever, in 1/s.

        max Re s = ln(spectral radius of the lifted loop)/h,

    and for the ideal loop, which the digital one tends to with order h, max Re s over its
    characteristic roots (`characteristic_roots`). Negative for a loop that decays. The row of a
    law that tells ages apart is the one of a mode that has lasted for ever; an oracle knows that
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

    Returns
    -------
    float
        The growth rate, to about 1e-9 1/s. A double precision loop cannot show that it decays
        much faster than −30/D, where round-off takes over; there the rate is that of round-off.
        Without a step to round-off, of which large gains over the delay make more
        (`CharacteristicRoots.errors`); 1e-4/D at worst.

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
    mode = checked_mode(plant, law, mode)
    if step is None:
        return _ideal(plant, law, mode)
    step = positive("step", step)
    table = law.law if isinstance(law, OutputFeedback) else law
    feedback = table.digital(step, SwitchingSignal.constant(mode), 1)
    row = aged_row(feedback, mode)
    if isinstance(law, OutputFeedback):
        from deadtime.spectrum.observed import observed_loop

        law.require_step(step)
        return observed_loop(plant, law, feedback, mode, row).growth_rate(step)
    return LiftedLoop.of(plant, feedback, mode, row).growth_rate(step)


def _ideal(plant: SwitchedSystem, law: Law, mode: int) -> float:
    """The rightmost characteristic root's real part."""
    from deadtime.spectrum.characteristic import rightmost
    from deadtime.spectrum.ideal import IdealLoop

    loop = IdealLoop.of(plant, law, mode)
    found = rightmost(loop, 1)
    if not found.complete or found.errors[0] > _PRECISION / loop.longest:
        raise ArgumentError(
            "step must be given: the characteristic roots of the ideal loop could not be told "
            f"apart, so large are the law's gains over a delay of {law.plant.delay:g} s."
        )
    return float(found.roots[0].real)
