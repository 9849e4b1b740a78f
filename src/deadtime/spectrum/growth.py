"""Growth rates of constant modes: in floating point, and between bounds that are proved.

The bounds hold beyond round-off: they are those of the characteristic polynomial in balls. In
t = 1/z the digital loop of one mode (`deadtime.spectrum.lifted`, L of order d) has

    p(t) = det(I − t L) = det [[I − tΦ, −t^N (late + t early)], [−F, I − Σ_j G_j t^j]],

a small determinant at every t: its values at 2^b > d roots of unity give the coefficients
p_i = (−1)^i e_i(λ), e_i the sum of all C(d, i) products of i eigenvalues. Graeffe's step,
p(t) p(−t) = q(t²), squares all eigenvalues. After k steps, e_i those of λ^(2^k),

    max_i (|e_i|/C(d, i))^(1/i)  ≤  ρ^(2^k)  ≤  2 max_i |e_i|^(1/i),

the first because no product is larger than ρ^i, the second is Fujiwara's bound. So the two close
like 2^−k, whatever the eigenvectors: multiple eigenvalues lose nothing. Everything is computed in
ball arithmetic (Arb) from the numbers as stored, binary64, exponentials included; the delay is
(N − 1) h + φ with the stored h and φ of `deadtime.plant.discretisation.Window`.

References: M. Fujiwara, Tohoku Math. J. 10 (1916) 167–171; V. Pan, SIAM Review 39 (1997) 187–220
(Graeffe's iteration).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from deadtime.base.checks import count, instance, positive
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Feedback, Law
from deadtime.feedback.recurrence import recurrence_of
from deadtime.numerics.precision import precision
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.spectrum.held_mode_checks import check_mode
from deadtime.spectrum.lifted import LiftedLoop, aged_row, held_table, observed_loop, with_memory
from deadtime.switching import SwitchingSignal

_LEAST = 1e-7


def pace_of(plant: SwitchedSystem) -> float:
    """A unit of rates: the smaller of 1/D, D the longest delay, and the largest |λ| of a mode, 1/s.

    It scales with the unit of time. For a plant of integrators alone it is 1/D.

    Examples
    --------
    >>> import deadtime as dt
    >>> [pace_of(dt.SwitchedSystem([[[a]]], [[[1.0]]], 0.5)) for a in (-8.0, -0.25, 0.0)]
    [2.0, 0.25, 2.0]
    """
    slow = 1.0 / plant.longest_delay
    fast = float(np.abs(np.linalg.eigvals(plant.A)).max())
    return min(slow, fast) if fast > 0.0 else slow


def least_growth(plant: SwitchedSystem) -> float:
    """The growth rate, 1/s, below which growth or decay is undecided: 1e-7 of the plant's pace.

    Examples
    --------
    >>> import deadtime as dt
    >>> least_growth(dt.SwitchedSystem([[[0.0]]], [[[1.0]]], delay=1.0))
    1e-07
    """
    return _LEAST * pace_of(plant)


_PRECISION = 1e-4  # of the ideal loop, per delay
_DOUBT = 1e-9  # of the rate or the plant's pace: less certain rates are enclosed in balls
_FADED = -25.0  # growth over the past inputs of the loop, in nepers: below is round-off


def growth_rate(
    plant: SwitchedSystem, law: Law, mode: int, step: float | None = 0.01, *, mode_lag: int = 0
) -> float:
    """The growth rate of the loop in a constant mode, 1/s; negative for a loop that decays.

        max Re s = ln(spectral radius of the lifted loop)/h,

    and for the ideal loop, the limit of the digital one with an error of order h, max Re s over its
    characteristic roots (`characteristic_roots`). If the law depends on the age of the mode, the
    mode has been held throughout; for an oracle no switch follows.

    Parameters
    ----------
    plant : SwitchedSystem
        The true plant. The law has a model of its own, `law.plant`, which may differ.
    law : Law
        A law that is a table, or an `OutputFeedback` of one, whose loop includes the observer and
        the sum of tracking errors; without a step, a law with a closed form in continuous time.
    mode : int
        The mode.
    step : float or None
        Sampling period h, in seconds; None for the ideal loop, updated continuously.
    mode_lag : int
        Mode detection delay, in periods. A constant mode is reported after it, so it does not
        change the rate; the parameter lets a loop with a lag be passed on as it is.

    Returns
    -------
    float
        The growth rate. With a step, accurate to about 1e-9/D: eigenvalues that double precision
        cannot resolve so well, such as multiple ones, are enclosed in ball arithmetic
        (`growth_bounds`) up to the order 3,000, but not those of a loop with an observer. Rates far
        below −30/D are hidden by round-off, whose rate is returned. Without a step, accurate to
        round-off, which large gains over the delay amplify (`CharacteristicRoots.errors`); at worst
        1e-4 of 1/D or of the plant's own rate, whichever is less.

    Raises
    ------
    ArgumentError
        If the law and the plant do not belong together, the law is no table, or it assumes a
        signal of its own that switches; without a step, if the law has no closed form, or its
        gains over the delay are so large that round-off hides the roots.

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
    feedback = held_table(law, mode, step)
    row = aged_row(feedback, mode)
    if law.observer is not None:
        law.require_step(step)
        return observed_loop(plant, law, feedback, mode, row).growth_rate(step)
    return constant_growth(plant, feedback, mode, row)


def constant_growth(plant: SwitchedSystem, feedback: Feedback, mode: int, row: int) -> float:
    """The growth rate of a mode under a row of a table, 1/s, to about 1e-9 of it or of the pace."""
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
    """Proved lower and upper bounds of the growth rate in one mode, 1/s.

    Computed in ball arithmetic on the characteristic polynomial of the lifted loop
    (`spectrum.growth`), for the matrices and the law's table as stored, binary64, and the pieces of
    a period as in `simulate`. The bounds are about 1e-11/D apart; if both have one sign, they prove
    that the loop grows, or decays, in this mode.

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
        As by `growth_rate`; also if the order of the loop, n + N m, or n + N (q + m) for a law with
        q controller states, is above 3,000. An order of 1,000 takes about a second.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> law = dt.AveragedPredictor(problem.plant, problem.gains)
    >>> low, high = growth_bounds(problem.plant, law, mode=1)
    >>> 0.0 < low < high < low + 1e-10, round(low, 9), round(high, 9)
    (True, 0.281670215, 0.281670215)
    """
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
    """The predicate of "the loop" in sentences about a constant mode that does not decay.

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
            "step must be given: the characteristic roots of the ideal loop could not be separated"
            f": the law's gains are too large over a delay of {law.plant.longest_delay:g} s."
        )
    return float(found.roots[0].real)


BITS = (256, 512, 1024, 2048)
NARROW = 1e-11  # of the rate or the plant's pace: the gap of the bounds at which bits suffice
LARGEST = 3000  # order; a second at 1,000
LOWER = 64  # coefficients that are tried for the lower bound


def enclose_growth(
    plant: SwitchedSystem, feedback: Feedback, mode: int, row: int
) -> tuple[float, float]:
    """(low, high), 1/s: proved bounds of ln(spectral radius)/h of a mode under a row."""
    low, high, pace = -math.inf, math.inf, pace_of(plant)
    for bits in BITS:
        with precision(bits):
            p = _coefficients(plant, feedback, mode, row)
            closer = _bounds(p, feedback.step, pace)
        low, high = max(low, closer[0]), min(high, closer[1])
        if high - low <= NARROW * max(pace, abs(high)) or high == -math.inf:
            break
    return low, high


def exact_matrix(X: np.ndarray) -> Any:
    """A float matrix as balls without a radius."""
    from flint import arb_mat

    X = np.atleast_2d(X)
    return arb_mat(X.shape[0], X.shape[1], X.ravel().tolist())


def exact_discretisation(A: np.ndarray, B: np.ndarray, tau: Any) -> tuple[Any, Any]:
    """Balls of e^{Aτ} and ∫₀^τ e^{As} ds B, A and B as stored, τ a ball or a float."""
    from flint import arb, arb_mat

    n, m = B.shape
    Z = np.zeros((n + m, n + m))
    Z[:n, :n], Z[:n, n:] = A, B
    whole = (exact_matrix(Z) * arb(tau)).exp().tolist()[:n]
    return arb_mat([row[:n] for row in whole]), arb_mat([row[n:] for row in whole])


def exact_period(
    plant: SwitchedSystem, parts: Iterable[tuple[int, float, float, np.ndarray]]
) -> tuple[Any, dict[int, Any]]:
    """Balls of Φ and of Γ by lag of a period, from its parts (mode, start, stop, lags)."""
    from flint import arb, arb_mat

    n, m = plant.B.shape[1:]
    whole, arrived = exact_matrix(np.eye(n)), dict[int, Any]()
    for mode, start, stop, lags in parts:
        Phi, Gamma = exact_discretisation(plant.A[mode], plant.B[mode], arb(stop) - arb(start))
        whole, arrived = Phi * whole, {lag: Phi * old for lag, old in arrived.items()}
        for lag in set(lags.tolist()):
            own = exact_matrix(np.diag((lags == lag).astype(float)))
            arrived[lag] = arrived.get(lag, arb_mat(n, m)) + Gamma * own
    return whole, arrived


def _coefficients(plant: SwitchedSystem, feedback: Feedback, mode: int, row: int) -> list[Any]:
    """p_0 = 1, p_1, …, p_d in balls."""
    from flint import acb, acb_mat, arb

    stretches = SampledPlant(plant, feedback.step).stretches(mode)
    parts = [(mode, start, stop, lags) for start, stop, lags in stretches]
    whole, arrived = exact_period(plant, parts)
    Phi, arriving = whole.tolist(), {lag: part.tolist() for lag, part in arrived.items()}
    F, G = feedback.state_gain[row], feedback.input_gain[row]
    n, m = plant.B.shape[1:]
    order = n + max(*arriving, feedback.taps) * m
    size = 1 << order.bit_length()
    taps = [[_transform(G[:, i, j], size, float(i == j)) for j in range(m)] for i in range(m)]
    gains = [[acb(-float(F[i, j])) for j in range(n)] for i in range(m)]
    values = []
    for k in range(size):
        t = acb(arb(-2 * k) / size).exp_pi_i()
        old = {lag: acb(arb(-2 * (k * (lag + 1) % size)) / size).exp_pi_i() for lag in arriving}
        table = [[float(i == j) - t * Phi[i][j] for j in range(n)] for i in range(n)]
        for i in range(n):
            table[i] += [
                -sum(old[lag] * Gamma[i][j] for lag, Gamma in arriving.items()) for j in range(m)
            ]
        table += [gains[i] + [taps[i][j][k] for j in range(m)] for i in range(m)]
        values.append(acb_mat(table).det())
    return [value.real for value in acb.dft(values, inverse=True)[: order + 1]]


def _transform(g: np.ndarray, size: int, one: float) -> list[Any]:
    """one − Σ_j g_j t^j at the points t = e^{−2πik/size}."""
    from flint import acb

    padded = [one, *(-g).tolist()] + [0.0] * (size - 1 - g.size)
    return acb.dft([acb(value) for value in padded])


def _bounds(p: list[Any], step: float, pace: float) -> tuple[float, float]:
    """Graeffe's iteration until the bounds are close, or widen because the balls have grown."""
    order, narrow = len(p) - 1, NARROW * pace
    low, high = -math.inf, math.inf
    for k in range(1, 2 + math.ceil(math.log2(8.0 * (1.0 + math.log(order)) / (narrow * step)))):
        p = _square(p)
        lower, upper = _between(p, order, 2**k, step)
        worn = lower < low - narrow
        low, high = max(low, lower), min(high, upper)
        if worn or high - low <= 0.5 * max(narrow, NARROW * abs(high)):
            break
    return low, high


def _square(p: list[Any]) -> list[Any]:
    """p(t) p(−t) as a polynomial in t²: even part² − t odd part²."""
    from flint import arb_poly

    even, odd = arb_poly(p[0::2]), arb_poly(p[1::2])
    q = (even * even - (odd * odd).left_shift(1)).coeffs()
    return q + [p[0] * 0] * (len(p) - len(q))


def _between(p: list[Any], order: int, power: int, step: float) -> tuple[float, float]:
    """Bounds of ln(ρ)/h from the coefficients of det(I − t L^power)."""
    from flint import arb

    low = high = -math.inf
    time, two = arb(step) * power, arb(2).log()
    for i, ball in enumerate(p[1:], 1):
        size = abs(ball)
        above, below = size.abs_upper(), size.abs_lower()
        if above > 0:
            high = max(high, _up((above.log() / i + two) / time))
        if i <= LOWER and below > 0:
            low = max(low, -_up((arb(math.comb(order, i)).log() - below.log()) / i / time))
    return low, high


def _up(ball: Any) -> float:
    """A float above the ball."""
    return float(np.nextafter(float(ball.upper()), np.inf))
