"""The gain margin of constant modes: factors k of the inputs' effect that leave the loop stable.

With the effect of every input multiplied by k, the loop of one mode has a root at the frequency ω
if I − k L(ω) is singular, L = M⁻¹ r p being the loop's gain at the plant's input
(`deadtime.spectrum.response`). So a root can cross the limit of stability only at a k = 1/λ with
a positive real eigenvalue λ of L(ω). There the curve of an eigenvalue crosses the positive real
axis, or ends on it at the highest or the lowest frequency.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import positive
from deadtime.base.frozen import Frozen
from deadtime.base.wording import inwards
from deadtime.feedback import Law
from deadtime.margins.delay import held_in, in_every
from deadtime.numerics.small_matrices import inverses, matched
from deadtime.plant import SwitchedSystem
from deadtime.spectrum import growth_rate, least_growth
from deadtime.spectrum.digital_response import digital_response
from deadtime.spectrum.growth import not_decaying
from deadtime.spectrum.held_mode_checks import require_affordable, require_constant
from deadtime.spectrum.response import IdealResponse, Response

_TURN, _FINEST = 0.25, 1e-10  # of an eigenvalue between neighbours; of the highest frequency
_LARGEST = 1e6  # a larger factor counts as infinite
_TRIED = 40  # intervals of factors in which an unstable loop may be stable
_ROUND_OFF = 0.1  # of the least growth: growth of a loop that decays, by round-off
_Factors = tuple[float, float]
_End = tuple[float, int | None]  # a factor and the mode that is lost there


@dataclass(frozen=True, eq=False)
class GainMargin(Frozen):
    """Factors of the inputs' effect that leave a loop stable (immutable).

    Attributes
    ----------
    lower, upper : float or None
        The open interval of factors around 1 with every constant mode stable. 0: stable down to
        no effect at all. ∞: stable for any larger factor. None: a mode is unstable at 1.
    lower_mode, upper_mode : int or None
        The mode that is lost there; None if none is. Without an interval, the mode that grows
        fastest.
    growth : (modes,)
        The growth rate in each mode at the factor 1, 1/s.
    message : str
        The same in a sentence.
    stabilising : (float, float) or None
        If a mode is unstable at 1, the open interval of factors nearest to 1 that makes every
        constant mode stable; None if there is none, or every mode is stable.
    """

    lower: float | None
    upper: float | None
    lower_mode: int | None
    upper_mode: int | None
    growth: Float[np.ndarray, " mode"]
    message: str
    stabilising: tuple[float, float] | None = None


def gain_margin(plant: SwitchedSystem, law: Law, step: float | None = 0.01) -> GainMargin:
    """The factors of the inputs' effect B with which every constant mode is stable.

    Parameters
    ----------
    plant : SwitchedSystem
        The truth at the factor 1. The law has a model of its own, `law.plant`.
    law : Law
        A law that is a table, or an `OutputFeedback` of one; without a step, one that has a closed
        form in continuous time.
    step : float or None
        Sampling period h, in seconds; None for the ideal loop, updated continuously.

    Returns
    -------
    GainMargin
        To about 1e-9 relative.

    Raises
    ------
    ArgumentError
        As by `growth_rate`, and if the delay holds so many periods that the search would take
        long.

    Notes
    -----
    Switching between modes may destabilise the loop earlier; `stability_margin` proves a margin
    for every admissible signal.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[1.0]]], [[[1.0]]], delay=0.2)
    >>> law = dt.SingleModePredictor(plant, dt.place(plant, [-1.0]), 0)
    >>> margin = dt.gain_margin(plant, law)
    >>> round(margin.lower, 4), round(margin.upper, 4)
    (0.5906, 4.3699)
    """
    require_constant(plant, law)
    step = None if step is None else positive("step", step)
    require_affordable("gain margin", plant, law, step)
    growth = np.array([growth_rate(plant, law, mode, step) for mode in range(plant.modes)])
    if growth.max() >= 0.0:
        worst = int(growth.argmax())
        what = not_decaying(plant, growth[worst])
        factors, stable = _stabilising(plant, law, step)
        text = f"there is no gain margin: {held_in(plant, worst)}the loop {what}; "
        text += _cure(factors, stable, in_every(plant))
        return GainMargin(None, None, worst, worst, growth, text, factors if stable else None)
    lower, upper = _around(plant, law, step)
    text = _sentence(lower, upper, in_every(plant))
    return GainMargin(lower[0], upper[0], lower[1], upper[1], growth, text)


def _around(plant: SwitchedSystem, law: Law, step: float | None) -> tuple[_End, _End]:
    """The factors next to 1 at which a mode is lost, and the mode."""
    lower: _End = (0.0, None)
    upper: _End = (math.inf, None)
    for mode in range(plant.modes):
        low, high = _interval(plant, law, mode, step)
        lower = (low, mode) if low > lower[0] else lower
        upper = (high, mode) if high < upper[0] else upper
    return lower, upper


def _interval(
    plant: SwitchedSystem, law: Law, mode: int, step: float | None
) -> tuple[float, float]:

    grown = _ROUND_OFF * least_growth(plant)

    def limit(outwards: list[float]) -> float | None:
        """The factor beyond which the mode is lost first; None if it is stable up to the last."""

        def is_lost(factor: float) -> bool:
            return growth_rate(_acting(factor, plant), law, mode, step) >= grown

        for a, b in itertools.pairwise(outwards):
            if is_lost(math.sqrt(a * b)):
                return a
        good, bad = 1.0, outwards[-1]
        if not is_lost(bad):
            return None
        # A crossing between two frequencies was missed.
        while abs(math.log(bad / good)) > 1e-12:
            middle = math.sqrt(good * bad)
            good, bad = (good, middle) if is_lost(middle) else (middle, bad)
        return good

    factors, high = _crossings(plant, law, mode, step, 1.0), None
    low = limit([*factors[factors < 1.0][::-1].tolist(), 1.0 / _LARGEST])
    for most in _reaches(step):
        factors = factors if step is not None else _crossings(plant, law, mode, step, most)
        near = factors[(factors > 1.0) & (factors < most)]
        high = limit([*near.tolist(), float(most)])
        if high is not None:
            break
    return 0.0 if low is None else low, math.inf if high is None else high


def _acting(factor: float, plant: SwitchedSystem) -> SwitchedSystem:
    return plant.like(plant.A, factor * plant.B)


def _reaches(step: float | None) -> list[float]:
    """The largest factors of successive searches: without a step, larger ones cost more."""
    return [_LARGEST] if step is not None else (_LARGEST ** np.linspace(0.2, 1.0, 5)).tolist()


def _crossings(
    plant: SwitchedSystem, law: Law, mode: int, step: float | None, most: float
) -> np.ndarray:
    """Factors, up to `most` at least, at which a mode has a root at the limit of stability."""
    if step is not None:
        return _candidates(digital_response(plant, law, mode, step), plant.shortest_delay)
    # Stronger inputs have roots at higher frequencies.
    response = IdealResponse.of(plant, law, mode)
    highest = IdealResponse.of(_acting(most, plant), law, mode).highest
    return _candidates(replace(response, radius=highest), plant.shortest_delay)


def _stabilising(plant: SwitchedSystem, law: Law, step: float | None) -> tuple[_Factors, bool]:
    """The interval of factors nearest to 1 that makes every constant mode stable, and True.

    The number of growing roots is constant between two neighbouring crossings, so one factor of
    each interval decides. If none of the `_TRIED` nearest to 1 is stable: the range tried, False.
    """

    def decays(factor: float) -> bool:
        acting = _acting(factor, plant)
        return all(growth_rate(acting, law, mode, step) < -least for mode in range(plant.modes))

    least, tried = least_growth(plant), set[tuple[float, float]]()
    for most in _reaches(step):
        found = [_crossings(plant, law, mode, step, most) for mode in range(plant.modes)]
        ends = np.concatenate((*found, [1.0 / _LARGEST, most]))
        ends = np.unique(ends[(ends >= 1.0 / _LARGEST) & (ends <= most)])
        cells = itertools.pairwise(ends.tolist())
        for cell in sorted(cells, key=lambda cell: abs(math.log(math.prod(cell))))[:_TRIED]:
            factor = math.sqrt(math.prod(cell))
            if decays(factor):
                (lower, _), (upper, _) = _around(_acting(factor, plant), law, step)
                return (factor * lower, factor * upper), True
            tried.add(cell)
        if len(tried) >= _TRIED:
            break
    low, high = zip(*tried, strict=True)
    return (min(low), max(high)), False


def _candidates(response: Response, delay: float) -> Float[np.ndarray, " factor"]:
    """Every factor at which a root lies at the limit of stability, increasing.

    Frequencies are added until no eigenvalue of L turns by more than `_TURN` between two.
    """
    highest = response.highest
    count = int(8.0 * highest * (response.memory + delay)) + 256
    omega = np.linspace(1e-9, 1.0 - 1e-9, count) * highest
    gains = _gains(response, omega, delay)
    while True:
        gains = matched(gains)
        apart = np.abs(np.diff(gains, axis=0))
        size = np.minimum(np.abs(gains[1:]), np.abs(gains[:-1])) + 1e-3
        coarse = (apart > _TURN * size).any(axis=1) & (np.diff(omega) > _FINEST * highest)
        if not coarse.any() or omega.size > 64 * count:
            break
        middle = 0.5 * (omega[:-1] + omega[1:])[coarse]
        order = np.argsort(np.concatenate((omega, middle)))
        gains = np.concatenate((gains, _gains(response, middle, delay)))[order]
        omega = np.concatenate((omega, middle))[order]
    real, imag = np.real(gains), np.imag(gains)
    crossing = (imag[1:] * imag[:-1] < 0.0) & (real[1:] + real[:-1] > 0.0)
    found: list[Any] = []
    for end in (0.0, highest):
        # An integrating plant has an infinite gain at frequency 0, so no factor there.
        with np.errstate(over="ignore", invalid="ignore"):
            values: Any = _gains(response, np.array([end]), delay).ravel().tolist()
        found += [z.real for z in values if abs(z.imag) <= 1e-9 * abs(z) < math.inf]
    found += _refine(response, delay, omega, gains, np.argwhere(crossing)).tolist()
    real = np.array([value for value in found if value > 1.0 / _LARGEST])
    return np.unique(1.0 / real)


def _gains(response: Response, omega: np.ndarray, delay: float) -> np.ndarray:
    samples = response.samples(omega)
    p, _, _ = response.delay_line(omega, np.full(omega.size, delay))
    L = inverses(samples.M) @ samples.r @ p
    L = np.where(np.isfinite(L), L, 1e300)
    return L[:, :, 0] if L.shape[1] == 1 else np.linalg.eigvals(L)


def _refine(
    response: Response, delay: float, omega: np.ndarray, gains: np.ndarray, crossing: np.ndarray
) -> Float[np.ndarray, " crossing"]:
    """The real eigenvalues in cells (i, j) of the samples, by bisection and then a secant."""
    if len(crossing) == 0:
        return np.empty(0)
    i, j = crossing.T
    a, b, low, high = omega[i], omega[i + 1], gains[i, j], gains[i + 1, j]
    for _ in range(50):
        middle = 0.5 * (a + b)
        values = _gains(response, middle, delay)
        nearest = np.abs(values - 0.5 * (low + high)[:, None]).argmin(axis=1)
        value = values[np.arange(len(values)), nearest]
        same = np.imag(value) * np.imag(low) > 0.0
        a, low = np.where(same, middle, a), np.where(same, value, low)
        b, high = np.where(same, b, middle), np.where(same, high, value)
    one, other = np.imag(low), np.imag(high)
    part = np.where(one == other, 0.5, one / np.where(one == other, 1.0, one - other))
    return np.real(low + part * (high - low))


def _sentence(lower: _End, upper: _End, every: str) -> str:
    (low, low_mode), (high, high_mode) = lower, upper
    low_text, high_text = inwards(low, 1.0), inwards(high, 1.0)
    if low_mode is None and high_mode is None:
        tried = f"from {1.0 / _LARGEST:g} to {_LARGEST:,.0f} times the model's, all that was tried"
        return f"gain margin infinite: stable{every} at every plant gain {tried}"
    text = "gain margins" if low_mode is not None and high_mode is not None else "gain margin"
    if high_mode is None:
        limits, much = low_text, f"above {low_text} times"
    elif low_mode is None:
        limits, much = high_text, f"below {high_text} times"
    else:
        limits, much = f"{low_text} and {high_text}", f"between {low_text} and {high_text} times"
    return f"{text} {limits}: stable{every} while the plant gain is {much} the model's"


def _cure(factors: _Factors, stable: bool, every: str) -> str:
    """The factors that would make an unstable loop stable, or the range tried, for sentences."""
    low, high = factors
    if not stable:
        tried = f"{inwards(low, 1.0)} to {inwards(high, 1.0)}"
        return f"no effect of the inputs {tried} times as much would make it stable"
    inside = 2.0 * low if math.isinf(high) else 0.5 * (low + high)
    least, most = inwards(low, inside), inwards(high, inside)
    if math.isinf(high):
        much = f"more than {least} times"
    else:
        much = f"between {least} and {most} times" if low else f"less than {most} times"
    return f"it would be stable{every} if the inputs acted {much} as much"
