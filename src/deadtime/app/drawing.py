"""Switching signals drawn by hand: a click puts a switch where there was none, or removes one."""

from __future__ import annotations

from collections.abc import Sequence

from deadtime.app.settings import GivenSignal
from deadtime.base.errors import ArgumentError

MOST = 500  # switches


def switch_at(
    times: Sequence[float], modes: Sequence[int], at: float, mode: int, count: int
) -> GivenSignal:
    """The signal that is in a mode from an instant on, up to its next switch.

    Where it is in that mode already, the switch that began it is taken away instead: the mode
    before goes on.

    Parameters
    ----------
    times, modes : sequences
        Starts of the sojourns, the first 0, in seconds, and their modes.
    at : float
        When, in seconds.
    mode, count : int
        Which mode from there on, of how many.

    Raises
    ------
    ArgumentError
        If the instant is negative, there is no such mode, or there are too many switches.

    Examples
    --------
    >>> switch_at([0.0], [0], 1.5, 1, 2)
    GivenSignal(times=(0.0, 1.5), modes=(0, 1), about='drawn by hand')
    >>> switch_at([0.0, 1.5], [0, 1], 2.0, 1, 2)
    GivenSignal(times=(0.0,), modes=(0,), about='drawn by hand')
    """
    if not 0 <= mode < count:
        raise ArgumentError(f"mode must be in 0..{count - 1}, got {mode}.")
    if not 0.0 <= at < float("inf"):
        raise ArgumentError(f"time of a switch must be ≥ 0, in s, got {at:g}.")
    pairs = list(zip(map(float, times), map(int, modes), strict=True))
    now = max(i for i, (time, _) in enumerate(pairs) if time <= at)
    if pairs[now][1] == mode:
        if now:
            del pairs[now]
    elif pairs[now][0] == at:
        pairs[now] = (at, mode)
    else:
        pairs.insert(now + 1, (float(at), mode))
    merged = [pair for i, pair in enumerate(pairs) if i == 0 or pair[1] != pairs[i - 1][1]]
    if len(merged) > MOST:
        raise ArgumentError(f"a drawn signal holds at most {MOST} sojourns: clear it first.")
    return GivenSignal(
        tuple(time for time, _ in merged), tuple(which for _, which in merged), "drawn by hand"
    )
