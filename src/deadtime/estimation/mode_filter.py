"""ModeFilter: how likely each mode is, from states and past inputs, where nobody measures it.

Derived in docs/theory/mode-filter.md. Signs, lags and pieces are those of `deadtime.plant`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from deadtime.base.checks import count, instance, number, read_only, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.estimation.filter_arguments import (
    deviation,
    first_belief,
    intensities,
    require_distinct,
)
from deadtime.estimation.running_filter import RunningFilter
from deadtime.feedback.belief import Belief, frozen, held_noise
from deadtime.numerics.covariance import noise_covariances, switched_covariances
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.switching import SwitchingModel
from deadtime.switching.models.model import require_model


@dataclass(frozen=True, eq=False, init=False, repr=False)
class ModeFilter(Frozen):
    """The belief over the modes of a plant of which x is measured and the mode is not (immutable).

        π_k(j) ∝ Σ_i π_{k−1}(i) P_ij p(x_k | x_{k−1}, inputs, i then j),    P: the model at samples

    p is normal about what the model predicts over a period in mode i; of a switch within it, about
    the middle of what i and j predict, and as much wider as its instant is unknown. Where age
    matters, as under a `SemiMarkov` model, the belief is over modes and ages.

    Parameters
    ----------
    plant : SwitchedSystem
        The filter's model of the plant; any delays.
    model : switching model
        How the mode switches.
    step : float
        Sampling period h, in seconds.
    disturbance : array_like
        W of `imperfections.WhiteDisturbance(W)`, x² per second: a number for number·I, (n,) for a
        diagonal, (n, n), or (modes, n, n) where modes have their own. A noise of s √h per period
        and state is W = s².
    noise : array_like
        Standard deviation of `imperfections.Noise`, in units of x: a number or (n,).
    switches : "anywhere" or "samples", optional
        Whether the plant switches within periods, treated to first order in h, or at samples only,
        which is then exact; by default as the model does.
    forgetting : float
        The part of the belief, in (0, 1), that all modes share alike after every sample, so that
        none is ever ruled out.
    initial : array_like, shape (modes,) or (modes, ages), optional
        The belief at the first sample; by default as the model's signals begin, every mode alike,
        just begun.
    ages : int, optional
        The most ages, in samples, that are told apart where age matters; older ones count as that
        old. By default as many as matter to the model (`SwitchingModel.ages`).
    allow_alike : bool
        Accept modes that nothing in x tells apart: they share what the switching model gives them.

    Attributes
    ----------
    ages : int
        How many ages the switching model needs; 1 where age says nothing.

    Raises
    ------
    ArgumentError
        If two modes cannot be told apart, an argument is malformed, or the model cannot be sampled
        at the step.

    References
    ----------
    Elliott, Aggoun and Moore, "Hidden Markov Models", Springer 1995, chapter 3, for states and
    switches at samples; the rest is derived in docs/theory/mode-filter.md.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> model = dt.Markov([[0.0, 2.0], [1.0, 0.0]])
    >>> filt = dt.ModeFilter(problem.plant, model, step=0.02, disturbance=1e-4)
    >>> filt
    ModeFilter(modes=2, ages=1, step=0.02, switches='anywhere')
    >>> running = filt.start()
    >>> running.update([1.0, 1.0]), running.update([1.061, 1.0202]).round(3)
    (array([0.5, 0.5]), array([0.995, 0.005]))
    """

    plant: SwitchedSystem
    model: SwitchingModel
    step: float
    disturbance: Float[np.ndarray, "*mode n n"]
    noise: Float[np.ndarray, " n"]
    switches: str
    forgetting: float
    initial: Float[np.ndarray, "mode age"]
    ages: int

    def __init__(
        self,
        plant: SwitchedSystem,
        model: SwitchingModel,
        step: float,
        *,
        disturbance: ArrayLike = 0.0,
        noise: ArrayLike = 0.0,
        switches: str | None = None,
        forgetting: float = 1e-9,
        initial: ArrayLike | None = None,
        ages: int | None = None,
        allow_alike: bool = False,
    ) -> None:
        instance("plant", plant, SwitchedSystem)
        require_model(model, plant.modes)
        step = SampledPlant.of(plant, step).step
        if switches not in (None, "anywhere", "samples"):
            raise ArgumentError(f'switches must be "anywhere" or "samples", got {switches!r}.')
        forgetting = number("forgetting", forgetting)
        if not 0.0 < forgetting < 1.0:
            raise ArgumentError(f"forgetting must be in (0, 1), got {forgetting:g}.")
        if not allow_alike:
            require_distinct(plant)
        own = model.ages(step, None if ages is None else count("ages", ages))
        if own is None and ages not in (None, 1):
            raise ArgumentError(
                f"ages must be left out of a {type(model).__name__} model, in which age says "
                "nothing."
            )
        own = own or 1
        if switches is None:
            switches = "anywhere" if model.chain(step, own).within else "samples"
        vars(self).update(
            plant=plant,
            model=model,
            step=step,
            disturbance=intensities(disturbance, plant.modes, plant.states),
            noise=deviation(noise, plant.states),
            switches=switches,
            forgetting=forgetting,
            initial=read_only(first_belief(initial, plant.modes, own)),
            ages=own,
        )

    def belief(self, ages: int = 1) -> Belief:
        """Its data for compiled loops, telling apart at least so many ages.

        Parameters
        ----------
        ages : int
            As many as a law's table has; those past the model's own repeat its last hazard.
        """
        ages, modes = max(count("ages", ages), self.ages), self.plant.modes
        sampled = SampledPlant.of(self.plant, self.step)
        Phi, Gamma, lag = sampled.periods()
        start = np.zeros((modes, ages))
        start[:, : self.ages] = self.initial
        chain = self.model.chain(self.step, self.ages)
        last = np.repeat(chain.hazard[:, -1:], ages - self.ages, axis=1)
        hazard = np.hstack((chain.hazard, last))
        within = self.switches == "anywhere"
        bend = _bend(sampled, Phi, Gamma, lag) if within else (Phi[:0, None], Gamma[:0, None])
        parts = start, Phi, Gamma, lag, self._covariance(Phi), hazard, chain.jump
        return frozen(Belief(*parts, self.forgetting, within, *bend))

    def _covariance(self, Phi: np.ndarray) -> Float[np.ndarray, "mode end n n"]:
        """Of x_{k+1} − Φ_i x_k, both as they are measured, by the mode at the end if it matters.

        Φ_i R Φ_iᵀ is the mean over the modes: else, where the noise hides x, the mode in which it
        grows least would be the likeliest.
        """
        A, W, R = self.plant.A, self.disturbance, np.diag(self.noise**2)
        Q = noise_covariances(A, W, np.full(len(A), self.step))[:, None]
        if W.ndim == 3 and self.switches == "anywhere":
            held, Q = Q[:, 0], switched_covariances(A, W, self.step)
            each = np.arange(len(A))
            Q[each, each] = held
        return Q + R + (Phi @ R @ Phi.transpose(0, 2, 1)).mean(axis=0)

    def start(self, u0: ArrayLike | None = None) -> RunningFilter:
        """The filter, ready to be called once a period.

        Parameters
        ----------
        u0 : array_like, shape (m, N), optional
            The inputs in flight at the first sample, oldest first, N = `longest_lag`; 0 by default.
        """
        return RunningFilter(self.belief(), u0)

    def separation(self, x: ArrayLike, inputs: ArrayLike | None = None) -> np.ndarray:
        """How many standard deviations apart the modes' predictions over a period are, from x on.

        Below about 1 a single period tells little; with no noise at all the numbers are large.

        Parameters
        ----------
        x : array_like, shape (n,)
        inputs : array_like, shape (m,), optional
            What acts all through the period; 0 by default.

        Returns
        -------
        (modes, modes) array
            Of the predictions of i and j by the noise in mode i; 0 where they are the same.

        Examples
        --------
        >>> import deadtime as dt
        >>> plant = dt.problems.paper().plant
        >>> filt = dt.ModeFilter(plant, dt.Markov([[0, 1], [1, 0]]), 0.02, disturbance=1e-4)
        >>> filt.separation([1.0, 1.0]).round(2)
        array([[0.  , 6.84],
               [6.82, 0.  ]])
        """
        n, m = self.plant.states, self.plant.inputs
        x = require_shape("x", real_array("x", x, "(n,)", 1), (n,), "(n,)")
        given = np.zeros(m) if inputs is None else inputs
        u = require_shape("inputs", real_array("inputs", given, "(m,)", 1), (m,), "(m,)")
        from deadtime.loop.belief_steps import eliminate, factor

        form = self.belief()
        ahead = form.Phi @ x + form.Gamma.sum(axis=1) @ u
        size = (np.abs(form.Phi) @ np.abs(x) + np.abs(form.Gamma).sum(axis=1) @ np.abs(u)).max(0)
        result, root = np.zeros((len(ahead), len(ahead))), np.empty((n, n))
        noise = held_noise(form)
        for i, j in np.ndindex(result.shape):
            factor.function(noise[i], size, np.zeros(n), root)
            apart = ahead[j] - ahead[i]
            eliminate.function(root, apart)
            result[i, j] = math.sqrt(apart @ (np.diagonal(root) * apart))
        return result

    @property
    def longest_lag(self) -> int:
        """N: no input older than u_{k−N} acts in period k of the model."""
        return SampledPlant.of(self.plant, self.step).longest_lag

    def __repr__(self) -> str:
        return (
            f"ModeFilter(modes={self.plant.modes}, ages={self.ages}, step={self.step:g}, "
            f"switches={self.switches!r})"
        )


def _bend(
    sampled: SampledPlant,
    Phi: Float[np.ndarray, "mode n n"],
    Gamma: Float[np.ndarray, "mode lag n m"],
    lag: Int[np.ndarray, " lag"],
) -> tuple[Float[np.ndarray, "mode mode n n"], Float[np.ndarray, "mode mode lag n m"]]:
    """Ψ and Ω of a `Belief`: a change in the middle of a period, less the mean of both modes."""
    bend_x, bend_u = -0.5 * (Phi[:, None] + Phi), -0.5 * (Gamma[:, None] + Gamma)
    for i, j in np.ndindex(bend_x.shape[:2]):
        if i == j:
            bend_x[i, i], bend_u[i, i] = 0.0, 0.0
            continue
        period = sampled.cut_period(i, j, 0.5 * sampled.step)
        bend_x[i, j] += period.Phi
        bend_u[i, j, np.searchsorted(-lag, -np.array(period.lags))] += period.Gamma
    return bend_x, bend_u
