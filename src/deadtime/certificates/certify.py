"""Certify: stability of the digital loop for every admissible signal, proved by machine.

First the constant modes: one that grows is a witness against stability. Then Lyapunov functions,
the common one first, then those of mode and age, linear in the age or along stretches of periods
(`dwell`), each proposal judged by the check of `proof`. When none is found the search for a bad
signal has the last word.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Unpack

import numpy as np

from deadtime.base.checks import instance, number, positive, reporter
from deadtime.base.errors import ArgumentError, DeadtimeError
from deadtime.certificates.certificate import Certificate
from deadtime.certificates.dwell.evidence_search import EvidenceSearch, Freedom
from deadtime.certificates.dwell.stretch_program import whole
from deadtime.certificates.dwell.stretch_search import StretchSearch
from deadtime.certificates.proof import Check, Evidence, StretchEvidence
from deadtime.certificates.proof.delays import Delays, Range
from deadtime.certificates.proof.evidence import Setting
from deadtime.certificates.reach import (
    Plants,
    extremes,
    neutral,
    out_of_reach,
    plants_of,
    reported_late,
    too_large,
    too_many_reported,
    why_unmoved,
)
from deadtime.feedback import Feedback, Law
from deadtime.feedback.recurrence import recurrence_of, with_lost_rows
from deadtime.plant import SwitchedSystem
from deadtime.spectrum import aged_row, constant_growth, least_growth, with_memory
from deadtime.switching import SignalClass
from deadtime.switching.constraint import PerMode
from deadtime.switching.signal_class import SignalOptions

LEVELS = (Freedom(0), Freedom(2), None, Freedom(4))  # None: along stretches
# For laws with a state, where the filters of left eigenvectors lose digits, and for average dwell
# times, where the levels of the bucket are many: stretches come before eigenvectors.
EARLY_LEVELS = (Freedom(0), None, Freedom(2), Freedom(4))
AGE_LEVELS = (Freedom(0), None, Freedom(2, 3))  # where the rows change with the age, V must, too
FEW_AGES = 10  # so few that S may be one for each
LARGE = 400  # order from which the last levels cost more than they bring, as for delay ranges
PARTS = (0.9, 0.6, 0.3, 0.1)  # of what the modes alone allow, tried as the certified decay
SURPLUS = 1e-12  # of ρ: a requested rate is then not missed by rounding


def certify(
    plant: Plants,
    law: Law,
    dwell_time: PerMode | SignalClass,
    step: float = 0.01,
    *,
    delays: Range | None = None,
    decay_rate: float | None = None,
    search_signals: bool = True,
    progress: Callable[[str], None] | None = None,
    **signals: Unpack[SignalOptions],
) -> Certificate:
    r"""Prove or refute that a digital loop is stable for every switching signal with a dwell time.

    Switches may fall anywhere, not only on the sampling grid. The answer is True with a Lyapunov
    function, False with a signal under which the loop provably grows, or None with a reason.

    Parameters
    ----------
    plant : SwitchedSystem, a sequence of them, or UncertainPlant
        The plant, which may differ from the law's model; a sequence gives the corners of a
        polytope of plants (of the same delays). An uncertain plant stands for all plants whose A
        and B lie in its ellipsoid of 95 %, with every delay in its interval of 95 %; with k delays
        the true plant is among them with a probability of 95 − 5 k % or more.
    law : Law
        A law that is a table: one row, a row per mode, or a row per mode and age; or an
        `OutputFeedback` of one, for which the whole loop is certified: the state, the estimate,
        the sums of errors and the inputs in flight, at a reference and a disturbance of 0.
    dwell_time : float, one per mode, or SignalClass
        Shortest sojourn :math:`\tau_d`, in seconds, more than one period; or the class of signals.
    step : float
        Sampling period h, in seconds.
    delays : (low, high), optional
        A range of the plant's true delay, in seconds, within which it is constant; by default the
        plant's delay, or delays, and of an uncertain plant their intervals. The law's table does
        not change. low and high may have any form that `SwitchedSystem` takes as delays: then every
        input's delay in every mode is any value between its own two, independently of the others.
        Each range lies in one period.
    decay_rate : float, optional
        The rate to certify, 1/s; by default one close to the slowest mode's, or with
        `maximum_dwell` the best tried.
    search_signals : bool
        Whether to look for a signal under which the loop grows where no certificate is found.
    progress : callable, optional
        Called with a short text before each attempt, in the thread of `certify`.
    **signals
        Further options of the signals: `maximum_dwell`, `transitions`, `at`, `clock_tolerance`,
        `mode_lag`, `lost_samples` and `chatter`, as `SignalClass` takes them.

    Returns
    -------
    Certificate

    Raises
    ------
    ArgumentError
        If an argument is malformed, or law and plant do not belong together.

    Notes
    -----
    See docs/certificates.md for what is proved and how; `proof.evidence` has the inequalities.
    Order d = n + N m: with N = 100 a second or two, with N = 1,000 half a minute.

    Examples
    --------
    >>> import deadtime as dt
    >>> plant = dt.problems.paper().plant.apart(0.5)
    >>> law = dt.AveragedPredictor(plant, dt.place(plant, [-1.0, -2.0]))
    >>> certificate = certify(plant, law, dwell_time=0.2, step=0.1)
    >>> certificate.stable, certificate.proven
    (True, True)
    """
    progress = reporter("progress", progress)
    instance("law", law, Law)
    plants, plant, delays = plants_of(plant, law, delays)
    step = positive("step", step)
    asked, modes = SignalClass.of(dwell_time, **signals), plant.modes
    asked.require_clock()
    asked.at_period(modes, step)
    if decay_rate is not None and number("decay_rate", decay_rate) < 0.0:
        raise ArgumentError(f"decay_rate must be ≥ 0, in 1/s, got {decay_rate:g}.")
    reason = out_of_reach(modes, law, asked, step)
    reason = reason or why_unmoved(plants)
    table = None if reason else recurrence_of(law, step)
    if table is None:
        return Certificate(None, reason)
    late = reported_late(law, asked.mode_lag)
    if late:
        return Certificate(None, late)
    if modes == 1 or table.context == "none":
        asked = replace(asked, mode_lag=0)
    if not (np.any(table.state_gain) or np.any(table.input_gain)):
        asked = replace(asked, lost_samples=0)
    table = with_lost_rows(law, table) if asked.lost_samples else table
    setting = Setting(
        plants,
        Delays.of(delays, plant, step),
        table.state_gain,
        table.input_gain,
        table.context,
        table.ages,
        step,
        asked,
        table.memory,
    )
    reason = too_many_reported(setting) or too_large(setting.order)
    if reason:
        return Certificate(None, reason)
    return _decide(law, table, setting, decay_rate, search_signals, progress)


def _decide(
    law: Law,
    table: Feedback,
    setting: Setting,
    wanted: float | None,
    search_signals: bool,
    progress: Callable[[str], None],
) -> Certificate:
    corners = extremes(setting.plants, setting.delays, table)
    held = [
        (constant_growth(with_memory(one, table), table, mode, aged_row(table, mode)), mode, one)
        for one in corners
        for mode in range(one.modes)
    ]
    lasting = setting.limits.lasting
    if lasting:
        constant = (one for one in held if one[1] in lasting)
        slowest, mode, corner = max(constant, key=lambda item: item[0])
        least = least_growth(corner)
        if slowest > least and not search_signals:
            return Certificate(None, f"Held in mode {mode} it grows at {slowest:+.4g} 1/s.")
        if slowest > least:
            refuted = _refute(corner, law, setting, f"held in mode {mode} it grows")
            if refuted.stable is False:
                return refuted
        if wanted is not None and slowest > -wanted:
            return Certificate(
                None,
                f"decay_rate = {wanted:g} 1/s is more than a constant mode has: the slowest decays "
                f"at {-slowest:.4g} 1/s.",
            )
        if abs(slowest) <= least:
            # No Lyapunov function decreases here, so only a search for growth is left.
            kept = neutral(corner, mode, slowest)
            worst = _refute(corner, law, setting, "") if search_signals else None
            return worst if worst is not None and worst.stable is False else Certificate(None, kept)
        fastest = max(0.0, -slowest)
    else:  # no mode lasts: the loop decays at best as in the fastest mode
        fastest = max(0.0, *(-rate for rate, _, _ in held))
    # With lost samples a search for a bad pattern takes seconds, a Lyapunov function minutes.
    early = search_signals and setting.signals.lost_samples > 0
    searched = _searched(corners, law, setting, progress) if early else []
    if searched and searched[-1].stable is False:
        return searched[-1]
    rates = [part * fastest for part in PARTS if fastest > 0.0] + [0.0]
    rates = rates if wanted is None else [wanted]
    evidence, outcome = _evidence(setting, rates, progress)
    if evidence is not None:
        return Certificate.of(evidence, outcome)
    if not search_signals:
        return Certificate(None, f"Inconclusive: {outcome.reason}.")
    searched = searched or _searched(corners, law, setting, progress)
    if searched[-1].stable is False:
        return searched[-1]
    return Certificate(
        None,
        f"Inconclusive: {outcome.reason}, and no admissible switching signal was proved to "
        f"grow either. {searched[0].message}",
        witness=searched[0].witness,
    )


def _searched(
    corners: list[SwitchedSystem], law: Law, setting: Setting, progress: Callable[[str], None]
) -> list[Certificate]:
    searched = []
    progress("looking for a signal that grows")
    for corner in corners:
        searched.append(_refute(corner, law, setting, ""))
        if searched[-1].stable is False:
            break
    return searched


def _evidence(
    setting: Setting, rates: list[float], progress: Callable[[str], None]
) -> tuple[Evidence | StretchEvidence | None, Check]:
    """The first level that proves stability, at the best of the decay rates tried."""
    outcome = Check(False, "no Lyapunov function of the kinds tried was found")
    levels = _levels(setting)
    for kind, level in enumerate(levels, 1):
        progress(f"Lyapunov functions, kind {kind} of {len(levels)}")
        search: Any = StretchSearch(setting) if level is None else EvidenceSearch(setting, level)
        rhos = [math.exp(-rate * setting.step) * (1.0 - SURPLUS * (rate > 0.0)) for rate in rates]
        # The least demanding rate first: where it has no proposal no other rate has one.
        slowest = search.glance(rhos[-1]) if len(rhos) > 1 else search.propose(rhos[-1])
        if slowest is None:
            continue
        for rho in rhos:
            proposal = slowest if rho == rhos[-1] else search.propose(rho)
            if proposal is None:
                continue
            rate = -math.log(rho) / setting.step + 0.0
            progress(f"kind {kind} of {len(levels)}: proving a decay of {rate:.3g} 1/s")
            evidence, outcome = search.prove(proposal)
            if outcome.proven:
                return evidence, outcome
    return None, outcome


def _levels(setting: Setting) -> list[Freedom | None]:
    """The kinds of function to try, quickest first; None: along stretches."""
    has_state = setting.memory or setting.signals.lost_samples
    early = has_state or setting.signals.chatter > 1
    levels: tuple[Freedom | None, ...] = EARLY_LEVELS if early else LEVELS
    if setting.context == "mode_age":
        last = setting.transitions.last
        every = (Freedom(4, last, setting.order),) if last <= FEW_AGES else ()
        levels = AGE_LEVELS + every
    along = StretchSearch.suits(setting)
    small = setting.order <= whole(setting) and setting.signals.chatter == 1
    if along and small:  # then V at every node is any matrix, and the other kinds add nothing
        quick = setting.inputs and not has_state
        levels = (*levels[: levels.index(None)], None) if quick else (None,)
    many = setting.order > LARGE or setting.family.ranges or setting.signals.lost_samples
    most = 2 if many else 4
    return [level for level in levels if (along if level is None else level.eigenvectors <= most)]


def _refute(plant: SwitchedSystem, law: Law, setting: Setting, why: str) -> Certificate:
    """The worst signal found: `stable` is False if the loop provably grows under it, else None."""
    from deadtime.certificates.worst_case import falsify

    try:
        worst = falsify(plant, law, setting.signals, setting.step)
    except DeadtimeError as error:
        return Certificate(None, f"Inconclusive: {why or 'no certificate was found'}; {error}")
    if worst.grows:
        also = f" ({why})" if why and worst.signal.switches else ""
        given = setting.plants.has_vertex(plant.A, plant.B)
        where = "" if given else f" at every plant in the {setting.plants.kind}"
        return Certificate(
            False,
            f"Not stable for every admissible switching signal{where}{also}: {worst.message}",
            witness=worst,
        )
    return Certificate(None, worst.message, witness=worst)
