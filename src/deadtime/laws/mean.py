"""Predictor feedback for one fictitious mode, the mean of all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.feedback.law import Law, check_dwell_time
from deadtime.feedback.prediction_rows import extended_gains
from deadtime.gains.state_feedback import check_gains, require_hurwitz
from deadtime.laws.constant_forecast import ConstantForecast, Future
from deadtime.plant import SwitchedSystem


@dataclass(frozen=True, eq=False, init=False, repr=False)
class MeanPredictor(ConstantForecast):
    r"""Exact predictor feedback of the mean plant (Ā, B̄).

    .. math::

        u(t) = \bar K \Big( e^{\bar A D} x(t)
        + \int_{t-D}^{t} e^{\bar A (t - \theta)} \bar B u(\theta) \, d\theta \Big)

    With a dwell time :math:`\tau_d` the prediction stays in :math:`\sigma(t)` for
    max(0, :math:`\tau_d` − age) seconds and in the mean from there on.

    Parameters
    ----------
    plant : SwitchedSystem
        The law's model.
    gain : array_like, shape (m, n)
        K̄ of u = +K̄ x.
    gains : array_like, shape (modes, m, n), optional
        The modes' own :math:`K_i`, needed only for the mismatch; without them there is none.
    dwell_time : float, optional
        :math:`\tau_d` > 0, seconds: the least time that the plant stays in a mode.
    mean : pair of array_like, shapes (n, n) and (n, m), optional
        (Ā, B̄); the element-wise mean of the modes by default.
    allow_unstable : bool
        Accept gains that leave :math:`\bar A + \bar B \bar K`, or some :math:`A_i + B_i K_i`,
        unstable.

    References
    ----------
    arXiv 2503.08446, equation (80), the law of Figure 6. The dwell time, and other centres:
    arXiv 2506.03908.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.problems.paper().plant
    >>> gain = dt.place(plant.mean(), [-1, -2])[0]
    >>> gain.round(4)
    array([[-12.3515,  -6.1881]])
    >>> dt.MeanPredictor(plant, gain).label
    'mean'
    """

    plant: SwitchedSystem
    gain: Float[np.ndarray, "m n"]
    gains: Float[np.ndarray, "mode m n"] | None
    dwell_time: float | None
    mean: tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n m"]]
    allow_unstable: bool

    def __init__(
        self,
        plant: SwitchedSystem,
        gain: ArrayLike,
        gains: ArrayLike | None = None,
        dwell_time: float | None = None,
        mean: tuple[ArrayLike, ArrayLike] | None = None,
        *,
        allow_unstable: bool = False,
    ) -> None:
        n, m = plant.states, plant.inputs
        gain = require_shape("gain", real_array("gain", gain, "(m, n)", 2), (m, n), "(m, n)")
        centre = plant.mean()
        if mean is not None and (not isinstance(mean, tuple | list) or len(mean) != 2):
            raise ArgumentError("mean must be a pair (A, B) of one matrix each.")
        A, B = (centre.A[0], centre.B[0]) if mean is None else mean
        A = require_shape("mean[0]", real_array("mean[0]", A, "(n, n)", 2), (n, n), "(n, n)")
        B = require_shape("mean[1]", real_array("mean[1]", B, "(n, m)", 2), (n, m), "(n, m)")
        require_hurwitz("gain", "the mean plant", A, B, gain, allow_unstable)
        if gains is not None:
            gains = check_gains(plant, gains, allow_unstable)
        vars(self).update(
            plant=plant,
            gain=gain,
            gains=gains,
            dwell_time=check_dwell_time(dwell_time),
            mean=(A, B),
            allow_unstable=allow_unstable,
        )

    @property
    def label(self) -> str:
        return "mean" if self.dwell_time is None else "mean, dwell-aware"

    @property
    def _future(self) -> Future:
        """The mean plant, its gain, and weight 1."""
        A, B = self.mean
        centre = self.plant.like(A[None], B[None], self.plant.mean().delays)
        return centre, self.gain[None], np.ones(1)

    @property
    def horizons(self) -> Float[np.ndarray, "future m"]:
        return self.plant.mean().delays

    def extend(self, plant: SwitchedSystem, rows: Float[np.ndarray, "future r n"]) -> Law:
        (A, B), more, further = self.mean, plant.states - self.plant.states, rows.shape[1]
        mean = np.pad(A, (0, more)), np.pad(B, ((0, more), (0, further)))
        gain = extended_gains(self.gain[None], rows)[0]
        return MeanPredictor(plant, gain, None, self.dwell_time, mean, allow_unstable=True)
