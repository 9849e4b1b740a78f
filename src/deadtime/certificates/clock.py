"""How sojourns are measured: in periods, with a clock of some tolerance."""

from __future__ import annotations

from deadtime.base.checks import count, number
from deadtime.base.errors import ArgumentError

CLOCK_TOLERANCE = 1e-5  # quartz, and far more than binary64 and the simulator round
MOST_PERIODS = 100_000  # of a dwell time: more is a slip of units
MOST_LOST = 100
LEAST, MOST = 1e-8, 0.1  # the simulator moves switches within 1e-9 periods of a sample onto it


def clock_tolerance_in_range(value: object, least: float = LEAST) -> float:
    """A tolerance that a proof can cover; of a search alone `least` may be 0."""
    tolerance = number("clock_tolerance", value)
    if not least <= tolerance <= MOST:
        raise ArgumentError(
            f"clock_tolerance must be a part from {least:g} to {MOST:g}, got {tolerance:g}: by how "
            "much the clock that the dwell time is measured with may differ from the controller's."
        )
    return tolerance


def lag_in_range(value: int) -> int:
    """A number of periods by which the mode is told late."""
    if count("mode_lag", value, 0) > MOST_PERIODS:
        raise ArgumentError(
            f"mode_lag must be at most {MOST_PERIODS:,} periods, got {value:,}: is it in periods, "
            "not in milliseconds?"
        )
    return value


def losses_in_range(value: int, mode_lag: int = 0) -> int:
    """A number of samples in a row that may be lost."""
    if count("lost_samples", value, 0) > MOST_LOST:
        raise ArgumentError(
            f"lost_samples must be at most {MOST_LOST} in a row, got {value:,}: the Lyapunov "
            "function is another one after every number of them."
        )
    if value and mode_lag:
        raise ArgumentError(
            "lost_samples and mode_lag exclude each other: a lost sample tells the mode late by "
            "itself; give one of them."
        )
    return value


def require_periods(
    dwell_time: float, step: float, maximum: float | None = None, chatter: int = 1
) -> None:
    """Refuse sojourns of more periods than certificates and searches lay out."""
    if dwell_time / step > MOST_PERIODS:
        raise ArgumentError(
            f"dwell_time / step = {dwell_time / step:.3g} periods, at most {MOST_PERIODS:.0e} are "
            "possible: are both in seconds? Lengthen the step; what a shorter dwell time proves "
            "holds for a longer one too."
        )
    if maximum is not None and maximum / step > MOST_PERIODS:
        raise ArgumentError(
            f"maximum_dwell / step = {maximum / step:.3g} periods, at most {MOST_PERIODS:.0e} are "
            "possible: are both in seconds? Lengthen the step, or leave maximum_dwell out, for "
            "sojourns of any length."
        )
    if chatter > MOST_PERIODS or chatter * dwell_time > MOST_PERIODS * step:
        raise ArgumentError(
            f"chatter · dwell_time / step must be at most {MOST_PERIODS:.0e} periods, got a "
            f"chatter of {min(chatter, MOST_PERIODS):.0e}"
            f"{' or more' if chatter > MOST_PERIODS else ''}: allow fewer switches at once, or "
            "lengthen the step."
        )
