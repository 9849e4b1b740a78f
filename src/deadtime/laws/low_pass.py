"""A law whose input passes a low-pass filter on its way to the plant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import as_floats, instance, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Factor, Feedback, Forecast, Law, Preview
from deadtime.feedback.law import TableLaw
from deadtime.feedback.table import Known
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal


@dataclass(frozen=True, eq=False, init=False, repr=False)
class LowPassPredictor(TableLaw):
    r"""A law followed by a low-pass filter, which its table includes.

    .. math::

        T \dot u = v - u,
        \quad u_k = E u_{k-1} + (1 - E) v_k,
        \quad E = e^{-h T^{-1}},
        \quad v \text{ the wrapped law}

    The wrapped law predicts with the past u that the plant received, so with one delay its
    prediction stays exact; where delays differ it takes later inputs for v, unfiltered, and
    `Controller.prediction` is refused. High frequencies, at which a predictor amplifies an error of
    its delay, no longer go around the loop. The filter is part of the loop that gains must
    stabilise: `deadtime.design` chooses both together, as does LQR for the plant with u as a state
    and du/dt as its input (docs/theory/delay-margin.md).

    Parameters
    ----------
    law : TableLaw
        The law of v; any that is a table.
    time_constant : float, or array_like, shape (m, m)
        T in seconds: a number > 0 for all inputs, or a matrix whose eigenvalues have positive real
        parts.

    Raises
    ------
    ArgumentError
        If the law is no table, or T is no such number or matrix.

    References
    ----------
    Mondié and Michiels, IEEE Trans. Automatic Control 48 (2003), section IV: a filter makes the
    approximated predictor stable for a fine enough step. Feeding back the filtered input is
    Krstic's modified predictor, Automatica 44 (2008).

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.SwitchedSystem([[[0.0]]], [[[1.0]]], delay=0.2)
    >>> law = dt.SingleModePredictor(plant, [[[-1.0]]], 0)
    >>> law.digital(0.1).input_gain.ravel().round(3)
    array([-0.1, -0.1])
    >>> dt.LowPassPredictor(law, 0.1).digital(0.1).input_gain.ravel().round(3)
    array([ 0.305, -0.063])
    """

    law: Law
    time_constant: Float[np.ndarray, "m m"]

    def __init__(self, law: Law, time_constant: ArrayLike) -> None:
        instance("law", law, Law)
        if not law.is_linear or law.observer is not None:
            raise ArgumentError(
                f"law must be a table, got {type(law).__name__}, which is called sample by sample."
            )
        vars(self).update(
            plant=law.plant,
            gains=law.gains,
            law=law,
            time_constant=_matrix(time_constant, law.plant.inputs),
        )

    @property
    def label(self) -> str:
        return f"{self.law.label}, low-pass"

    @property
    def needs_preview(self) -> bool:
        return self.law.needs_preview

    @property
    def previewed(self) -> SwitchingSignal | None:
        return self.law.previewed

    def preview(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Preview | None:
        inner = self.law.preview(step, signal, steps)
        if inner is None:
            return None
        kept, passed = self._filter(inner.sampled.step)
        gains, latest = passed @ inner.gains, passed @ inner.latest + kept
        return inner._replace(gains=gains, latest=latest)

    def digital(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Feedback:
        table = self.law.digital(step, signal, steps)
        kept, passed = self._filter(table.step)
        G = passed @ table.input_gain
        G[:, 0] += kept
        factor = None if table.factor is None else _factor(table.factor, kept, passed, G[:, -1])
        return Feedback(passed @ table.state_gain, G, table.context, table.step, table.ages, factor)

    def _filter(self, step: float) -> tuple[np.ndarray, np.ndarray]:
        """E and 1 − E, the shares of u_{k−1} and of v_k in u_k."""
        from scipy.linalg import expm

        kept = expm(-step * np.linalg.inv(self.time_constant))
        return kept, np.eye(self.plant.inputs) - kept

    @property
    def horizons(self) -> Float[np.ndarray, "future m"]:
        return self.law.horizons

    def extend(self, plant: SwitchedSystem, rows: Float[np.ndarray, "future r n"]) -> Law:
        shortest, longest = self.plant.delays.min(), self.plant.delays.max()
        if shortest < longest:  # the wrapped law predicts its own later inputs without the filter
            raise ArgumentError(
                "prediction of a LowPassPredictor needs one delay, the same for all inputs and "
                f"modes, got {shortest:g} to {longest:g} s: inputs that are not yet computed would "
                "count as if there were no filter. Make the controller of the law without the "
                "filter (`law.law`), or give all inputs the longest delay."
            )
        return self.law.extend(plant, rows)  # the filter is after the prediction

    def spread(
        self, step: float, known: Known, W: Float[np.ndarray, "*mode n n"]
    ) -> Float[np.ndarray, "case input future n n"]:
        return self.law.spread(step, known, W)

    def ideal(self, signal: SwitchingSignal, horizon: float) -> Forecast:
        raise ArgumentError(
            "step must be given: LowPassPredictor feeds back its own input through a differential "
            "equation, which the ideal loop does not solve; a short step comes close."
        )


def _matrix(value: ArrayLike, m: int) -> Float[np.ndarray, "m m"]:
    """T as an (m, m) matrix whose eigenvalues have positive real parts."""
    given = as_floats("time_constant", value, f"a number or (m, m) = ({m}, {m})")
    array = np.diag(np.full(m, given)) if given.ndim == 0 else given
    array = real_array("time_constant", array, "() or (m, m)", 2)
    require_shape("time_constant", array, (m, m), "() or (m, m)")
    least = np.linalg.eigvals(array).real.min()
    if least <= 0.0:
        raise ArgumentError(
            "time_constant must be positive, in s, or a matrix whose eigenvalues have positive "
            f"real parts, got {least:g}: without a filter use the law itself."
        )
    return array


def _factor(factor: Factor, kept: np.ndarray, passed: np.ndarray, last: np.ndarray) -> Factor:
    """The taps as powers again: one more block holds u_{k−1}, and forgets it (0⁰ = 1, 0^j = 0)."""
    contexts, m, q = factor.H.shape
    S = np.zeros((q + m, q + m))
    S[:q, :q] = factor.S
    H = np.concatenate((passed @ factor.H, np.broadcast_to(kept, (contexts, m, m))), axis=2)
    return Factor(H, S, np.concatenate((factor.input, np.eye(m))), last.copy())
