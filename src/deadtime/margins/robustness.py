"""`robustness`: the errors that a loop tolerates, each with a sentence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import count, instance, positive, real_array, reporter, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import sentence_of
from deadtime.feedback import Law
from deadtime.imperfections import Dropout, Imperfection, LateSamples, ModeDelay, streams
from deadtime.margins.delay import DelayMargin, constant_delay_margin
from deadtime.margins.gain import GainMargin, gain_margin
from deadtime.margins.tolerance import (
    NoisePrice,
    RobustnessRuns,
    Tolerance,
    noise_price,
    tolerance_of,
)
from deadtime.numerics.kernels import expect_many_calls
from deadtime.plant import SwitchedSystem
from deadtime.plant.weight import Weight, weight_of
from deadtime.simulation.initial_input import InitialInput
from deadtime.spectrum.held_mode_checks import why_left_out
from deadtime.switching import Rule, SwitchingSignal

_LOST_SHARES = (0.0, 0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
_FINE = 0.1  # relative, of a share of lost samples: runs of 20 scenarios tell no more
_MARGINS = ("delay margin", "gain margin")
STEPS = ("delay", "gain", "lost samples", "late samples", "detection lag", "noise")


@dataclass(frozen=True, eq=False)
class Robustness:
    """The errors that one loop tolerates (immutable).

    Attributes
    ----------
    plant, law, step
        The loop.
    delay : DelayMargin or None
        True delays that keep every constant mode stable, from the spectrum; None for a law that is
        no table, and if it is `left_out`.
    gain : GainMargin or None
        Factors of the inputs' effect that keep every constant mode stable; None likewise.
    drops : Tolerance
        Probability of losing a sample.
    late : Tolerance
        Periods by which every sample is late, unknown to the law.
    lag : Tolerance or None
        Mode detection delay, in periods; None for a law that does not read the mode.
    noise : NoisePrice
        The effect of measurement noise on the cost.
    sentences : tuple of str
        The results, in words.
    weight : Weight or None
        Of the cost; None for the identity.
    of_inputs : tuple of DelayMargin
        With several delays, the margin of the delay of each input alone.
    left_out : tuple of str
        Those of "delay margin" and "gain margin" that would have taken long; `sentences` say why.
    """

    plant: SwitchedSystem
    law: Law
    step: float
    delay: DelayMargin | None
    gain: GainMargin | None
    drops: Tolerance
    late: Tolerance
    lag: Tolerance | None
    noise: NoisePrice
    sentences: tuple[str, ...]
    weight: Weight | None = None
    left_out: tuple[str, ...] = ()
    of_inputs: tuple[DelayMargin, ...] = ()


def robustness(
    plant: SwitchedSystem,
    law: Law,
    signal: SwitchingSignal | Rule,
    x0: ArrayLike,
    horizon: float,
    step: float = 0.01,
    *,
    scenarios: int = 20,
    seed: int = 0,
    imperfections: Sequence[Imperfection] = (),
    u0: InitialInput = None,
    weight: Weight | None = None,
    names: Sequence[str] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Robustness:
    """The errors that a loop tolerates: delay, gain, lost and late samples, late modes, noise.

    Margins of delay and gain are those of constant modes, exact from the spectrum; of several
    delays, of all together and of each input alone. They are left out, with a sentence, where a
    delay of very many periods would make them take long. The rest is simulated on the given signal:
    a run is lost when it diverges, its loop grows, or :math:`|x|` ends above its start. Where x is
    pushed, starts at 0, or inputs are limited, a run must instead come to rest where the perfect
    loop does, which has the same forces and no other imperfection; `docs/robustness.md` has the
    details.

    Parameters
    ----------
    plant, law, signal, x0, horizon, step
        As `simulate` takes them; a step is needed.
    scenarios : int
        Runs with different random numbers for each value of what is random.
    seed : int
        Of the first scenario; the others count on.
    imperfections : sequence of Imperfection
        Imperfections of every run, besides the one that is varied.
    u0 : optional
        Inputs before time 0, as `simulate` takes them.
    weight : Weight, optional
        Of the cost; the identity by default.
    names : sequence of str, optional
        Names of the inputs for `sentences`; numbers by default.
    progress : callable, optional
        Called with a few words before each of `len(STEPS)` pieces of work.

    Returns
    -------
    Robustness

    Raises
    ------
    ArgumentError
        If an argument is malformed, or the law cannot be run with imperfections.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[0.5]], [[0.2]]], [[[1.0]], [[1.1]]], delay=0.3)
    >>> law = dt.AveragedPredictor(plant, dt.place(plant, [-2.0]))
    >>> signal = dt.SwitchingSignal.periodic([0.4, 0.6], [0, 1], 6.0)
    >>> result = robustness(plant, law, signal, [1.0], 5.0, 0.05, scenarios=3)
    >>> result.late.tolerated, result.lag
    (12.0, None)
    """
    progress = reporter("progress", progress)
    instance("plant", plant, SwitchedSystem)
    instance("law", law, Law)
    x0 = require_shape("x0", real_array("x0", x0, "(n,)", 1), (plant.states,), "(n,)")
    scenarios, seed = count("scenarios", scenarios), count("seed", seed, 0)
    step, horizon = positive("step", step), positive("horizon", horizon)
    streams(imperfections, seed)
    if horizon <= plant.longest_delay:
        raise ArgumentError(
            f"horizon must be longer than the delay, {plant.longest_delay:g} s, got {horizon:g}: "
            "until then no input arrives."
        )
    weight = weight_of(weight, plant)
    setting = RobustnessRuns(
        plant, law, signal, x0, horizon, step, scenarios, seed, tuple(imperfections), u0, weight
    )
    expect_many_calls()
    if not setting.moves:
        raise ArgumentError("x0 must not be 0, from where nothing moves: start elsewhere.")
    progress("delay margin")
    margins = _MARGINS if law.is_linear else ()
    reasons = {margin: why_left_out(margin, plant, law, step) for margin in margins}
    left_out = tuple(margin for margin, why in reasons.items() if why)
    delay = constant_delay_margin(plant, law, step) if reasons.get("delay margin") == "" else None
    alone: tuple[DelayMargin, ...] = ()
    if delay is not None and plant.inputs > 1 and not plant.has_one_delay:
        each = range(plant.inputs)
        alone = tuple(constant_delay_margin(plant, law, step, None, j, names) for j in each)
    progress("gain margin")
    gain = gain_margin(plant, law, step) if reasons.get("gain margin") == "" else None
    progress("lost samples")
    drops = _lost_samples(setting)
    progress("late samples")
    most = max(1, int(horizon / step) // 4)
    late = _periods_late(setting, LateSamples, most, "every sample may be")
    progress("detection lag")
    lag = None
    if _is_mode_reported(law, step, signal):
        lag = _periods_late(setting, ModeDelay, most, "the mode may be reported")
    progress("noise")
    if drops.tolerated is None:
        noise = NoisePrice.unknown("the cost of noise cannot be computed: the runs fail without it")
    else:
        noise = noise_price(setting, float(np.linalg.norm(x0)) or 1.0)
    # The spectrum knows no imperfections.
    left = ", ".join(one.in_words for one in setting.imperfections)
    ignoring = f"without {left}: " if left else ""
    sentences = [sentence_of(ignoring + part.message) for part in (delay, *alone, gain) if part]
    sentences += [sentence_of(reasons[margin]) for margin in left_out]
    sentences += [sentence_of(part.message) for part in (drops, late, lag) if part is not None]
    if lag is None:
        sentences.append("Mode detection delay has no effect: the law does not read the mode.")
    if setting.compared and setting.works.startswith("stays near"):
        sentences.append("Near: over its last quarter, within the distance that run itself moves.")
    sentences.append(sentence_of(noise.message))
    once = tuple(dict.fromkeys(sentences))  # tolerances that fail alike have the same sentence
    return Robustness(
        plant, law, step, delay, gain, drops, late, lag, noise, once, weight, left_out, alone
    )


def _is_mode_reported(law: Law, step: float, signal: SwitchingSignal | Rule) -> bool:
    """Whether a law, or the observer before it, acts on a mode that somebody measures."""
    if law.filter is not None:
        return False
    if not law.is_linear or (law.observer is not None and law.observer.reads_mode):
        return True
    future: Any = (signal, 1) if isinstance(signal, SwitchingSignal) else ()
    return law.row_law.digital(step, *future).context in ("mode", "mode_age")


def _lost_samples(setting: RobustnessRuns) -> Tolerance:

    def between(good: float, bad: float) -> float | None:
        return 0.5 * (good + bad) if bad - good > max(_FINE * bad, 1e-3) else None

    def say(tolerated: float, failed: float | None, _: bool) -> str:
        upto = "" if failed is None else "up to "
        which, what, some = "none", "loses the plant", ""
        if setting.compared:
            which, what, some = "each", setting.works, " not"
        runs = "1 run" if setting.scenarios == 1 else f"{setting.scenarios} runs"
        text = (
            f"with {upto}{100 * tolerated:.3g} % of the samples lost {which} of {runs} "
            f"{setting.where} {what}"
        )
        if failed is None:
            return f"{text} (a higher share was not tried)"
        return f"{text}; with {100 * failed:.3g} % some do{some}"

    return tolerance_of(setting, Dropout, _LOST_SHARES, between, setting.scenarios, say)


def _periods_late(
    setting: RobustnessRuns, kind: Callable[[int], Imperfection], most: int, what: str
) -> Tolerance:
    values = [0.0]
    while values[-1] < most:
        values.append(min(float(most), max(1.0, 2.0 * values[-1])))
    # Lateness is not random: without other imperfections all scenarios are the same.
    scenarios = setting.scenarios if setting.imperfections else 1

    def between(good: float, bad: float) -> float | None:
        return float((good + bad) // 2) if bad - good > 1.0 else None

    def say(tolerated: float, failed: float | None, bounded: bool) -> str:
        periods = "1 period" if tolerated == 1.0 else f"{tolerated:g} periods"
        seconds = f"{periods} ({tolerated * setting.step:.3g} s) late {setting.where}"
        fate = f"no longer {setting.works}" if bounded else "is lost"
        if failed is None:
            return f"{what} {seconds}, and more was not tried"
        if tolerated == 0.0:
            one = f"with one, {setting.step:g} s,"
            return f"{what} no whole period late {setting.where}: {one} the loop {fate}"
        return f"{what} up to {seconds}; with {failed:g} the loop {fate}"

    return tolerance_of(setting, lambda value: kind(int(value)), values, between, scenarios, say)
