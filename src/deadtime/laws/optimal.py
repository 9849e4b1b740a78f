"""The best causal law for a stochastic model of switching: the lower bound for every other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import count, index, read_only, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Feedback, Forecast
from deadtime.feedback.law import TableLaw, require_room, room
from deadtime.laws.expected import table_ages
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.plant.weight import Weight, weight_matrix
from deadtime.switching import SwitchingModel, SwitchingSignal
from deadtime.switching.models.model import require_model

MOST_MEMORY = 4e9  # bytes of P, one matrix per mode and age


@dataclass(frozen=True, eq=False, init=False, repr=False)
class OptimalPredictor(TableLaw):
    r"""The causal law of least expected cost, given a stochastic model of the switching.

    .. math::

        \min \; E \int_0^\infty x^T Q x + u^T R u \, dt

    over all :math:`u_k` that depend on :math:`x(t_0), \dots, x(t_k)`, the inputs before :math:`t_k`
    and the modes up to :math:`t_k`.

    The lifted state :math:`\xi_k = (x_k, u_{k-1}, \dots, u_{k-N})` obeys
    :math:`\xi_{k+1} = \bar A_i \xi_k + \bar B u_k` in mode :math:`i`, and costs
    :math:`\xi_k^T \bar Q_i \xi_k + h \, u_k^T R u_k` per period, with :math:`\bar Q_i` the exact
    integral of :math:`x^T Q x` between samples. Mode and age, :math:`\theta`, are measured, so this
    is a Markov jump linear system and the optimum is linear in :math:`\xi`, with one row per
    :math:`\theta`,

    .. math::

        u_k &= -(h R + \bar B^T E_\theta(P) \bar B)^{-1}
        \bar B^T E_\theta(P) \bar A_i \xi_k, \\
        P_\theta &= \bar Q_i + \bar A_i^T E_\theta(P) \bar A_i \\
        &\quad - \bar A_i^T E_\theta(P) \bar B
        (h R + \bar B^T E_\theta(P) \bar B)^{-1}
        \bar B^T E_\theta(P) \bar A_i,

    with :math:`E_\theta(P)` the mean of :math:`P` one sample later. The cross terms between
    :math:`\xi_k` and :math:`u_k` that appear for :math:`N = 1` are included. `ExpectedPredictor`
    averages the best inputs of all future signals; this law also weighs the cost of a wrong
    forecast and uses later measurements. For similar modes the two cost nearly the same; for modes
    that differ much this one may have a finite cost where that of the other is infinite.

    Parameters
    ----------
    plant : SwitchedSystem
        The law's model of the plant.
    model : switching model
        How the mode switches, with as many modes as the plant. A mode's age is counted where it
        matters, as under a semi-Markov model.
    Q : array_like, shape (n, n), (n,) or a number
        State weight, symmetric, positive definite; its diagonal; or a number times the identity.
    R : array_like, shape (m, m), (m,) or a number
        Input weight, likewise.
    ages : int, optional
        The largest number of ages (samples) that the table distinguishes, if age matters; older
        modes count as the oldest. By default as many as matter to the model.

    Raises
    ------
    ArgumentError
        If the weights do not fit the plant or are not definite, or the model does not fit;
        `digital` raises it if the step does not fit the model's sojourns, the solution would
        not fit into 4 GB, or :math:`e^{2 A D}` is beyond double precision.
    InfeasibleError
        By `digital`, if no causal law has a finite cost: none stabilises in mean square.

    Notes
    -----
    In the model switches happen at samples: one that happens within a period is seen at the
    next sample, and is taken to happen there. That is exact for switches on the grid and O(h)
    otherwise. The solution takes modes × ages × :math:`(n + N m)^2` numbers of 8 bytes.

    References
    ----------
    Costa, Fragoso and Marques, Discrete-Time Markov Jump Linear Systems, Springer 2005,
    chapter 4 and appendix A.

    Examples
    --------
    >>> import deadtime as dt
    >>> from scipy import stats
    >>> plant = dt.problems.paper().plant
    >>> model = dt.SemiMarkov(stats.expon(loc=0.2, scale=0.2))
    >>> law = dt.OptimalPredictor(plant, model, Q=1.0, R=1.0)
    >>> law.digital(0.05)
    Feedback(context='mode_age', rows=10, taps=20, inputs=1, step=0.05, dense)
    >>> round(law.least_cost([-1, 1], mode=0, step=0.05), 1)
    349.7
    """

    plant: SwitchedSystem
    gains: None
    model: SwitchingModel
    Q: Float[np.ndarray, "n n"]
    R: Float[np.ndarray, "m m"]
    ages: int | None

    def __init__(
        self,
        plant: SwitchedSystem,
        model: SwitchingModel,
        Q: ArrayLike,
        R: ArrayLike,
        *,
        ages: int | None = None,
    ) -> None:
        require_model(model, plant.modes)
        Q = weight_matrix("Q", Q, plant.states, "n", strict=True)
        R = weight_matrix("R", R, plant.inputs, "m", strict=True)
        ages = None if ages is None else count("ages", ages)
        vars(self).update(plant=plant, gains=None, model=model, Q=Q, R=R, ages=ages)

    @property
    def label(self) -> str:
        return "optimal"

    @property
    def weight(self) -> Weight:
        """The cost that it minimises."""
        return Weight(self.Q, self.R)

    def digital(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Feedback:
        return self._solution(step)[0]

    def ideal(self, signal: SwitchingSignal, horizon: float) -> Forecast:
        raise ArgumentError(
            "step must be given: OptimalPredictor has no closed form in continuous time."
        )

    def least_cost(self, x0: ArrayLike, mode: int, step: float = 0.01) -> float:
        """The least expected cost from x(0) = x0 in a mode just entered, with no input in flight.

        No causal law at this period has a lower expected cost on signals of the model that switch
        at samples.

        Parameters
        ----------
        x0 : array_like, shape (n,)
            State at time 0.
        mode : int
            The mode at time 0, of age 0.
        step : float
            Sampling period h, in seconds.

        Returns
        -------
        float
            The expectation of the integral above, in the unit of the weights.
        """
        n = self.plant.states
        x0 = require_shape("x0", real_array("x0", x0, "(n,)", 1), (n,), "(n,)")
        mode = index("mode", mode, self.plant.modes)
        return float(x0 @ self._solution(step)[1][mode] @ x0)

    def _solution(self, step: float) -> tuple[Feedback, Float[np.ndarray, "mode n n"]]:
        """The table at a period, and the cost of x(0) in each mode just entered (cached)."""
        kept = vars(self).get("_kept")
        if kept is None or kept[0].step != step:
            kept = vars(self)["_kept"] = self._solve(self.sampled_plant(step))
        return kept

    def _solve(self, sampled: SampledPlant) -> tuple[Feedback, Float[np.ndarray, "mode n n"]]:
        from deadtime.laws.tables.riccati import period, solve

        plant, h, N = self.plant, sampled.step, sampled.longest_lag
        modes, n, m = plant.B.shape
        most = room(8.0 * modes * (n + N * m) ** 2, MOST_MEMORY)
        require_room("the lifted state", 1, h, most)
        ages = table_ages(self.model, h, self.ages, most)
        context = "mode" if ages is None else "mode_age"
        ages = ages or 1
        chain = self.model.chain(h, ages)
        L, stage = period(sampled, self.Q)
        # In ξ of `solve` the oldest input comes first, in a table the latest.
        P, gain = solve(L, stage, h * self.R, chain.hazard, chain.jump, N, h)
        F = gain[..., :n].reshape(modes * ages, m, n).copy()
        G = gain[..., n:].reshape(modes * ages, m, N, m)[:, :, ::-1].transpose(0, 2, 1, 3).copy()
        cost = P[:, 0, :n, :n]  # of which `solve` fills the lower triangle
        cost = np.tril(cost) + np.tril(cost, -1).transpose(0, 2, 1)
        return Feedback(F, G, context, h, ages), read_only(cost)
