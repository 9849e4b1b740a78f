"""OutputModeFilter: the probability of each mode, and the state, from outputs alone.

Derived in docs/theory/mode-filter.md. Signs, lags and pieces are those of `deadtime.plant`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.estimation.mode_filter import (
    ModeFilter,
    deviation,
    require_distinct_outputs,
)
from deadtime.estimation.observer import Observer, output_matrices, require_detectable
from deadtime.estimation.running_filter import RunningOutputFilter
from deadtime.feedback.belief import BankForm, BeliefFilter, frozen
from deadtime.plant import SwitchedSystem
from deadtime.plant.weight import weight_matrix
from deadtime.switching import SwitchingModel


@dataclass(frozen=True, eq=False, init=False, repr=False)
class OutputModeFilter(BeliefFilter):
    """The belief over the modes of a plant, and its state, from noisy outputs.

    An interacting-multiple-model filter: a Kalman filter per mode, corrected by every output and
    mixed at every sample as the switching model and the outputs say. It is an approximation, as
    each mode keeps one normal density of x in place of one for every path of modes. With C = I it
    is the filter for states that are measured with noise.

    Parameters
    ----------
    plant : SwitchedSystem
        The filter's model of the plant; any delays. What a mode hides from C must decay.
    model : switching model
        How the mode switches.
    step : float
        Sampling period h, in seconds.
    C : array_like, shape (p, n) or (modes, p, n), or Observer
        What is measured. An `Observer` of this plant and period gives its C, and its gains replace
        the Kalman gains; a sample with a missing output then corrects nothing.
    covariance : array_like
        Covariance of the first state about `estimate`, :math:`x^2`: a number for number times
        :math:`I`, (n,) or (n, n).
    disturbance : array_like
        :math:`W` of `imperfections.WhiteDisturbance`: a number, (n,), (n, n) or (modes, n, n),
        :math:`x^2` per second.
    noise : array_like
        Standard deviation of `imperfections.Noise`, in units of y: a number or (p,).
    estimate : array_like, shape (n,), optional
        First estimate of the state; 0 by default.
    switches, forgetting, initial, ages, allow_alike
        As of `ModeFilter`.

    Attributes
    ----------
    chain : ModeFilter
        The filter from states with the same model, period, disturbance and options.

    Raises
    ------
    ArgumentError
        If two modes cannot be distinguished by their outputs, a mode hides from C what does not
        decay, or an argument is malformed.

    References
    ----------
    Blom and Bar-Shalom, IEEE Trans. Automat. Control 33(8), 1988, for switches at samples and one
    C; the rest is derived in docs/theory/mode-filter.md.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant, model = dt.problems.paper().plant, dt.Markov([[0.0, 2.0], [1.0, 0.0]])
    >>> options = {"covariance": 1.0, "disturbance": 1e-4, "noise": 0.01}
    >>> filt = dt.OutputModeFilter(plant, model, 0.02, [[1.0, 0.0]], **options)
    >>> filt
    OutputModeFilter(modes=2, states=2, outputs=1, step=0.02, switches='anywhere')
    >>> running = filt.start()
    >>> running.update([1.0]), running.estimate.round(3)
    (array([0.5, 0.5]), array([1., 0.]))
    """

    chain: ModeFilter
    outputs: Float[np.ndarray, "mode p n"]
    gain: Float[np.ndarray, "mode n p"] | None
    noise: Float[np.ndarray, " p"]
    estimate: Float[np.ndarray, " n"]
    covariance: Float[np.ndarray, "n n"]

    def __init__(
        self,
        plant: SwitchedSystem,
        model: SwitchingModel,
        step: float,
        C: ArrayLike | Observer,
        *,
        covariance: ArrayLike | None = None,
        disturbance: ArrayLike = 0.0,
        noise: ArrayLike = 0.0,
        estimate: ArrayLike | None = None,
        switches: str | None = None,
        forgetting: float = 1e-9,
        initial: ArrayLike | None = None,
        ages: int | None = None,
        allow_alike: bool = False,
    ) -> None:
        if covariance is None:
            raise ArgumentError(
                "covariance must be given, of the first state about the estimate: a number, (n,) "
                "or (n, n), such as 1.0; how well the state at time 0 is known."
            )
        chain = ModeFilter(
            plant,
            model,
            step,
            disturbance=disturbance,
            switches=switches,
            forgetting=forgetting,
            initial=initial,
            ages=ages,
            allow_alike=True,
        )
        gain = None
        if isinstance(C, Observer):
            _require_same(C, chain)
            C, gain = C.C, C.gain
        C = output_matrices(C, plant)
        for mode in range(plant.modes):
            require_detectable(plant.A[mode], C[mode], mode)
        if not allow_alike:
            require_distinct_outputs(plant, C)
        n = plant.states
        first = real_array("estimate", np.zeros(n) if estimate is None else estimate, "(n,)", 1)
        vars(self).update(
            plant=plant,
            step=chain.step,
            disturbance=chain.disturbance,
            chain=chain,
            outputs=C,
            gain=gain,
            noise=deviation(noise, C.shape[1], "p"),
            estimate=require_shape("estimate", first, (n,), "(n,)"),
            covariance=weight_matrix("covariance", covariance, n, "n"),
        )
        self.__post_init__()

    def form(self, ages: int = 1) -> BankForm:
        C = self.outputs
        gain = C[:, :0].swapaxes(1, 2) if self.gain is None else self.gain
        parts = C, self.noise**2, gain, self.estimate, self.covariance
        return frozen(BankForm(self.chain.form(ages), *parts))

    def start(self, u0: ArrayLike | None = None) -> RunningOutputFilter:
        """A running filter, to be updated once per period.

        Parameters
        ----------
        u0 : array_like, shape (m, N), optional
            The inputs in flight at the first sample, oldest first, N = `longest_lag`; 0 by default.
        """
        return RunningOutputFilter(self.form(), u0)

    def __repr__(self) -> str:
        modes, p, n = self.outputs.shape
        return (
            f"OutputModeFilter(modes={modes}, states={n}, outputs={p}, step={self.step:g}, "
            f"switches={self.chain.switches!r})"
        )


def _require_same(observer: Observer, chain: ModeFilter) -> None:
    """Refuse an observer of another plant or period."""
    mine, its = chain.plant, observer.plant
    sizes = [(plant.modes, plant.states, plant.inputs) for plant in (mine, its)]
    same = sizes[0] == sizes[1] and all(
        (getattr(mine, name) == getattr(its, name)).all() for name in ("A", "B", "delays")
    )
    if not same or observer.step != chain.step:
        raise ArgumentError(
            f"C must be an observer of the filter's plant and step = {chain.step:g} s, got one of "
            f"{its!r}, step = {observer.step:g} s: design it for these, or give its .C alone."
        )
