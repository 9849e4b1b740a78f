"""The admissible signals that `certify` and `falsify` are asked about, checked."""

from __future__ import annotations

import math

from numpy.typing import ArrayLike

from deadtime.base.errors import ArgumentError
from deadtime.certificates.clock import require_periods
from deadtime.certificates.proof.evidence import Setting
from deadtime.certificates.proof.transitions import Following, PerMode
from deadtime.switching.constraint import PerMode as Times, SwitchingConstraint, one_or_each


def admissible_signals(
    modes: int,
    dwell_time: Times,
    maximum_dwell: Times | None,
    transitions: ArrayLike | None,
    step: float,
    chatter: int = 1,
    laid_out: bool = True,
) -> SwitchingConstraint:
    """The signals that these arguments describe; `laid_out`: whether to the longest sojourn."""
    signals = SwitchingConstraint.of(modes, dwell_time, maximum_dwell, transitions)
    if chatter > 1 and any(map(math.isfinite, signals.maximum_dwell)):
        raise ArgumentError("chatter > 1 and maximum_dwell exclude each other: give one of them.")
    if chatter > 1 and len(set(signals.dwell_time)) > 1:
        raise ArgumentError(
            "dwell_time must be one number with chatter > 1, for an average dwell time is that of "
            f"all modes together, got {list(signals.dwell_time)}."
        )
    longest = [time for time in signals.maximum_dwell if laid_out and math.isfinite(time)]
    require_periods(max(signals.dwell_time), step, max(longest, default=None), chatter)
    return signals


def of_setting(setting: Setting) -> SwitchingConstraint:
    """The signals that a certificate is about."""
    modes = range(len(setting.shortest))
    following = setting.following
    if following is None:
        following = tuple(tuple(j for j in modes if j != i) for i in modes)
    longest = tuple(math.inf if time is None else time for time in setting.longest)
    return SwitchingConstraint(setting.shortest, longest, following)


def times_and_ways(
    signals: SwitchingConstraint,
) -> tuple[PerMode[float], PerMode[float | None], Following | None]:
    """What a `Setting` holds of them: dwell time, maximum, and which mode may follow which."""
    longest = tuple(None if math.isinf(time) else time for time in signals.maximum_dwell)
    ways = None if signals.is_free else signals.following
    return one_or_each(signals.dwell_time), one_or_each(longest), ways
