"""Expected predictor feedback: the mean of the exact law over a stochastic switching model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import count
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Feedback, Functional
from deadtime.feedback.law import Law, TableLaw, cache_table, require_room, room
from deadtime.feedback.prediction_rows import extended_gains
from deadtime.feedback.table import Known
from deadtime.gains.state_feedback import check_gains
from deadtime.plant import SampledPlant, SwitchedSystem
from deadtime.switching import SwitchingModel, SwitchingSignal
from deadtime.switching.models.model import SampledChain, require_model


@dataclass(frozen=True, eq=False, init=False, repr=False)
class ExpectedPredictor(TableLaw):
    r"""Expectation of exact predictor feedback, given the current mode and its age.

    .. math::

        u(t) = E\big[ K_{\sigma(t+D)} P(t) \,\big|\, \sigma(t), \text{age}(t) \big],
        \quad P(t) = x(t + D) \text{ for that future}

    Under a Markov process in continuous time the table has one row per mode, from block
    exponentials without a time grid. Under any other model switches are taken to happen at samples,
    which is exact for switches on the grid and O(h) otherwise, and there is one row per mode and
    age, or per mode if age does not matter.

    Parameters
    ----------
    plant : SwitchedSystem
        The law's model of the plant.
    gains : array_like, shape (modes, m, n)
        :math:`K_i` of :math:`u = +K_i x`.
    model : switching model
        How the mode switches, with as many modes as the plant.
    ages : int, optional
        The largest number of ages (samples) that the table distinguishes, if age matters; older
        modes count as the oldest. By default as many as matter to the model.
    allow_unstable : bool
        Accept gains that leave some :math:`A_i + B_i K_i` unstable.

    Raises
    ------
    ArgumentError
        If the model has another number of modes than the plant or is no switching model;
        `digital` raises it if the model cannot be sampled at the step, or the table would take more
        than 1 GB; `simulate` with `step=None` if the model is no Markov process in continuous time,
        or switches many times per delay.

    Notes
    -----
    A table holds modes × ages × :math:`N m^2` numbers of 8 bytes, and filling it needs as much
    again: 2 modes, 1,000 ages and N = 1,000 take 16 MB for one input.

    References
    ----------
    arXiv 2503.08446, Lemma 2.3, for P(t); its average over futures is derived in
    `docs/theory/known-switching.md`; semi-Markov processes: Howard, Dynamic Probabilistic Systems
    (1971), volume II.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> model = dt.Markov([[0, 2.0], [1.0, 0]])
    >>> dt.ExpectedPredictor(problem.plant, problem.gains, model).digital(0.01)
    Feedback(context='mode', rows=2, taps=100, inputs=1, step=0.01, factored)
    >>> from scipy import stats
    >>> model = dt.SemiMarkov(stats.expon(loc=0.2, scale=0.2))
    >>> dt.ExpectedPredictor(problem.plant, problem.gains, model).digital(0.01)
    Feedback(context='mode_age', rows=42, taps=100, inputs=1, step=0.01, dense)
    """

    plant: SwitchedSystem
    gains: Float[np.ndarray, "mode m n"]
    model: SwitchingModel
    ages: int | None
    allow_unstable: bool

    def __init__(
        self,
        plant: SwitchedSystem,
        gains: ArrayLike,
        model: SwitchingModel,
        *,
        ages: int | None = None,
        allow_unstable: bool = False,
    ) -> None:
        gains = check_gains(plant, gains, allow_unstable)
        require_model(model, plant.modes)
        ages = None if ages is None else count("ages", ages)
        vars(self).update(
            plant=plant, gains=gains, model=model, ages=ages, allow_unstable=allow_unstable
        )

    @property
    def label(self) -> str:
        return "expected"

    @cache_table
    def digital(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Feedback:
        plant, generator, sampled = self.plant, self.model.generator, self.sampled_plant(step)
        if generator is not None:
            from deadtime.laws.tables.markov import markov_table

            return markov_table(plant.A, plant.B, self.gains, generator, sampled)
        from deadtime.laws.tables.sampled_chain import chain_table

        most = room(8 * plant.modes * sampled.longest_lag * plant.inputs**2)
        ages = table_ages(self.model, sampled.step, self.ages, most)
        return chain_table(self.gains, self._chain(sampled, ages), ages, sampled)

    def _chain(self, sampled: SampledPlant, ages: int | None) -> SampledChain:
        """The model at samples, up to the oldest age that a forecast can reach."""
        return self.model.chain(sampled.step, (ages or 1) + sampled.longest_lag)

    def extend(self, plant: SwitchedSystem, rows: Float[np.ndarray, "future r n"]) -> Law:
        gains = extended_gains(self.gains, rows)
        return ExpectedPredictor(plant, gains, self.model, ages=self.ages, allow_unstable=True)

    def spread(
        self, step: float, known: Known, W: Float[np.ndarray, "*mode n n"]
    ) -> Float[np.ndarray, "case input future n n"]:
        sampled, generator = self.sampled_plant(step), self.model.generator
        if generator is not None:
            from deadtime.laws.spread import markov_spread

            return markov_spread(sampled, generator, known, W)
        from deadtime.laws.spread import chain_spread

        ages = self.digital(step).ages
        return chain_spread(sampled, self._chain(sampled, ages), ages, known, W)

    def ideal(self, signal: SwitchingSignal, horizon: float) -> Functional:
        plant, generator = self.plant, self.model.generator
        if generator is None:
            raise ArgumentError(
                "step must be given: ExpectedPredictor has no closed form in continuous time "
                f"under a {type(self.model).__name__} model."
            )
        from deadtime.laws.tables.windows import passage_functional

        law = passage_functional(plant, self.gains, generator, signal)
        if law is None:
            raise ArgumentError(
                "step must be given: the closed form of ExpectedPredictor in continuous time "
                f"loses its digits where the mode switches many times per delay, as here with "
                f"rates up to {generator.max():g} 1/s and a delay of {plant.longest_delay:g} s."
            )
        return law


def table_ages(model: SwitchingModel, step: float, requested: int | None, most: int) -> int | None:
    """How many ages a table distinguishes: all that matter, at most `requested`; None for one."""
    if requested is not None:
        require_room("ages", requested, step, most)
        return model.ages(step, most=requested)
    ages = model.ages(step, most=most + 1)  # one more shows that there is no room
    if ages is not None and ages > most:
        raise ArgumentError(
            f"step = {step:g} s needs a table of more than {most:,} ages, for which there is no "
            "room, so long are the model's sojourns: lengthen the step, or give `ages`, the most "
            "to distinguish."
        )
    return ages
