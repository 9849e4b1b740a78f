"""The oracle: exact predictor feedback along a known future switching signal."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import count
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Feedback, Forecast, Preview
from deadtime.feedback.law import Law, TableLaw
from deadtime.feedback.prediction_rows import extended_gains
from deadtime.feedback.table import require_finite_gains
from deadtime.gains.state_feedback import check_gains
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.switching import SwitchingSignal


@dataclass(frozen=True, eq=False, init=False, repr=False)
class ExactPredictor(TableLaw):
    r"""Exact predictor feedback :math:`u(t) = K_{\sigma(t+D)} x(t + D)` for a known signal.

    Where inputs or modes have delays of their own, t + D is, input by input, when the plant first
    reads what is sent at t, and inputs to come that act until then are the law's own.

    For benchmarks (no causal law can predict better), and for plants whose switching is
    scheduled. A switch at exactly t + D counts: signals are right-continuous.

    Parameters
    ----------
    plant : SwitchedSystem
        The law's model.
    gains : array_like, shape (modes, m, n)
        :math:`K_i` of :math:`u = +K_i x`.
    signal : SwitchingSignal, optional
        The future signal that the law assumes; by default the signal of the run.
    allow_unstable : bool
        Accept gains that leave some :math:`A_i + B_i K_i` unstable.

    References
    ----------
    arXiv 2503.08446, Lemma 2.3; the product there is ordered with the latest mode leftmost.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> law = dt.ExactPredictor(problem.plant, problem.gains)
    >>> law.digital(0.01, dt.SwitchingSignal.constant(0), steps=3)
    Feedback(context='step', rows=3, taps=100, inputs=1, step=0.01, dense)
    """

    plant: SwitchedSystem
    gains: Float[np.ndarray, "mode m n"]
    signal: SwitchingSignal | None
    allow_unstable: bool

    def __init__(
        self,
        plant: SwitchedSystem,
        gains: ArrayLike,
        signal: SwitchingSignal | None = None,
        *,
        allow_unstable: bool = False,
    ) -> None:
        gains = check_gains(plant, gains, allow_unstable)
        if signal is not None:
            signal.require_modes(plant.modes)
        vars(self).update(plant=plant, gains=gains, signal=signal, allow_unstable=allow_unstable)

    @property
    def label(self) -> str:
        return "oracle"

    @property
    def needs_preview(self) -> bool:
        return True

    @property
    def previewed(self) -> SwitchingSignal | None:
        return self.signal

    def _require_signal(self, signal: SwitchingSignal | None, last: float) -> SwitchingSignal:
        """The signal that the law assumes, which must reach a delay past the last time."""
        known = signal if self.signal is None else self.signal
        if known is None:
            raise ArgumentError(
                "signal must be given: ExactPredictor needs the future; pass it here or build "
                "the law with one."
            )
        known.require_modes(self.plant.modes)
        needed = last + self.plant.longest_delay
        if known.end < needed * (1.0 - 1e-9):  # (steps − 1)·step carries round-off
            raise ArgumentError(
                f"signal must be known up to the last sample plus the delay, {needed:g} s, for "
                f"an exact predictor, but it ends at {known.end:g} s: give a longer signal or "
                "a shorter horizon."
            )
        return known

    def preview(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Preview | None:
        sampled, known = self._known(step, signal, steps)
        if not self.plant.has_one_delay:
            return None
        _ = self._finite  # a preview fills no table, which would refuse gains that overflow
        m = self.plant.inputs
        return Preview(sampled, self.gains, np.zeros((m, m)), known)

    def _known(
        self, step: float, signal: SwitchingSignal | None, steps: int | None
    ) -> tuple[SampledPlant, SwitchingSignal]:
        """The model at a period, and the signal that is assumed, long enough."""
        sampled = self.sampled_plant(step)
        if steps is None:
            raise ArgumentError(
                "steps must be given, the number of samples to make rows for, and the future "
                "signal: ExactPredictor knows the future and cannot be run sample by sample; where "
                "a rule switches the plant by its state, use StateDependentPredictor."
            )
        count("steps", steps)
        return sampled, self._require_signal(signal, (steps - 1) * step)

    @cached_property
    def _finite(self) -> bool:
        """That floats hold all K_i e^{A_i D}, checked once; others are refused."""
        from deadtime.numerics.exponential import discretise_modes

        ahead, _ = discretise_modes(self.plant.A, self.plant.B, self.plant.delay)
        with np.errstate(all="ignore"):
            require_finite_gains(self.gains @ ahead)
        return True

    def digital(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Feedback:
        from deadtime.laws.tables.along_signal import rows_along

        (sampled, known), samples = self._known(step, signal, steps), cast(int, steps)
        preview = self.preview(step, signal, steps)
        if preview is None:
            F, G = rows_along(sampled, self.gains, known, samples)
        else:
            F, G = preview.rows(samples)
        return Feedback(F, G, "step", sampled.step)

    def extend(self, plant: SwitchedSystem, rows: Float[np.ndarray, "future r n"]) -> Law:
        gains = extended_gains(self.gains, rows)
        return ExactPredictor(plant, gains, self.signal, allow_unstable=True)

    def ideal(self, signal: SwitchingSignal, horizon: float) -> Forecast:
        from deadtime.laws.tables.windows import constant_functional

        plant, known = self.plant, self._require_signal(signal, horizon)
        last = [int(known.modes[-1])]
        settled = constant_functional(plant.only(last), self.gains[last], np.ones(1))
        return Forecast.with_preview(plant, self.gains, known, settled)
