"""Semi-Markov switching: sojourns of any distribution, and jumps that depend on the mode only.

Controllers use hazards on the grid of samples: a mode of age a has been active for a h seconds.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from deadtime.base.checks import count, number, positive, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.switching.constraint import PerMode
from deadtime.switching.models.fit import Signals, fit_model
from deadtime.switching.models.jump_process import JumpProcess, Quantiles, Switches
from deadtime.switching.models.model import (
    SampledChain,
    SwitchingModel,
    check_probabilities,
    rows_text,
)
from deadtime.switching.models.sojourn_families import Goodness
from deadtime.switching.models.sojourns import (
    Distribution,
    Truncated,
    check_sojourns,
    describe,
    in_words,
    limits,
    log_survival,
    mean_sojourn,
    survival,
    toml_text,
    truncate,
)
from deadtime.switching.signal_class import SignalClass

if TYPE_CHECKING:
    Sojourn = Distribution | float | Sequence[Distribution | float]
    Families = str | Sequence[str]
else:
    Sojourn = Families = object  # checked inside, with better messages

MOST_AGES = 100_000
SURVIVAL = 1e-6  # ages that a sojourn reaches with less probability need no hazard
_STEEP = 1e-6  # decrease of log P(S > t) within 1e-9 h: an atom, or the end of the support


def hazards(
    dist: Distribution, step: float, ages: Int[np.ndarray, " age"]
) -> Float[np.ndarray, " age"]:
    """haz(a) = P(S ≤ (a+1) h | S > a h) = 1 − exp(logsf((a+1) h) − logsf(a h)); 1 if S ≤ a h.

    An atom or an end of the support within 1e-9 h after a sample counts as at the sample: where
    survival decreases steeply between k h and (k + 1e-9) h, its value at the second is taken.
    """
    from deadtime.plant.discretisation import TOLERANCE

    samples = np.union1d(ages, ages + 1)
    at, past = (log_survival(dist, (samples + late) * step) for late in (0.0, TOLERANCE))
    with np.errstate(invalid="ignore"):
        # An atom at a sample counts from just after it, as switches snap to samples.
        log = np.where(at - past < _STEEP, at, past)
        log = np.where(samples > 0, log, 0.0)
        before, after = (log[np.searchsorted(samples, sample)] for sample in (ages, ages + 1))
        result = -np.expm1(np.minimum(after - before, 0.0))
    return np.where(np.isnan(result), 1.0, result + 0.0)  # 0, not −0


def count_ages(name: str, dist: Distribution, step: float, most: int | None = None) -> int:
    """Number of ages with different hazards: later ones have the last hazard, or hardly occur.

    It is at most `most`; without that, more than 100,000 are refused.
    """
    from deadtime.plant.discretisation import TOLERANCE

    def rare(n: int) -> bool:
        return survival(dist, (n + TOLERANCE) * step) < SURVIVAL

    bound = 1
    while bound < 2**40 and not rare(bound):  # no distribution is asked far beyond its tail
        bound *= 2
    last = 1 + bisect_left(range(1, bound), True, key=rare)
    final = hazards(dist, step, np.array([last - 1]))

    def latest(ages: Int[np.ndarray, " age"]) -> int:
        """The latest of these ages whose hazard differs from the final one; −1 if none does."""
        differing = np.flatnonzero(np.abs(hazards(dist, step, ages) - final) > 1e-12)
        return int(ages[differing[-1]]) if differing.size else -1

    limit = max(MOST_AGES, most or 0)
    number = 0
    if last > limit:  # a hazard such as an exponential's is constant long before
        number = latest(np.geomspace(limit, last - 1, 1000).astype(np.int64)) + 2
    # Backwards in blocks, because the latest difference is usually among the last ages.
    for end in range(min(last, limit), 0, -MOST_AGES):
        number = number if number > 1 else latest(np.arange(max(0, end - MOST_AGES), end)) + 2
    if number > limit and most is None:
        raise ArgumentError(
            f"step = {step:g} s is too short for {name} = {describe(dist)}: its hazard still "
            f"changes after {MOST_AGES:,} steps, which it outlives with probability "
            f"{survival(dist, MOST_AGES * step):.2g}; lengthen the step, or limit the number of "
            "ages by `most`."
        )
    return number if most is None else min(number, most)


def require_short(step: float, sojourn: tuple[Distribution, ...]) -> float:
    """The step, if every mode's median sojourn is at least two steps."""
    step = positive("step", step)
    for mode, dist in enumerate(sojourn):
        if survival(dist, 2.0 * step * (1.0 - 1e-9)) < 0.5:
            low, median = step, 2.0 * step
            while survival(dist, low) < 0.5:
                low, median = low / 2.0, low
            for _ in range(60):
                middle = (low + median) / 2.0
                if survival(dist, middle) >= 0.5:
                    low = middle
                else:
                    median = middle
            longest = median / 2.0
            unit = 10.0 ** (np.floor(np.log10(longest)) - 3.0)
            raise ArgumentError(
                f"step = {step:g} s is too long for the sojourns: half of those in mode {mode} "
                f"last at most {median:.4g} s, less than two steps; take at most "
                f"{np.floor(longest / unit) * unit:.4g} s."
            )
    return step


@dataclass(frozen=True, eq=False, init=False, repr=False)
class SemiMarkov(SwitchingModel):
    r"""A semi-Markov process of modes, with sojourns of any distribution.

    It stays in mode i for a random time :math:`S_i`, then jumps to mode j, independently of the
    past.

    .. math::

        P(S_i > t) = \mathrm{sf}_i(t), \quad P(\text{next mode is } j) = T_{ij}

    Signals start in a uniformly drawn mode, at the beginning of its sojourn.

    Parameters
    ----------
    sojourn : distribution, number, or a list of them with one per mode
        :math:`S_i` in seconds: a frozen distribution of scipy.stats, another object with vectorised
        ``cdf``, and ``sf`` or ``logsf``, or a number for a fixed sojourn. A single one holds for
        every mode. Sampling is fast if ``isf`` or ``ppf`` has a formula.
    transition : array_like, shape (modes, modes), optional
        :math:`T_{ij} \ge 0` with rows that sum to 1 and a zero diagonal; by default all other modes
        are equally likely.
    modes : int, optional
        Number of modes, if neither of the above has one entry per mode; 2 by default.
    dwell_time, maximum_dwell : float, or one per mode, optional
        The shortest and the longest sojourn, seconds, at which the distributions are truncated.
        Transitions are excluded by zeros of `transition`.

    Attributes
    ----------
    sojourn : tuple of distributions
        One per mode.
    goodness : tuple of Goodness, or None
        Goodness of fit of each mode's distribution, if the model is from `fit`.

    Raises
    ------
    ArgumentError
        If there are fewer than two modes, the arguments have different numbers of modes, a sojourn
        is no distribution of positive times, a mode has no sojourn between its limits, or the rows
        of `transition` are no probabilities.

    References
    ----------
    Howard, "Dynamic Probabilistic Systems, volume II: Semi-Markov and Decision Processes",
    Wiley 1971, chapter 10.

    Examples
    --------
    >>> from scipy.stats import expon
    >>> from deadtime import SemiMarkov
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
            bounds = SignalClass(dwell_time, maximum_dwell).limits(number)
            ends = zip(sojourns, bounds.dwell_time, bounds.maximum_dwell, strict=True)
            sojourns = tuple(truncate(f"sojourn[{i}]", *each) for i, each in enumerate(ends))
        if table is None:
            table = (1.0 - np.eye(number)) / (number - 1)
            table.flags.writeable = False
        vars(self).update(sojourn=sojourns, transition=table, goodness=None)

    @property
    def modes(self) -> int:
        return len(self.sojourn)

    @property
    def transitions(self) -> Bool[np.ndarray, "mode mode"]:
        return self.transition > 0.0

    @cached_property  # integrals, where a distribution has no formula
    def mean(  # pyright: ignore[reportIncompatibleMethodOverride]
        self,
    ) -> Float[np.ndarray, " mode"]:
        means = np.array([mean_sojourn(dist) for dist in self.sojourn])
        means.flags.writeable = False
        return means

    def switches(self, horizon: float, seed: int = 0, first: int = 0, count: int = 1) -> Switches:
        sojourn = Quantiles.of(self.sojourn)
        process = JumpProcess(sojourn, self.transition, float(self.mean.max()))
        return process.draw(horizon, seed, first, count)

    def hazard(self, step: float, ages: int) -> Float[np.ndarray, "mode age"]:
        r"""Probability that a sojourn longer than a samples ends by the next one.

        .. math::

            q_{i,a} = P(S_i \le (a + 1) h \mid S_i > a h), \quad a = 0, \dots, \text{ages} - 1

        It is 1 if no sojourn is longer than a h. An atom or an end of the support within 1e-9 h of
        a multiple of h counts as that multiple.

        Parameters
        ----------
        step : float
            Sampling period h, seconds; at most half the median sojourn of every mode.
        ages : int
            Number of ages, at least 1.

        Returns
        -------
        (modes, ages) array

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

    def chain(self, step: float, ages: int = 1) -> SampledChain:
        return SampledChain(self.hazard(step, ages), self.transition.copy(), within=True)

    def ages(self, step: float, most: int | None = None) -> int:
        """Number of ages, in samples, after which the hazards of all modes are constant.

        Later ages have the hazard of the last one to 1e-12, or are reached by less than one sojourn
        in a million.

        Parameters
        ----------
        step : float
            Sampling period h, seconds; at most half the median sojourn of every mode.
        most : int, optional
            Upper limit of the number, at least 1. At the limit later ages may still differ:
            ``outlives(most * step)`` is the share of sojourns that reach them.

        Raises
        ------
        ArgumentError
            If the step is too long for the sojourns of some mode, or, without `most`, so short
            that more than 100,000 ages are needed.

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
        r""":math:`P(S_i > \text{time})` for every mode, `time` in seconds.

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

        Logs are refused if `transitions` excludes a switch, or if a sojourn is not between
        `dwell_time` and `maximum_dwell`; with these limits families are fitted as truncated. See
        `deadtime.switching.models.fit.fit_model` for the other arguments, and for the reliability
        of few sojourns: with fewer than about 50 per mode, give the family.

        Examples
        --------
        >>> from scipy.stats import gamma
        >>> log = SemiMarkov(gamma(4.0, scale=0.2)).sample(400.0, seed=1)
        >>> SemiMarkov.fit(log, family="gamma").mean.round(2)
        array([0.79, 0.78])
        """
        sojourn, transition, goodness = fit_model(
            signals, family, modes, first, transitions, dwell_time, maximum_dwell
        )
        model = cls(sojourn, transition)
        vars(model).update(goodness=goodness)
        return model

    def section(self) -> str:
        """The model as the [switching] section of a problem file.

        Examples
        --------
        >>> from scipy.stats import expon
        >>> print(SemiMarkov([0.5, expon(loc=0.2, scale=0.3)]).section())
        [switching]
        kind = "semi-markov"
        sojourn = [
          0.5,
          { distribution = "expon", loc = 0.2, scale = 0.3 },
        ]
        transition = [
          [0.0, 1.0],
          [1.0, 0.0],
        ]
        """
        whole = [dist.dist if isinstance(dist, Truncated) else dist for dist in self.sojourn]
        sojourns = "".join(f"  {toml_text(dist)},\n" for dist in whole)
        rows = rows_text("transition", self.transition)
        text = f'[switching]\nkind = "semi-markov"\nsojourn = [\n{sojourns}]\n{rows}'
        if any(isinstance(dist, Truncated) for dist in self.sojourn):
            least, most = zip(*map(limits, self.sojourn), strict=True)
            text += f"\ndwell_time = {list(least)}\nmaximum_dwell = {list(most)}"
        return text

    @property
    def in_words(self) -> str:
        """The sojourns in words, without what follows a mode.

        Examples
        --------
        >>> from scipy.stats import expon
        >>> SemiMarkov(expon(loc=1.0, scale=1.0), modes=2).in_words
        'sojourns 1 s plus exponential, mean 2 s'
        >>> SemiMarkov([0.5, expon(scale=2.0)]).in_words
        'sojourns 0.5 s in mode 0, exponential, mean 2 s in mode 1'
        """
        each = [in_words(dist) for dist in self.sojourn]
        if len(set(each)) == 1:
            return f"sojourns {each[0]}"
        return f"sojourns {', '.join(f'{text} in mode {i}' for i, text in enumerate(each))}"

    def __repr__(self) -> str:
        sojourns = ", ".join(map(describe, self.sojourn))
        return f"SemiMarkov(modes={self.modes}, sojourn=[{sojourns}])"


def _transition(transition: ArrayLike) -> Float[np.ndarray, "mode mode"]:
    """Probabilities of the next mode, rows summing to 1 and a zero diagonal."""
    table = real_array("transition", transition, "(modes, modes)", 2)
    require_shape("transition", table, (len(table), len(table)), "(modes, modes)")
    if len(table) < 2:
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
    return check_probabilities("transition", table)
