"""Growth rates between bounds that hold beyond round-off: the characteristic polynomial in balls.

In t = 1/z the digital loop of one mode (`deadtime.spectrum.lifted`, L of order d) has

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

from deadtime.feedback import Feedback
from deadtime.numerics.precision import precision
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.spectrum.loop_units import pace_of

BITS = (256, 512, 1024, 2048)
NARROW = 1e-11  # of the rate or the plant's pace: bounds closer than this are close enough
LARGEST = 3000  # order; a second at 1,000
LOWER = 64  # so many coefficients are tried for the lower bound


def enclose_growth(
    plant: SwitchedSystem, feedback: Feedback, mode: int, row: int
) -> tuple[float, float]:
    """(low, high), 1/s: ln(spectral radius)/h of a mode under a row lies between, beyond doubt."""
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
    """Balls of Φ, and of Γ by lag, over parts of a period: mode, start, stop and lags of each."""
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
    """Graeffe's iteration until the bounds close, or the balls grow faster than they do."""
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
