"""`audit`: every claim of the paper about its example, and what became of it."""

from __future__ import annotations

from deadtime.base.checks import positive, reporter
from deadtime.base.errors import ArgumentError
from deadtime.problems import Problem
from deadtime.problems.comparison import Progress
from deadtime.reports.audit.claim import Claim
from deadtime.reports.audit.claims import claims_at_dwell_time
from deadtime.reports.audit.measure import BLOCKS, gather_all
from deadtime.reports.audit.sweeps import (
    DISTANCES,
    STRETCH,
    claim_about_distance,
    claims_about_dwell_time,
)

SWEEP_SHARE = 0.4  # of the scenarios, for each point of a sweep
STEPS = BLOCKS + (len(STRETCH) - 1) + (len(DISTANCES) - 1)  # how often `audit` reports progress


def audit(
    problem: Problem,
    scenarios: int = 1000,
    seed: int = 0,
    progress: Progress | None = None,
    dwell_time: float = 0.2,
) -> list[Claim]:
    """Hold what the paper says of its example's runs against many random signals.

    Its figure for ε* is held against `theorem_bound` elsewhere: see `constants_table`.

    Random signals have sojourns τ_d + Exp(τ_d), τ_d the dwell time. Claims about a trend are
    measured at four points each, on 0.4 times as many signals, the same at each point.

    Parameters
    ----------
    problem : Problem
        The paper's example, `deadtime.problems.paper()`.
    scenarios : int
        Number of random signals, ≥ 1.
    seed : int
        Of the signals; at least 0.
    progress : callable, optional
        Called with a few words before each piece of work, `STEPS` times in all.
    dwell_time : float
        τ_d of the random signals, in seconds; the example's is 0.2.

    Returns
    -------
    list of Claim
        In the order of the paper.

    Raises
    ------
    ArgumentError
        If the problem is another one, or a number is out of range.

    Examples
    --------
    >>> import deadtime as dt
    >>> from deadtime.reports.audit import audit
    >>> for claim in audit(dt.problems.paper(), scenarios=20)[:2]:
    ...     print(claim.title, "–", claim.verdict)
    gains and ε as printed – holds
    (2) stabilises – holds
    """
    if problem.name != "paper":
        raise ArgumentError(
            f"problem must be the paper's example, deadtime.problems.paper(), got "
            f"{problem.name!r}: the audit is about claims made of that example."
        )
    for name, value, least in (("scenarios", scenarios, 1), ("seed", seed, 0)):
        if isinstance(value, bool) or value < least:
            raise ArgumentError(f"{name} must be an integer ≥ {least}, got {value!r}.")
    if problem.step is None:
        raise ArgumentError("problem.step must be a period in seconds: the audit is digital.")
    dwell_time = positive("dwell_time", dwell_time)
    progress = reporter("progress", progress)
    count = max(1, round(SWEEP_SHARE * scenarios))
    evidence = gather_all(problem, dwell_time, scenarios, seed, progress)
    return [
        *claims_at_dwell_time(evidence),
        *claims_about_dwell_time(evidence, count, seed, progress),
        claim_about_distance(evidence, count, seed, progress),
    ]
