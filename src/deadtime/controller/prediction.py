"""Prediction of a controller: the state at which the input of now arrives, and its covariance."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.controller.controller_arguments import Status
from deadtime.estimation.mode_filter import intensities, intensity
from deadtime.feedback.prediction_rows import PredictionTable
from deadtime.feedback.table import Known

if TYPE_CHECKING:
    from deadtime.controller.running import RunningLaw


@dataclass(frozen=True, eq=False, repr=False)
class Prediction(Frozen):
    r"""The state at :math:`t_k + D`, as the law of a controller forecasts it (immutable).

    .. math::

        \hat x(t_k + D_j) = \sum_i p_i P_i

    over the modes i in which the forecast may end, from the last sample that was served and the
    inputs before it, as applied: those that nothing can change any more. Where inputs have delays
    of their own, those that arrive earlier are counted on as the law would send them.

    Attributes
    ----------
    states : (inputs, n)
        :math:`\hat x(t_k + D_j)`, of every input the state that it meets; one and the same where
        all arrive together.
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
        """The covariance of the predicted states, as the forecast has it.

        What a disturbance adds over the delay, what is not known of the state now, and how far
        apart the futures are that the law thinks possible. Inputs that are still to be sent count
        as predicted.

        Parameters
        ----------
        disturbance : array_like, optional
            :math:`W` of `imperfections.WhiteDisturbance`: a number, (n,), (n, n) or (modes, n, n),
            :math:`x^2` per second. By default 0, or what the filter of a `BeliefPredictor` counts
            with.
        estimate : array_like, optional
            The covariance of the state now about what the law takes it for: a number, (n,) or (n,
            n), :math:`x^2`. By default 0 of a state that is measured, and what a Kalman filter says
            of an estimate, in its steady state; a filter of outputs has its own, and takes none.

        Raises
        ------
        ArgumentError
            If W or the covariance is none; of an observer that keeps no covariance, without
            `estimate`; of a law whose forecast switches, where inputs or modes have delays of
            their own; of a servo.
        """
        share, state, C = self._cases(disturbance, estimate)
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
            W = intensities(disturbance, source.law.plant.modes, n)
        known = source.uncertain(estimate)
        p, moved = _moments(source.table, known)
        C = source.law.spread(source.step, known, W)
        state = moved / np.where(p > 0.0, p, 1.0)[..., None]
        return known.share[:, None, None] * p, state, C

    def __repr__(self) -> str:
        each = zip(self.states, map(_seconds, self.horizons), strict=True)
        parts = dict.fromkeys(f"{_three(x)} in {seconds}" for x, seconds in each)
        shares = ", ".join(f"{100.0 * p:.3g} %" for p in self.probabilities[0])
        return f"Prediction(x̂ = {'; '.join(parts)}, modes {shares})"


class _Source(Frozen):
    """The law, the tables and the estimate from which a prediction was computed."""

    def __init__(self, running: RunningLaw, known: Known) -> None:
        filt, n = running.law.filter, known.x.shape[1]
        self.law, self.step, self.known = running.inner, running.step, known
        self.table = running.prediction_table
        self.disturbance = np.zeros((n, n)) if filt is None else filt.disturbance
        self.refused = _without_covariance(running)
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
        P = intensity(estimate, self.known.x.shape[1], "estimate")
        return self.known._replace(P=np.tile(P, (len(self.known.x), 1, 1)))


def _without_covariance(running: RunningLaw) -> str:
    """Why the covariance of the state now is not known; nothing where it is."""
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
    """p_i and p_i P_i of every row in play, (cases, inputs, futures) and (…, n)."""
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
        P = _covariance_of_estimate(running, x.size)
        found = Known(np.array([row]), np.ones(1), x[None].copy(), P[None], past)
    if not running.samples or not np.isfinite(found.x).all() or found.row.min() < 0:
        raise ArgumentError(_nothing_known(running))
    return found


def _covariance_of_estimate(running: RunningLaw, n: int) -> Float[np.ndarray, "n n"]:
    """Of the state about what an observer makes of it; 0 where it says nothing of that."""
    law = running.law
    if law.observer is None or law.servo is not None:
        return np.zeros((n, n))
    covariance = law.observer.covariance
    return np.zeros((n, n)) if covariance is None else covariance[max(running._mode, 0)]


def _nothing_known(running: RunningLaw) -> str:
    """Why there is no prediction now."""
    if running._reads_row and running._mode < 0 and running.samples:
        return "prediction needs the mode: no mode of the plant has been reported yet."
    if running.samples and running.status > Status.SATURATED:
        return (
            "prediction needs the state of the last sample, which was not finite: the law has "
            "nothing to predict from until the next one."
        )
    return "prediction needs a sample: call update first, after `reset` and `restore` too."


def _three(x: np.ndarray) -> list[float]:
    """To three digits, for a reader."""
    return [float(f"{value:.3g}") for value in x.tolist()]


def _seconds(horizons: np.ndarray) -> str:
    """One horizon, or where it depends on the mode from which to which."""
    low, high = horizons.min(), horizons.max()
    return f"{low:g} s" if low == high else f"{low:g} to {high:g} s"
