"""Semi-Markov switching: any distribution of sojourns, then a jump that forgets the past."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from deadtime.base.checks import count, number, real_array, require_probabilities, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.switching.constraint import PerMode, SwitchingConstraint
from deadtime.switching.models.hazards import count_ages, hazards, require_short
from deadtime.switching.models.jump_process import JumpProcess
from deadtime.switching.models.model import JumpModel
from deadtime.switching.models.quantiles import Quantiles
from deadtime.switching.models.sojourn_families import Goodness
from deadtime.switching.models.sojourns import (
    Distribution,
    check_sojourns,
    describe,
    mean_sojourn,
    survival,
)
from deadtime.switching.models.truncation import truncate
from deadtime.switching.signal import SwitchingSignal

if TYPE_CHECKING:
    Sojourn = Distribution | float | Sequence[Distribution | float]
    Signals = SwitchingSignal | Sequence[SwitchingSignal]
    Families = str | Sequence[str]
else:
    Sojourn = Signals = Families = object  # checked inside, with better messages


@dataclass(frozen=True, eq=False, init=False, repr=False)
class SemiMarkov(JumpModel):
    """A semi-Markov process of modes: stay in mode i for a random time S_i, then jump to mode j.

        P(S_i > t) = sf_i(t),    P(next mode is j) = T_ij,  whatever happened before

    Signals start in a uniformly drawn mode, at the beginning of its sojourn.

    Parameters
    ----------
    sojourn : distribution, number, or a list of them with one per mode
        S_i in seconds: a frozen distribution of scipy.stats, anything else with vectorised
        ``cdf``, and ``sf`` or ``logsf``, or a number for a fixed sojourn. A single one holds for
        every mode. Signals are drawn fast where it has a formula for ``isf`` or ``ppf``.
    transition : array_like, shape (modes, modes), optional
        T_ij ≥ 0 with rows that sum to 1 and a zero diagonal; by default all other modes are
        equally likely.
    modes : int, optional
        Number of modes, where neither of the above tells; 2 by default.
    dwell_time, maximum_dwell : float, or one per mode, optional
        The shortest and the longest sojourn, seconds: sojourns are as given, but only those in
        between are drawn. Which mode may follow which is said by the zeros of `transition`.

    Attributes
    ----------
    sojourn : tuple of distributions
        One per mode.
    goodness : tuple of Goodness, or None
        How well each mode's distribution fits the logs that `fit` read.

    Raises
    ------
    ArgumentError
        If there are fewer than two modes, the arguments disagree on how many, a sojourn is no
        distribution of positive times, none of a mode lies between its shortest and longest one,
        or the rows of `transition` are no probabilities.

    References
    ----------
    Howard, "Dynamic Probabilistic Systems, volume II: Semi-Markov and Decision Processes",
    Wiley 1971, chapter 10.

    Examples
    --------
    >>> from scipy.stats import expon
    >>> from deadtime.switching import SemiMarkov
    >>> model = SemiMarkov([expon(loc=0.3, scale=0.5), 0.4])
    >>> model
    SemiMarkov(modes=2, sojourn=[expon(loc=0.3, scale=0.5), 0.4])
    >>> model.hazard(step=0.1, ages=5).round(3)
    array([[0.   , 0.   , 0.   , 0.181, 0.181],
           [0.   , 0.   , 0.   , 1.   , 1.   ]])
    >>> model.sample(2.0, seed=3).switches
    2
    """

    sojourn: tuple[Distribution, ...]
    transition: Float[np.ndarray, "mode mode"]
    goodness: tuple[Goodness, ...] | None

    def __init__(
        self,
        sojourn: Sojourn,
        transition: ArrayLike | None = None,
        *,
        modes: int | None = None,
        dwell_time: PerMode | None = None,
        maximum_dwell: PerMode | None = None,
    ) -> None:
        table = None if transition is None else _transition(transition)
        number = None if modes is None else count("modes", modes, least=2)
        if table is not None:
            if number is not None and table.shape[0] != number:
                raise ArgumentError(
                    f"modes = {number} and transition with {table.shape[0]} rows disagree: give "
                    "one of them."
                )
            number = table.shape[0]
        sojourns = check_sojourns(sojourn, number)
        number = len(sojourns)
        if dwell_time is not None or maximum_dwell is not None:
            bounds = SwitchingConstraint.of(number, dwell_time, maximum_dwell)
            ends = zip(sojourns, bounds.dwell_time, bounds.maximum_dwell, strict=True)
            sojourns = tuple(truncate(f"sojourn[{i}]", *each) for i, each in enumerate(ends))
        if table is None:
            table = (1.0 - np.eye(number)) / (number - 1)
            table.flags.writeable = False
        vars(self).update(sojourn=sojourns, transition=table, goodness=None)

    @property
    def modes(self) -> int:
        """Number of modes."""
        return len(self.sojourn)

    @property
    def transitions(self) -> Bool[np.ndarray, "mode mode"]:
        """Whether a signal may switch from mode i (row) to mode j (column), as `certify` takes it.

        Examples
        --------
        >>> SemiMarkov(0.3, [[0, 1, 0], [0, 0, 1], [0.5, 0.5, 0]]).transitions.astype(int)
        array([[0, 1, 0],
               [0, 0, 1],
               [1, 1, 0]])
        """
        return self.transition > 0.0

    @cached_property
    def mean(self) -> Float[np.ndarray, " mode"]:
        """Mean sojourn in each mode, seconds."""
        means = np.array([mean_sojourn(dist) for dist in self.sojourn])
        means.flags.writeable = False
        return means

    @property
    def process(self) -> JumpProcess:
        """Sojourns by the inverse survival functions, and jumps by the transition."""
        return JumpProcess(Quantiles.of(self.sojourn), self.transition, float(self.mean.max()))

    def hazard(self, step: float, ages: int) -> Float[np.ndarray, "mode age"]:
        """Probability that a sojourn which outlasted a samples ends by the next one.

            haz_i(a) = P(S_i ≤ (a + 1) h | S_i > a h),    a = 0, …, ages − 1

        It is 1 where no sojourn outlasts a h. An atom or an end of the support whose ratio to
        h is within 1e-9 of an integer counts as that multiple of h.

        Parameters
        ----------
        step : float
            Sampling period h, seconds; at most half the median sojourn of every mode.
        ages : int
            How many ages, at least 1.

        Raises
        ------
        ArgumentError
            If the step is too long for the sojourns of some mode.

        Examples
        --------
        >>> SemiMarkov(0.3).hazard(step=0.1, ages=3)  # though 0.3/0.1 < 3 in floats
        array([[0., 0., 1.],
               [0., 0., 1.]])
        """
        step = require_short(step, self.sojourn)
        range_of_ages = np.arange(count("ages", ages))
        return np.stack([hazards(dist, step, range_of_ages) for dist in self.sojourn])

    def ages(self, step: float, most: int | None = None) -> int:
        """Number of ages, in samples, after which the hazards of all modes have settled.

        A mode's later ages have the hazard of the last one to 1e-12, or are reached by less
        than one sojourn in a million.

        Parameters
        ----------
        step : float
            Sampling period h, seconds; at most half the median sojourn of every mode.
        most : int, optional
            Where the count stops, at least 1. If it stops there, later ages may still differ:
            `outlives(most · step)` tells how many sojourns reach them.

        Raises
        ------
        ArgumentError
            If the step is too long for the sojourns of some mode, or, without `most`, so short
            that more than 100,000 ages would be needed.

        Examples
        --------
        >>> from scipy.stats import expon
        >>> SemiMarkov(expon(loc=0.3, scale=0.5)).ages(step=0.1)
        4
        >>> SemiMarkov(3600.0).ages(step=0.01, most=500)
        500
        """
        step = require_short(step, self.sojourn)
        most = None if most is None else count("most", most)
        return max(
            count_ages(f"sojourn[{mode}]", dist, step, most)
            for mode, dist in enumerate(self.sojourn)
        )

    def outlives(self, time: float) -> Float[np.ndarray, " mode"]:
        """P(S_i > time) for every mode, `time` in seconds.

        Examples
        --------
        >>> from scipy.stats import expon
        >>> SemiMarkov([expon(scale=0.5), 0.4]).outlives(0.5).round(3)
        array([0.368, 0.   ])
        """
        time = number("time", time)
        return np.array([survival(dist, time) for dist in self.sojourn])

    @classmethod
    def fit(
        cls,
        signals: Signals,
        *,
        family: Families = "auto",
        modes: int | None = None,
        first: str = "whole",
        transitions: ArrayLike | None = None,
        dwell_time: PerMode | None = None,
        maximum_dwell: PerMode | None = None,
    ) -> SemiMarkov:
        """The model of maximum likelihood for logged signals.

        Logs with a switch that `transitions` does not allow are refused, by their first one, and
        with a sojourn that is not between `dwell_time` and `maximum_dwell`, where these are known;
        families are then fitted as truncated there. See
        `deadtime.switching.models.fit.fit_model` for what the other arguments mean, and what few
        sojourns are worth: with fewer than about 50 per mode, name the family.

        Examples
        --------
        >>> from scipy.stats import gamma
        >>> log = SemiMarkov(gamma(4.0, scale=0.2)).sample(400.0, seed=1)
        >>> SemiMarkov.fit(log, family="gamma").mean.round(2)
        array([0.79, 0.78])
        """
        from deadtime.switching.models.fit import fit_model

        sojourn, transition, goodness = fit_model(
            signals, family, modes, first, transitions, dwell_time, maximum_dwell
        )
        model = cls(sojourn, transition)
        vars(model).update(goodness=goodness)
        return model

    def __repr__(self) -> str:
        sojourns = ", ".join(map(describe, self.sojourn))
        return f"SemiMarkov(modes={self.modes}, sojourn=[{sojourns}])"


def _transition(transition: ArrayLike) -> Float[np.ndarray, "mode mode"]:
    """Probabilities of the next mode, rows summing to 1."""
    table = real_array("transition", transition, "(modes, modes)", 2)
    modes = table.shape[0]
    require_shape("transition", table, (modes, modes), "(modes, modes)")
    if modes < 2:
        raise ArgumentError(
            "transition must be given for at least two modes, got 1: a signal that never "
            "switches is SwitchingSignal.constant(mode)."
        )
    for i, row in enumerate(table):
        if row[i] != 0.0:
            raise ArgumentError(
                f"transition[{i}, {i}] must be 0, got {row[i]:g}: a jump leads to another mode, "
                "so divide the rest of the row by its sum and lengthen the sojourn instead."
            )
        require_probabilities(f"transition[{i}]", row)
    return table
