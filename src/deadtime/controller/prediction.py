"""Prediction of a controller: the state when the present input arrives, and its covariance."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.controller.controller_arguments import Status
from deadtime.feedback.prediction_rows import PredictionTable
from deadtime.feedback.table import Known
from deadtime.plant.weight import intensities, weight_matrix

if TYPE_CHECKING:
    from deadtime.controller.running import RunningLaw


@dataclass(frozen=True, eq=False, repr=False)
class Prediction(Frozen):
    r"""The state at :math:`t_k + D`, as the law of a controller forecasts it (immutable).

    .. math::

        \hat x(t_k + D_j) = \sum_i p_i P_i

    over the modes i in which the forecast may end, from the last sample served and the inputs
    applied before it, which are fixed. If inputs have different delays, inputs that arrive earlier
    and are not yet sent are those that the law would send.

    Attributes
    ----------
    states : (inputs, n)
        :math:`\hat x(t_k + D_j)`, the state when input j arrives; the same for all inputs if their
        delays are equal.
    by_mode : (inputs, modes, n)
        :math:`P_i`, the state expected if the forecast ends in mode i; NaN where it cannot. A
        `MeanPredictor` has one mode, the mean one.
    probabilities : (inputs, modes)
        :math:`p_i`: by the law's forecast, and, of a `BeliefPredictor`, by its filter.
    horizons : (inputs, modes)
        :math:`D_j`, by the mode in which the forecast ends, in seconds.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> law = dt.AveragedPredictor(problem.plant, problem.gains)
    >>> controller = dt.Controller(law, step=0.01)
    >>> u = controller.update([-1.0, 1.0])
    >>> controller.prediction
    Prediction(x̂ = [-3.09, 2.94] in 1 s, modes 50 %, 50 %)
    >>> controller.prediction.covariance(disturbance=1e-4).round(4)
    array([[[ 0.1388, -0.0797],
            [-0.0797,  0.0474]]])
    """

    states: Float[np.ndarray, "input n"]
    by_mode: Float[np.ndarray, "input mode n"]
    probabilities: Float[np.ndarray, "input mode"]
    horizons: Float[np.ndarray, "input mode"]
    _source: _Source = field(repr=False)

    def covariance(
        self, disturbance: ArrayLike | None = None, estimate: ArrayLike | None = None
    ) -> Float[np.ndarray, "input n n"]:
        """The covariance of the predicted states under the law's forecast.

        It adds the disturbance over the delay, the covariance of the present state and the spread
        of the possible futures. Inputs that are still to be sent count as predicted.

        Parameters
        ----------
        disturbance : array_like, optional
            :math:`W` of `imperfections.WhiteDisturbance`: a number, (n,), (n, n) or (modes, n, n),
            :math:`x^2` per second. By default 0, or the intensity that the filter of a
            `BeliefPredictor` assumes.
        estimate : array_like, optional
            The covariance of the present state about the value that the law uses: a number, (n,)
            or (n, n), :math:`x^2`. By default 0 for a measured state, and the steady-state
            covariance of a Kalman filter; a filter of outputs has its own and accepts none.

        Returns
        -------
        (inputs, n, n) array
            For every input the covariance of the state when it arrives.

        Raises
        ------
        ArgumentError
            If W or `estimate` is no covariance; if an observer has no covariance and `estimate` is
            missing; if the law's forecast switches and delays differ by input or mode; for a servo.
        """
        share, state, C = self._cases(disturbance, estimate)
        # Law of total covariance: the mean of C and the covariance of the means.
        apart = state - np.einsum("cji,cjia->ja", share, state)[:, None]
        return np.einsum("cji,cjiab->jab", share, C + apart[..., :, None] * apart[..., None, :])

    def covariance_by_mode(
        self, disturbance: ArrayLike | None = None, estimate: ArrayLike | None = None
    ) -> Float[np.ndarray, "input mode n n"]:
        """The covariance about :math:`P_i` if the forecast ends in mode i; NaN where it cannot."""
        share, state, C = self._cases(disturbance, estimate)
        total = share.sum(axis=0)
        with np.errstate(invalid="ignore"):
            share = share / total
        apart = state - np.einsum("cji,cjia->jia", share, state)
        return np.einsum("cji,cjiab->jiab", share, C + apart[..., :, None] * apart[..., None, :])

    def _cases(
        self, disturbance: ArrayLike | None, estimate: ArrayLike | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Probability, mean and covariance by row that may apply, input and future."""
        source, n = self._source, self.states.shape[1]
        W = source.disturbance
        if disturbance is not None:
            W = intensities("disturbance", disturbance, source.law.plant.modes, n)
        known = source.uncertain(estimate)
        p, moved = _moments(source.table, known)
        C = source.law.spread(source.step, known, W)
        state = moved / np.where(p > 0.0, p, 1.0)[..., None]
        return known.share[:, None, None] * p, state, C

    def __repr__(self) -> str:
        three = [[float(f"{value:.3g}") for value in x] for x in self.states.tolist()]
        each = zip(three, map(_seconds, self.horizons), strict=True)
        parts = dict.fromkeys(f"{x} in {seconds}" for x, seconds in each)
        shares = ", ".join(f"{100.0 * p:.3g} %" for p in self.probabilities[0])
        return f"Prediction(x̂ = {'; '.join(parts)}, modes {shares})"


class _Source(Frozen):
    """The law, the tables and the estimate from which a prediction was computed."""

    def __init__(self, running: RunningLaw, known: Known) -> None:
        filt, n = running.law.filter, known.x.shape[1]
        self.law, self.step, self.known = running.inner, running.step, known
        self.table = running.prediction_table
        self.disturbance = np.zeros((n, n)) if filt is None else filt.disturbance
        self.refused = _why_no_covariance(running)
        self.fixed = filt is not None and filt.outputs is not None
        self.__post_init__()

    def uncertain(self, estimate: ArrayLike | None) -> Known:
        """The estimate of the state with its covariance at this sample."""
        if self.refused and (estimate is None or "servo" in self.refused):
            raise ArgumentError(self.refused)
        if estimate is None:
            return self.known
        if self.fixed:
            raise ArgumentError(
                "estimate must be left out: the filter of this law has the covariance of the state "
                "in every mode."
            )
        P = weight_matrix("estimate", estimate, self.known.x.shape[1], "n")
        return self.known._replace(P=np.tile(P, (len(self.known.x), 1, 1)))


def _why_no_covariance(running: RunningLaw) -> str:
    """Why the covariance of the present state is unknown; empty if it is known."""
    law = running.law
    if law.observer is None:
        return ""
    if law.servo is not None:
        return (
            "covariance of a servo's prediction is not known: its sums of errors depend on outputs "
            "and references to come. Ask the controller of a law without a servo."
        )
    if law.observer.covariance is None:
        return (
            "estimate must be given, the covariance of the state about its estimate: this observer "
            "keeps none, as `kalman` does; 0 takes the estimate for the state."
        )
    return ""


def prediction_of(running: RunningLaw) -> Prediction:
    """The prediction of a controller from the last sample that it served."""
    table, known = running.prediction_table, _known(running)
    p, moved = _moments(table, known)
    p, moved = (np.einsum("c,c...->...", known.share, part) for part in (p, moved))
    with np.errstate(invalid="ignore", over="ignore"):
        by_mode = np.where(p[..., None] > 0.0, moved / p[..., None], np.nan)
    if not (np.isfinite(moved).all() and np.isfinite(by_mode[p > 0.0]).all()):
        raise ArgumentError(
            "prediction is beyond what floats hold: the state of this sample, or a past input, is "
            "too large."
        )
    horizons, source = running.inner.horizons.T.copy(), _Source(running, known)
    rest = running.rest.z
    return Prediction(moved.sum(axis=1) + rest, by_mode + rest, p, horizons, source)


def _moments(table: PredictionTable, known: Known) -> tuple[np.ndarray, np.ndarray]:
    """p_i and p_i P_i of every row that may apply, (cases, inputs, futures) and (…, n)."""
    F, G, p = (part[known.row] for part in table[:3])
    moved = (F @ known.x[:, None, None, :, None])[..., 0] + G @ known.past.reshape(-1)
    return p[:, table.of_input], moved[:, table.of_input]


def _known(running: RunningLaw) -> Known:
    """The rows that apply, the state in each and the past inputs."""
    past = running._past.recent.copy()
    if running.mode_belief is not None:
        share, x, P = running.mode_belief.known(len(running.table.state_gain))
        row = np.flatnonzero(share)
        found = Known(row, share[row], x[row], P[row], past)
    else:
        x = running.observing.z if running.observing else running._x
        row = running.table.row(running._mode, running._age) if running._reads_row else 0
        observer, P = running.law.observer, np.zeros((x.size, x.size))
        if observer and running.law.servo is None and observer.covariance is not None:
            P = observer.covariance[max(running._mode, 0)]
        found = Known(np.array([row]), np.ones(1), x[None].copy(), P[None], past)
    if not running.samples or not np.isfinite(found.x).all() or found.row.min() < 0:
        raise ArgumentError(_why_no_prediction(running))
    return found


def _why_no_prediction(running: RunningLaw) -> str:
    if running._reads_row and running._mode < 0 and running.samples:
        return "prediction needs the mode: no mode of the plant has been reported yet."
    if running.samples and running.status > Status.SATURATED:
        return (
            "prediction needs the state of the last sample, which was not finite: the law has "
            "nothing to predict from until the next one."
        )
    return "prediction needs a sample: call update first, after `reset` and `restore` too."


def _seconds(horizons: np.ndarray) -> str:
    """One horizon, or its range over the modes."""
    low, high = horizons.min(), horizons.max()
    return f"{low:g} s" if low == high else f"{low:g} to {high:g} s"
