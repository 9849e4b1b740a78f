"""Fitting a semi-Markov model to logged signals with censored sojourns.

A sojourn with both ends in the log is complete. The last one of a log that ends is right-censored:
it lasted at least so long. The last one of a log without an end has no information. Complete
sojourns alone would be too short on average, because long ones are censored more often.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import count, instance
from deadtime.base.errors import ArgumentError
from deadtime.switching.constraint import PerMode
from deadtime.switching.models.sojourn_families import (
    EQUAL,
    FAMILIES,
    FAMILIES_BETWEEN,
    Goodness,
    Observed,
    estimate,
    estimate_between,
    require_between,
    require_family_between,
)
from deadtime.switching.models.sojourns import Distribution, Fixed
from deadtime.switching.signal import SwitchingSignal
from deadtime.switching.signal_class import SignalClass

if TYPE_CHECKING:
    Signals = SwitchingSignal | Sequence[SwitchingSignal]
else:
    Signals = object  # `check_signals` checks them, with better messages

LEAST = 5  # complete sojourns of each mode
MARGIN = 4.0  # of AIC, for a uniform family
NAMES = (*FAMILIES, "fixed")


def fit_model(
    signals: object,
    family: object = "auto",
    modes: int | None = None,
    first: str = "whole",
    transitions: ArrayLike | None = None,
    dwell_time: PerMode | None = None,
    maximum_dwell: PerMode | None = None,
) -> tuple[list[Distribution], Float[np.ndarray, "mode mode"], tuple[Goodness, ...]]:
    """Sojourn distributions, jump probabilities and goodness of a semi-Markov model.

    Distributions maximise the likelihood of complete and censored sojourns (see
    `switching.models.sojourn_families`); T_ij is the share of the switches out of mode i that lead
    to j. Beyond the longest logged sojourn the tail follows from the family alone; if the tail
    matters, give the family, for "auto" considers only the observed range.

    Few sojourns do not distinguish families: of 80 logs each with 5, 10, 20 and 50 complete
    sojourns, "auto" found a gamma (a = 3) in 5, 6, 21 and 44, a shifted exponential (loc 0.3, scale
    0.5) in 44, 67, 72 and 78, a uniform (0.2 to 1) in 0, 7, 43 and 76. Below about 50 in each mode,
    give the family.

    Parameters
    ----------
    signals : SwitchingSignal, or list of them
        The logs.
    family : str, or list of str with one per mode
        "exponential", "shifted exponential", "gamma", "weibull", "uniform", "lognormal",
        "fixed" (all sojourns equal within 1e-6), or "auto": fixed where that holds, else the
        family with the least AIC, a uniform only if it is the least by 4: laws rely on the end of
        its support, and a wrong end harms more than a wrong tail.
    modes : int, optional
        Number of modes; by default the largest in the logs, plus one.
    first : {"whole", "drop"}
        Whether logs begin with a switch or within a sojourn, which is then dropped. The first
        sojourn of a signal with an `initial_age` is dropped in any case.
    transitions : (modes, modes) of bool, optional
        The possible switches: a log with another one is refused.
    dwell_time, maximum_dwell : float, or one per mode, optional
        The shortest and the longest sojourn, seconds, if they are known: families are fitted as
        truncated there (`deadtime.switching.models.sojourn_families`). Shifted exponential and
        uniform ones are then excluded, because these limits are their parameters.

    Raises
    ------
    ArgumentError
        If a mode has fewer than 5 complete sojourns or one outside its limits, or its family
        cannot be fitted.

    References
    ----------
    Kaplan and Meier, "Nonparametric estimation from incomplete observations", JASA 53, 1958.
    Moore and Pyke, "Estimation of the transition distributions of a Markov renewal process",
    Annals of the Institute of Statistical Mathematics 20, 1968.
    """
    logs = check_signals(signals)
    observed = sojourns_of(logs, first, modes)
    if transitions is not None:
        allowed = SignalClass(transitions=transitions).limits(len(observed))
        for log in logs:
            log.require_within(allowed)
    names = _families(family, len(observed))
    for mode, seen in enumerate(observed):
        if seen.complete.size < LEAST:
            raise ArgumentError(
                f"signals hold only {seen.complete.size} complete sojourns of mode {mode}: at "
                f"least {LEAST} are needed to fit; log longer, or give SemiMarkov a distribution."
            )
    known = None
    if dwell_time is not None or maximum_dwell is not None:
        known = SignalClass(dwell_time, maximum_dwell).limits(len(observed))
    fits = []
    for i, pair in enumerate(zip(names, observed, strict=True)):
        ends = None if known is None else (known.dwell_time[i], known.maximum_dwell[i])
        fits.append(_fit_mode(i, *pair, ends))
    jumps = np.zeros((len(observed), len(observed)))
    for log in logs:
        np.add.at(jumps, (log.modes[:-1], log.modes[1:]), 1.0)
    sojourn, goodness = zip(*fits, strict=True)
    return list(sojourn), jumps / jumps.sum(axis=1, keepdims=True), goodness


def sojourns_of(
    signals: object, first: str = "whole", modes: int | None = None
) -> tuple[Observed, ...]:
    """The complete and the censored sojourns of every mode; see `fit_model`.

    Examples
    --------
    >>> log = SwitchingSignal([0.0, 0.5, 0.75], [0, 1, 0], end=2.0)
    >>> sojourns_of(log)[0]
    Observed(complete=array([0.5]), censored=array([1.25]))
    """
    logs = check_signals(signals)
    if first not in ("whole", "drop"):
        raise ArgumentError(f"first must be 'whole' or 'drop', got {first!r}.")
    number = 1 + max(int(log.modes.max()) for log in logs)
    if modes is not None:
        number = count("modes", modes, least=2)
        for log in logs:
            log.require_modes(number)
    complete: list[list[float]] = [[] for _ in range(number)]
    censored: list[list[float]] = [[] for _ in range(number)]
    for log in logs:
        dropped = int(first == "drop" or log.initial_age > 0.0)
        lengths = np.diff(log.times, append=log.end).tolist()
        visits = list(zip(log.modes.tolist(), lengths, strict=True))
        for mode, length in visits[dropped:-1]:
            complete[mode].append(length)
        for mode, length in visits[max(dropped, log.switches) :]:  # the last one, if it counts
            if length < np.inf:
                censored[mode].append(length)
    pairs = zip(complete, censored, strict=True)
    return tuple(Observed(np.array(sorted(a)), np.array(sorted(b))) for a, b in pairs)


def kaplan_meier(
    observed: Observed,
) -> tuple[Float[np.ndarray, " time"], Float[np.ndarray, " time"]]:
    """The observed times, and the Kaplan–Meier estimate of P(S > t) from each one on."""
    from scipy.stats import CensoredData, ecdf

    survival = ecdf(CensoredData(observed.complete, right=observed.censored)).sf
    return survival.quantiles, survival.probabilities


def distance(dist: Distribution, observed: Observed) -> float:
    """sup |F(t) − F_KM(t)| up to the longest observation, on both sides of every jump.

    For a fixed sojourn, complete ones within 1e-6 of it count as equal to it, and censored ones
    there are left out.
    """
    if isinstance(dist, Fixed):
        ended, cut = (
            np.abs(times - dist.length) <= EQUAL * dist.length
            for times in (observed.complete, observed.censored)
        )
        complete = np.sort(np.where(ended, dist.length, observed.complete))
        observed = Observed(complete, observed.censored[~cut])
    times, survival = kaplan_meier(observed)
    after = 1.0 - survival
    before = np.concatenate(([0.0], after[:-1]))
    low, high = dist.cdf(times * (1.0 - 1e-9)), dist.cdf(times)  # both sides of a jump of F
    return float(max(np.abs(low - before).max(), np.abs(high - after).max()))


def _fit_mode(
    mode: int, name: str, observed: Observed, ends: tuple[float, float] | None = None
) -> tuple[Distribution, Goodness]:
    """The distribution of a mode; `name` may be "auto", `ends` are its known limits."""
    from scipy.stats import kstwobign

    families = tuple(FAMILIES) if ends is None else FAMILIES_BETWEEN
    candidates = (name,) if name != "auto" else ("fixed",) if observed.fixed else families
    if ends is None:
        fits = {family: estimate(family, observed) for family in candidates}
    else:
        require_between(mode, observed, *ends)
        require_family_between("family", name)
        fits = {family: estimate_between(family, observed, *ends) for family in candidates}
    fitted = {family: fit for family, fit in fits.items() if fit is not None}
    if not fitted:
        other = "take 'auto'"
        if name == "auto":
            other = "give SemiMarkov a distribution, or fit without the limits"
        raise ArgumentError(
            f"family {name!r} cannot be fitted to the sojourns of mode {mode}, which last from "
            f"{observed.complete[0]:g} to {observed.complete[-1]:g} s: {other}."
        )
    # A wrong end of the support harms a law more than a wrong tail, so a uniform has a handicap.
    family = min(fitted, key=lambda key: fitted[key][2] + MARGIN * (key == "uniform"))
    dist, parameters, aic = fitted[family]
    n, gap = observed.complete.size, distance(dist, observed)
    p_value = float(kstwobign.sf(np.sqrt(n) * gap))
    return dist, Goodness(family, parameters, n, observed.censored.size, gap, p_value, aic)


def _families(family: object, modes: int) -> list[str]:
    single = not isinstance(family, (list, tuple))
    given = [family] * modes if single else list(family)
    if len(given) != modes:
        raise ArgumentError(f"family must have one entry per mode, {modes}, got {len(given)}.")
    names: list[str] = []
    for i, name in enumerate(given):
        if not isinstance(name, str) or name not in ("auto", *NAMES):
            raise ArgumentError(
                f"family{'' if single else f'[{i}]'} must be 'auto' or one of {', '.join(NAMES)}, "
                f"got {name!r}."
            )
        names.append(name)
    return names


def check_signals(signals: object) -> list[SwitchingSignal]:
    """The signals as a list."""
    if isinstance(signals, SwitchingSignal):
        return [signals]
    if not isinstance(signals, Sequence) or not signals:
        raise ArgumentError(
            "signals must be a SwitchingSignal or a list of at least one, got "
            f"{'an empty list' if isinstance(signals, Sequence) else type(signals).__name__}."
        )
    for i, signal in enumerate(signals):
        instance(f"signals[{i}]", signal, SwitchingSignal)
    return list(signals)
