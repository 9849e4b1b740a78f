"""The mode belief, and a bank of Kalman filters with one, as arrays for compiled loops.

The hidden chain is c = (mode, age), with age the samples since the sampled mode last changed; the
last age includes all older ones. Over the period from t_{k−1} to t_k mode i continues with
probability 1 − hazard or switches to j with hazard·jump_ij; each case is weighted by the density of
the measured x_k (`loop/belief_steps.py`; docs/theory/mode-filter.md):

    π_k(i, a + 1) ∝ π_{k−1}(i, a) (1 − hazard_i,a) p_ii,
    π_k(j, 0)     ∝ Σ_i Σ_a π_{k−1}(i, a) hazard_i,a jump_ij p_ij.

A Markov chain is the case of one age.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import read_only
from deadtime.base.frozen import Frozen
from deadtime.plant import SampledPlant, SwitchedSystem


class Belief(NamedTuple):
    """The constants of a belief update.

    start : (modes, ages), π_0
    Phi : (modes, n, n), Gamma : (modes, lags, n, m), lag : (lags,): the model over a whole period
        in each mode, x_{k+1} = Φ_i x_k + Σ_l Γ_i,l u_{k−lag_l}
    noise : (modes, ends, n, n), the covariance of x_{k+1} about that, by the mode in which the
        period ends if it matters, else with ends = 1
    hazard : (modes, ages), the probability that a mode of that age ends by the next sample
    jump : (modes, modes), the probabilities of the next mode, rows sum to 1
    forgetting : the share of π that is spread evenly over all modes after every sample
    within : whether a mode may end within a period, or at samples only
    bend_x : (modes, modes, n, n), bend_u : (modes, modes, lags, n, m), if modes end within
        periods: x_{k+1} after a switch from i to j in the middle of the period minus the mean of
        the predictions of i and j is Ψ_ij x_k + Σ_l Ω_ij,l u_{k−lag_l}; else empty
    """

    start: Float[np.ndarray, "mode age"]
    Phi: Float[np.ndarray, "mode n n"]
    Gamma: Float[np.ndarray, "mode lag n m"]
    lag: Int[np.ndarray, " lag"]
    noise: Float[np.ndarray, "mode end n n"]
    hazard: Float[np.ndarray, "mode age"]
    jump: Float[np.ndarray, "mode mode"]
    forgetting: float
    within: bool
    bend_x: Float[np.ndarray, "first second n n"]
    bend_u: Float[np.ndarray, "first second lag n m"]

    @property
    def chain(self) -> Belief:
        """Itself, as a bank has one."""
        return self

    @property
    def bank(self) -> None:
        """None: it is updated by states."""


class UpdateWithBelief(ABC):
    """An `Update` that keeps a belief over the modes in place of a reported mode.

    Attributes
    ----------
    beliefs : list of (modes,) arrays
        Its belief after every call.
    """

    beliefs: list[np.ndarray]


def held_noise(belief: Belief) -> Float[np.ndarray, "mode n n"]:
    """The covariance of a period that is spent in one mode."""
    return np.stack([by_end[min(i, len(by_end) - 1)] for i, by_end in enumerate(belief.noise)])


class BankForm(NamedTuple):
    """The constants of the update of a filter bank.

    chain : Belief, its noise the covariance that a period adds to x
    C : (modes, p, n), variance : (p,), of y about C x
    gain : (modes, n, p) of observers, or (modes, n, 0) for Kalman gains
    estimate : (n,), covariance : (n, n), of x_0 in every mode
    """

    chain: Belief
    C: Float[np.ndarray, "mode p n"]
    variance: Float[np.ndarray, " p"]
    gain: Float[np.ndarray, "mode n p_or_0"]
    estimate: Float[np.ndarray, " n"]
    covariance: Float[np.ndarray, "n n"]

    @property
    def bank(self) -> BankForm:
        """Itself: it is updated by outputs."""
        return self


BeliefForm = Belief | BankForm
_Form = TypeVar("_Form", Belief, BankForm)


def frozen(form: _Form) -> _Form:
    """A belief or a bank with read-only arrays: one type for compiled loops."""
    return form._make(read_only(one) if isinstance(one, np.ndarray) else one for one in form)


@dataclass(frozen=True, eq=False, repr=False)
class BeliefFilter(Frozen, ABC):
    """A filter that keeps a belief over the modes at samples, as laws and controllers use it.

    Attributes
    ----------
    plant : SwitchedSystem
        The filter's model of the plant.
    step : float
        Sampling period h, in seconds.
    disturbance : (n, n) or (modes, n, n) array
        W of the white noise that it assumes, x² per second.
    outputs : (modes, p, n) array or None
        C of what is measured; None for the whole state.
    """

    plant: SwitchedSystem
    step: float
    disturbance: Float[np.ndarray, "*mode n n"]
    outputs: Float[np.ndarray, "mode p n"] | None

    @abstractmethod
    def form(self, ages: int = 1) -> BeliefForm:
        """Its data for compiled loops, with at least so many ages.

        Parameters
        ----------
        ages : int
            As many as a law's table has; those past the model's own repeat its last hazard.
        """

    @property
    def longest_lag(self) -> int:
        """N: no input older than u_{k−N} acts in period k of the model."""
        return SampledPlant.of(self.plant, self.step).longest_lag
