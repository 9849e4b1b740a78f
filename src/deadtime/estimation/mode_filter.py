"""ModeFilter: the probability of each mode, from states and past inputs.

Derived in docs/theory/mode-filter.md. Signs, lags and pieces are those of `deadtime.plant`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from deadtime.base.checks import (
    as_floats,
    count,
    instance,
    read_only,
    real_array,
    require_shape,
    share,
)
from deadtime.base.errors import ArgumentError
from deadtime.estimation.running_filter import RunningFilter
from deadtime.feedback.belief import Belief, BeliefFilter, frozen
from deadtime.loop.running_belief import belief_of
from deadtime.numerics.covariance import noise_covariances, switched_covariances
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.weight import intensities
from deadtime.switching import SwitchingModel
from deadtime.switching.models.model import require_model

_ALIKE = 1e-9  # relative to an entry: modes whose entries all differ by less are the same


def require_distinct(plant: SwitchedSystem) -> None:
    """Refuse two modes with the same A, B and delays."""
    for i in range(plant.modes):
        for j in range(i):
            pairs = ((plant.A[i], plant.A[j]), (plant.B[i], plant.B[j]))
            same = all(_alike(one, other) for one, other in pairs)
            # The delay of an input without effect (a zero column of B) cannot be observed.
            acts = (plant.B[i] != 0.0).any(axis=0)
            if same and _alike(plant.delays[i][acts], plant.delays[j][acts]):
                raise ArgumentError(
                    f"modes {j} and {i} cannot be distinguished: A, B and delays are the same, so "
                    "x shows the same in both. Make one mode of them, or allow_alike = True: then "
                    "they share what the switching model gives them."
                )


def require_distinct_outputs(plant: SwitchedSystem, C: Float[np.ndarray, "mode p n"]) -> None:
    """Refuse two modes in which the same x and u give the same outputs at all times.

    By the Cayley-Hamilton theorem for both modes together it suffices to compare C A^k and C A^k B
    for k < 2n, and the delays of inputs that reach the outputs.
    """
    responses, n = [_responses(A, own) for A, own in zip(plant.A, C, strict=True)], plant.states
    for i in range(plant.modes):
        for j in range(i):
            (one, size), (other, its) = responses[i], responses[j]
            most = np.maximum(size, its)
            same = (np.abs(one - other) <= _ALIKE * most).all()
            acting = [one @ plant.B[i], other @ plant.B[j]]
            # A bound of the terms, not of their sum, in which they may cancel.
            least = _ALIKE * most @ np.maximum(np.abs(plant.B[i]), np.abs(plant.B[j]))
            same &= (np.abs(acting[0] - acting[1]) <= least).all()
            acts = (np.abs(acting[0]) > least).any(axis=0)
            if same and _alike(plant.delays[i][acts], plant.delays[j][acts]):
                raise ArgumentError(
                    f"modes {j} and {i} cannot be distinguished. The same state and inputs give "
                    f"the same outputs in both: C A^k and C A^k B up to k = {2 * n - 1}, and "
                    "delays. Measure more, make one mode of them, or allow_alike = True: then they "
                    "share what the switching model gives them."
                )


def _responses(
    A: Float[np.ndarray, "n n"], C: Float[np.ndarray, "p n"]
) -> tuple[np.ndarray, np.ndarray]:
    """C A^k for k < 2n, stacked, and |C| |A|^k, the scale of the round-off in each entry."""
    rows, sizes = [C], [np.abs(C)]
    for _ in range(2 * len(A) - 1):
        rows.append(rows[-1] @ A)
        sizes.append(sizes[-1] @ np.abs(A))
    return np.concatenate(rows), np.concatenate(sizes)


def _alike(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether all entries agree, each relative to its own size: units do not matter."""
    return bool((np.abs(one - other) <= _ALIKE * np.maximum(np.abs(one), np.abs(other))).all())


def deviation(value: ArrayLike, size: int, letter: str = "n") -> Float[np.ndarray, " size"]:
    """A standard deviation per state, or per output."""
    form = f"({letter},)"
    given = as_floats("noise", value, f"one or {form}")
    whole = real_array("noise", np.full(size, given) if given.ndim == 0 else given, form, 1)
    if require_shape("noise", whole, (size,), form).min() < 0.0:
        raise ArgumentError(f"noise must be ≥ 0, a standard deviation, got {whole.tolist()}.")
    return whole


@dataclass(frozen=True, eq=False, init=False, repr=False)
class ModeFilter(BeliefFilter):
    r"""The belief over the modes of a plant whose state, not its mode, is measured (immutable).

    .. math::

        \pi_k(j) \propto \sum_i \pi_{k-1}(i) P_{ij} \,
        p(x_k \mid x_{k-1}, \text{inputs}, i \text{ then } j)

    with :math:`P` the model at samples. :math:`p` is normal about the prediction of the model
    over a period in mode i; for a switch within the period it is normal about the mean of the
    predictions of i and j, and wider, since the instant is unknown. If age matters, as under a
    `SemiMarkov` model, the belief is over modes and ages.

    Parameters
    ----------
    plant : SwitchedSystem
        The filter's model of the plant; any delays.
    model : switching model
        How the mode switches.
    step : float
        Sampling period h, in seconds.
    disturbance : array_like
        :math:`W` of `imperfections.WhiteDisturbance`, :math:`x^2` per second: a number for number
        times :math:`I`, (n,) for a diagonal, (n, n), or (modes, n, n) where modes have their own. A
        noise of :math:`s \sqrt h` per period and state is :math:`W = s^2`.
    noise : array_like
        Standard deviation of `imperfections.Noise`, in units of x: a number or (n,).
    switches : "anywhere" or "samples", optional
        Whether the plant switches within periods, treated to first order in h, or at samples only,
        which is then exact; by default as the model does.
    forgetting : float
        The share of the belief, in (0, 1), that is spread evenly over all modes after every
        sample, so that no mode is ever ruled out.
    initial : array_like, shape (modes,) or (modes, ages), optional
        The belief at the first sample; by default all modes have equal probability and age 0.
    ages : int, optional
        The largest number of ages, in samples, that are distinguished if age matters; older ones
        count as the oldest. By default as many as matter to the model (`SwitchingModel.ages`).
    allow_alike : bool
        Accept modes that x cannot distinguish; the switching model alone weights them.

    Attributes
    ----------
    ages : int
        How many ages the switching model needs; 1 if age does not matter.

    Raises
    ------
    ArgumentError
        If two modes cannot be distinguished, an argument is malformed, or the model cannot be
        sampled at the step.

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

    model: SwitchingModel
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
        # A mode of unknown age counts as just entered.
        just_begun = np.zeros((plant.modes, own))
        just_begun[:, 0] = 1.0
        start = just_begun / plant.modes
        if initial is not None:
            start = belief_of("initial", initial, just_begun)
        vars(self).update(
            plant=plant,
            model=model,
            step=step,
            disturbance=intensities("disturbance", disturbance, plant.modes, plant.states),
            outputs=None,
            noise=deviation(noise, plant.states),
            switches=switches,
            forgetting=share("forgetting", forgetting),
            initial=read_only(start),
            ages=own,
        )

    def form(self, ages: int = 1) -> Belief:
        ages, modes = max(count("ages", ages), self.ages), self.plant.modes
        sampled = SampledPlant.of(self.plant, self.step)
        Phi, Gamma, lag = sampled.periods()
        start = np.zeros((modes, ages))
        start[:, : self.ages] = self.initial
        chain = self.model.chain(self.step, self.ages)
        last = np.repeat(chain.hazard[:, -1:], ages - self.ages, axis=1)  # as `form` promises
        hazard = np.hstack((chain.hazard, last))
        within = self.switches == "anywhere"
        bend = _bend(sampled, Phi, Gamma, lag) if within else (Phi[:0, None], Gamma[:0, None])
        parts = start, Phi, Gamma, lag, self._covariance(Phi), hazard, chain.jump
        return frozen(Belief(*parts, self.forgetting, within, *bend))

    def _covariance(self, Phi: np.ndarray) -> Float[np.ndarray, "mode end n n"]:
        """The covariance of x_{k+1} − Φ_i x_k, both measured, by the last mode if it matters.

        Φ_i R Φ_iᵀ is replaced by its mean over the modes: otherwise, if noise dominates x, the mode
        with the smallest growth of the noise would always be the most probable.
        """
        A, W, R = self.plant.A, self.disturbance, np.diag(self.noise**2)
        Q = noise_covariances(A, W, np.full(len(A), self.step))[:, None]
        if W.ndim == 3 and self.switches == "anywhere":
            held, Q = Q[:, 0], switched_covariances(A, W, self.step)
            each = np.arange(len(A))
            Q[each, each] = held  # without a switch no approximation is needed
        return Q + R + (Phi @ R @ Phi.transpose(0, 2, 1)).mean(axis=0)

    def start(self, u0: ArrayLike | None = None) -> RunningFilter:
        """A running filter, to be updated once per period.

        Parameters
        ----------
        u0 : array_like, shape (m, N), optional
            The inputs in flight at the first sample, oldest first, N = `longest_lag`; 0 by default.
        """
        return RunningFilter(self.form(), u0)

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
    """Ψ and Ω of a `Belief`: a switch in the middle of a period, minus the mean of both modes."""
    bend_x, bend_u = -0.5 * (Phi[:, None] + Phi), -0.5 * (Gamma[:, None] + Gamma)
    for i, j in np.ndindex(bend_x.shape[:2]):
        if i == j:
            bend_x[i, i], bend_u[i, i] = 0.0, 0.0
            continue
        period = sampled.cut_period(i, j, 0.5 * sampled.step)
        bend_x[i, j] += period.Phi
        place = np.searchsorted(-lag, -np.array(period.lags))  # lags decrease
        bend_u[i, j, place] += period.Gamma
    return bend_x, bend_u
