"""The stability theorem of the averaged predictor feedback, as numbers.

Theorem 2.1 of arXiv 2503.08446: if the modes and the gains differ by less than ε*, the loop of
the plant with the averaged law, updated continuously, satisfies, for every switching signal
with the dwell time,

    |X(t)| + √∫|U|² ≤ ρ e^{−ξt} (|X(0)| + √∫|U₀|²)        (integrals over the last D seconds)

Norms are Euclidean and spectral. ε ≥ ε* says nothing: the condition is sufficient only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import number, positive
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import rounded
from deadtime.certificates.theorem.constants import (
    Constants,
    FunctionalConstants,
    distance,
    paper_constants,
)
from deadtime.certificates.theorem.sharp import own_delay_constants, sharp_constants
from deadtime.gains import CommonLyapunov, common_lyapunov
from deadtime.gains.lyapunov import check_lyapunov, hurwitz_gains
from deadtime.numerics.logarithms import exp, log
from deadtime.plant import SwitchedSystem

FORMS = ("printed", "corrected", "sharp")
_PER_DECADE = 1.0 / math.log(10.0)


@dataclass(frozen=True, eq=False, repr=False)
class TheoremBound:
    r"""The constants of the theorem for one plant (immutable).

    A number that overflows is inf, one that underflows 0.0; `log10_…` stays accurate.

    Attributes
    ----------
    form : str
        "printed", "corrected" or "sharp". Only the last two are theorems.
    epsilon, epsilon_star : float
        The distance :math:`\varepsilon` of modes and gains, equation (5), and its bound
        :math:`\varepsilon^*`, equation (62).
    nu1, nu2 : float or None
        Constants of :math:`\int |U|^2 \le \nu_1 (|X|^2 + \int |W|^2)`, equation (56), and of the
        reverse, equation (57).
    kappa : float or None
        :math:`|X|^2 + \int |W|^2` decays like :math:`\kappa e^{-\mu t}`, equation (63).
    b, weight : float or None
        Of :math:`V = X^T P X + b \int e^{c (\theta + D - t)} |W|^2`, equation (64); the weight
        :math:`c` is 1 in the paper, 1/s. None with several delays, as are :math:`\nu_1`,
        :math:`\nu_2` and :math:`\kappa`: the proof there has no such functional.
    mu, rho, xi : float or None
        Rates and overshoot, equations (73) and (75); None when they do not exist, and `message`
        says why.
    holds : bool
        :math:`\varepsilon < \varepsilon^*`.
    lyapunov : CommonLyapunov
        The P and Q of the constants.
    message : str
        The result in a sentence.
    """

    form: str
    epsilon: float
    epsilon_star: float
    nu1: float | None
    nu2: float | None
    kappa: float | None
    b: float | None
    weight: float | None
    mu: float | None
    rho: float | None
    xi: float | None
    holds: bool
    log10_epsilon_star: float
    log10_nu1: float | None
    log10_nu2: float | None
    log10_kappa: float | None
    log10_rho: float | None
    lyapunov: CommonLyapunov
    message: str
    constants: Constants = field(repr=False)

    def delta1(self, eps: float) -> float:
        r"""Constant of :math:`|W| \le \delta_1 |X| + \delta_2 \int |U|`, equation (47)."""
        return exp(self.constants.log_delta1(_log_distance(eps)))

    def delta2(self, eps: float) -> float:
        r"""Constant :math:`\delta_2(\varepsilon)`, equation (54)."""
        return exp(self.constants.log_delta2(_log_distance(eps)))

    def lam(self, eps: float) -> float:
        r"""The larger of :math:`\delta_1` and :math:`\delta_2`, equation (55)."""
        return exp(self.constants.log_lambda(_log_distance(eps)))

    def __repr__(self) -> str:
        return f"TheoremBound({self.form}: {self.message})"


def theorem_bound(
    plant: SwitchedSystem,
    gains: ArrayLike,
    dwell_time: float,
    lyapunov: CommonLyapunov | tuple[ArrayLike, ArrayLike] | None = None,
    form: str = "corrected",
) -> TheoremBound:
    r"""The constants of the stability theorem of the averaged predictor feedback.

    Parameters
    ----------
    plant : SwitchedSystem
        The plant, its delay included: one for all modes and inputs, as the theorem has it; or, for
        "sharp", one per input.
    gains : array_like, shape (modes, m, n)
        :math:`K_i` of :math:`u = +K_i x`, every :math:`A_i + B_i K_i` Hurwitz.
    dwell_time : float
        :math:`\tau_d > 0`, in seconds. The sharp constants do not depend on it.
    lyapunov : CommonLyapunov or (P, Q), optional
        P and Q of inequality (4): matrices, their diagonals or numbers times the identity.
        Default: `common_lyapunov`; for "sharp" the best of a range of common P.
    form : {"corrected", "printed", "sharp"}
        "printed": as the text has them, errors included, for comparison only. "corrected": the
        errors corrected. "sharp": better constants for the same statement
        (docs/theory/constants.md).

    Returns
    -------
    TheoremBound
        A proof of stability of the ideal loop if `holds`, rounding errors of the constants
        aside; no statement otherwise.

    Raises
    ------
    ArgumentError
        If modes differ in the delay of an input, or inputs have several and the form is not
        "sharp"; the gains do not stabilise each mode, the dwell time is not positive, the form is
        unknown, no input acts, or the given P and Q are not definite or violate (4).
    InfeasibleError
        If no common P exists.

    References
    ----------
    A. Katsanikakis and N. Bekiaris-Liberis, arXiv 2503.08446, Theorem 2.1 and Lemmas 2.6 to 2.8.

    Examples
    --------
    >>> import deadtime as dt
    >>> from deadtime.certificates import theorem_bound
    >>> problem = dt.problems.paper()
    >>> bound = theorem_bound(problem.plant, problem.gains, dwell_time=0.2)
    >>> f"{bound.epsilon:.4f} {bound.epsilon_star:.2e} {bound.nu1:.2e} {bound.holds}"
    '0.7895 1.74e-14 1.73e+15 False'
    """
    K = hurwitz_gains(plant, gains)
    dwell_time = positive("dwell_time", dwell_time)
    if form not in FORMS:
        raise ArgumentError(f"form must be one of {', '.join(map(repr, FORMS))}, got {form!r}.")
    if not plant.B.any():
        raise ArgumentError("plant.B is zero in every mode: no input acts on the plant.")
    stated = stated_forms(plant)
    if not stated:
        raise ArgumentError(
            "plant must have the same delays in all modes for theorem_bound, got "
            f"delay={plant.delay_text}: the theorem depends on the distance ε of the modes' "
            "matrices, and modes with the same matrices, ε = 0, may grow where their delays "
            "differ. Use certify for this loop."
        )
    if form not in stated:
        raise ArgumentError(
            f"form must be 'sharp' where inputs have several delays, got {form!r}, which is a "
            "theorem of one delay: its Lemma 2.4 writes x(t + D) as a functional of X(t) and of "
            "past inputs, and with a second delay it depends on future inputs, too."
        )
    pair = None if lyapunov is None else check_lyapunov(plant, K, lyapunov)
    if not plant.has_one_delay:
        constants: Constants = own_delay_constants(plant, K, pair)
    elif form == "sharp":
        constants = sharp_constants(plant, K, pair)
    else:
        pair = common_lyapunov(plant, K) if pair is None else pair
        constants = paper_constants(plant, K, dwell_time, pair, form == "corrected")
    epsilon, star = distance(plant, K), constants.log_epsilon_star
    x = log(epsilon)
    holds = x < star
    mu = constants.decay(x) if holds else None
    if mu is not None and mu <= 0.0:
        # The printed ε* does not suffice for (71); in the other forms only rounding leads here.
        mu, holds = None, form == "printed"
    log_rho = None if mu is None else constants.log_rho(x)
    functional = constants if isinstance(constants, FunctionalConstants) else None
    logs = {name: getattr(functional, f"log_{name}", None) for name in ("nu1", "nu2", "kappa")}
    return TheoremBound(
        form=form,
        epsilon=epsilon,
        epsilon_star=exp(star),
        **{name: None if value is None else exp(value) for name, value in logs.items()},
        b=None if functional is None else exp(functional.log_b),
        weight=None if functional is None else functional.weight,
        mu=mu,
        rho=None if log_rho is None else exp(log_rho),
        xi=None if mu is None else 0.5 * mu,
        holds=holds,
        log10_epsilon_star=star * _PER_DECADE,
        log10_nu1=_decades(logs["nu1"]),
        log10_nu2=_decades(logs["nu2"]),
        log10_kappa=_decades(logs["kappa"]),
        log10_rho=_decades(log_rho),
        lyapunov=constants.lyapunov,
        message=_message(epsilon, star * _PER_DECADE, holds, mu),
        constants=constants,
    )


def _decades(log: float | None) -> float | None:
    return None if log is None else log * _PER_DECADE


def stated_forms(plant: SwitchedSystem) -> tuple[str, ...]:
    """The forms of the theorem for a plant with these delays."""
    if plant.has_one_delay:
        return FORMS
    return ("sharp",) if plant.modes_share_delays else ()


def _message(epsilon: float, log10_star: float, holds: bool, mu: float | None) -> str:
    star = f"ε* = 10^{log10_star:.4g}" if math.isfinite(log10_star) else "ε* = ∞"
    if not holds:
        return (
            f"ε = {epsilon:.4g} ≥ {star}: the theorem does not apply, so μ, ρ and ξ do not "
            "exist; it does not say that the loop is unstable."
        )
    if mu is None:
        return (
            f"ε = {epsilon:.4g} < {star}, but (71) fails, so μ, ρ and ξ do not exist: "
            "this ε* lacks the + 1 of D ν₁ + 1."
        )
    return f"ε = {epsilon:.4g} < {star}: the loop decays, with ξ = {rounded(0.5 * mu, 4)} 1/s."


def _log_distance(eps: float) -> float:
    value = number("eps", eps)
    if value < 0.0:
        raise ArgumentError(f"eps must be at least 0, got {value:g}.")
    return log(float(np.abs(value)))
