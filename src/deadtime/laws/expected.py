"""Expected predictor feedback: the mean of the exact one over a stochastic model of switching."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import count
from deadtime.base.errors import ArgumentError
from deadtime.feedback import Feedback, Functional
from deadtime.feedback.known_state import Known
from deadtime.feedback.law import TableLaw, remember_table, require_room, room
from deadtime.feedback.prediction_rows import extended_gains
from deadtime.gains.checked_gains import check_gains
from deadtime.plant import SwitchedSystem
from deadtime.switching import Markov, SemiMarkov, SwitchingSignal
from deadtime.switching.models.checked_models import require_model


@dataclass(frozen=True, eq=False, init=False, repr=False)
class ExpectedPredictor(TableLaw):
    """Expectation of exact predictor feedback, given the current mode and how old it is.

        u(t) = E[ K_σ(t+D) P(t) | σ(t), age(t) ],    P(t) = x(t + D) for that future

    Under a Markov model the age tells nothing and the table has one row per mode, from block
    exponentials without a time grid. Under a semi-Markov model it has one row per mode and age;
    switches are taken to happen at samples, which is exact for switches on the grid and O(h)
    otherwise.

    Parameters
    ----------
    plant : SwitchedSystem
        The law's model of the plant.
    gains : array_like, shape (modes, m, n)
        K_i of u = +K_i x.
    model : Markov or SemiMarkov
        How the mode switches, with as many modes as the plant.
    ages : int, optional
        The most ages (samples) that a semi-Markov table tells apart; older modes count as that
        old. By default as many as matter to the model.
    allow_unstable : bool
        Accept gains that leave some A_i + B_i K_i unstable.

    Raises
    ------
    ArgumentError
        If the model has another number of modes than the plant or is no switching model;
        `digital` raises it if the step is too long for the model's sojourns, or the table would
        take more than 1 GB; `simulate` with `step=None` if the model is semi-Markov or switches
        many times per delay.

    Notes
    -----
    A table holds modes · ages · N · m² numbers of 8 bytes, and filling it needs as much again:
    2 modes, 1,000 ages and N = 1,000 take 16 MB for one input.

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
    model: Markov | SemiMarkov
    ages: int | None
    allow_unstable: bool

    def __init__(
        self,
        plant: SwitchedSystem,
        gains: ArrayLike,
        model: Markov | SemiMarkov,
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

    @remember_table
    def digital(
        self, step: float, signal: SwitchingSignal | None = None, steps: int | None = None
    ) -> Feedback:
        plant, model, sampled = self.plant, self.model, self.sampled_plant(step)
        if isinstance(model, Markov):
            from deadtime.laws.tables.markov import markov_table

            return markov_table(plant.A, plant.B, self.gains, model.generator, sampled)
        from deadtime.laws.tables.semi_markov import semi_markov_table

        h, longest = sampled.step, sampled.longest_lag
        most = room(8 * plant.modes * longest * plant.inputs**2)
        ages = table_ages(model, h, self.ages, most)
        chain = model.hazard(h, ages + longest), model.transition
        return semi_markov_table(self.gains, *chain, ages, sampled)

    def extend(self, plant: SwitchedSystem, rows: Float[np.ndarray, "future r n"]) -> TableLaw:
        gains = extended_gains(self.gains, rows)
        return ExpectedPredictor(plant, gains, self.model, ages=self.ages, allow_unstable=True)

    def spread(
        self, step: float, known: Known, W: Float[np.ndarray, "*mode n n"]
    ) -> Float[np.ndarray, "case input future n n"]:
        sampled = self.sampled_plant(step)
        if isinstance(self.model, Markov):
            from deadtime.laws.spread.markov import markov_spread

            return markov_spread(sampled, self.model.generator, known, W)
        from deadtime.laws.spread.semi_markov import semi_markov_spread

        ages = self.digital(step).ages
        hazard = self.model.hazard(step, ages + sampled.longest_lag)
        return semi_markov_spread(sampled, hazard, self.model.transition, ages, known, W)

    def ideal(self, signal: SwitchingSignal, horizon: float) -> Functional:
        plant, model = self.plant, self.model
        if not isinstance(model, Markov):
            raise ArgumentError(
                "step must be given: ExpectedPredictor has no closed form in continuous time "
                "under a SemiMarkov model."
            )
        from deadtime.laws.tables.passage_windows import passage_functional

        law = passage_functional(plant, self.gains, model.generator, signal)
        if law is None:
            raise ArgumentError(
                "step must be given: the closed form of ExpectedPredictor in continuous time "
                f"loses its digits where the mode switches many times per delay, as here with "
                f"rates up to {model.rates.max():g} 1/s and a delay of {plant.longest_delay:g} s."
            )
        return law


def table_ages(model: SemiMarkov, step: float, asked: int | None, most: int) -> int:
    """How many ages a table tells apart: as many as matter, or no more than asked for."""
    if asked is not None:
        require_room("ages", asked, step, most)
        return model.ages(step, most=asked)
    ages = model.ages(step, most=most + 1)
    if ages > most:
        raise ArgumentError(
            f"step = {step:g} s asks for a table of more than the {most:,} ages that there is "
            "room for, so long are the model's sojourns: lengthen it, or give `ages`, the most to "
            "tell apart."
        )
    return ages
