"""The one way to draw signals: modes that last for a random time, one after the other.

Signal i reads the numbers of its own streams only (`deadtime.numerics.streams`): one for its
first mode, and for jump j one for the sojourn before it and one for the mode after it. So it does
not depend on which signals are drawn beside it, and a longer horizon continues it.

All signals advance together, a round of jumps at a time: the modes they pass first, since these
do not depend on the sojourns, then the sojourns, then the instants; those that have reached the
horizon leave.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import count, positive, read_only
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.numerics.streams import WORDS, key_of, uniforms
from deadtime.switching.models.jump_loops import lay, place, walk
from deadtime.switching.models.quantiles import Quantiles

MOST_SWITCHES = 1e7
MOST_JUMPS = 1e8
FEW_SIGNALS = 8
FEW_BLOCKS = 2**12  # of a signal: beyond them NumPy's generators take longer than a compiler
_FIRST_MODE, _SOJOURNS, _JUMPS = 1, 2, 3
_FIRST_BLOCKS = 2
_TINY = float(np.finfo(float).tiny)


class Switches(NamedTuple):
    """Sojourns of signals one after the other: those of signal i are first[i], …, first[i + 1]."""

    first: Int[np.ndarray, " signal_and_end"]
    times: Float[np.ndarray, " sojourn"]
    modes: Int[np.ndarray, " sojourn"]


@dataclass(frozen=True, eq=False)
class JumpProcess(Frozen):
    """A process of modes that stays in each for a random time and then jumps to another one.

    The first mode is uniform. A sojourn too short for a double to tell its ends apart is left out.

    Parameters
    ----------
    sojourn : Quantiles
        The modes' inverse survival functions.
    transition : (mode, mode) array
        What the probabilities of the next mode are proportional to; a row of zeros stays.
    mean : float
        The longest of the modes' mean sojourns, seconds.

    Examples
    --------
    >>> process = JumpProcess(Quantiles(np.zeros(2), np.array([0.5, 1.0])), 1.0 - np.eye(2), 1.0)
    >>> whole, alone = process.draw(3.0, first=0, size=4), process.draw(3.0, first=2)
    >>> (alone.times == whole.times[whole.first[2] : whole.first[3]]).all()
    np.True_
    """

    sojourn: Quantiles
    transition: Float[np.ndarray, "mode mode"]
    mean: float

    def draw(self, horizon: float, seed: int = 0, first: int = 0, size: int = 1) -> Switches:
        """The signals first, …, first + size − 1 of a seed on [0, horizon).

        Raises
        ------
        ArgumentError
            If the horizon is not positive, the seed or `first` is negative, there are no signals,
            they hold too many switches, or the quantiles give anything but times.
        """
        horizon, seed = positive("horizon", horizon), count("seed", seed, least=0)
        first, size = count("first", first, least=0), count("count", size)
        require_few(horizon, self.mean)
        if size * horizon / self.mean > MOST_JUMPS:
            _refuse(size, horizon)
        bounds, key = self._bounds(), key_of(seed)
        numbers = read_only(np.uint64(first) + np.arange(size, dtype=np.uint64))
        start = _numbers(size, 0)(key, numbers, 0, 1, _FIRST_MODE)[:, 0]
        mode = (start * self.transition.shape[0]).astype(np.int64)
        rows, time, last = np.arange(size), np.zeros(size), np.full(size, -1)
        rounds, block, jumps_read = [], 0, 0
        choices = bool(((bounds > 0.0) & (bounds < 1.0)).any())
        while rows.size:
            # Longer and longer rounds: at most a quarter of what a signal needs is read in vain.
            blocks = max(_FIRST_BLOCKS, block // 4)
            jumps_read += rows.size * blocks * WORDS
            if WORDS * block > MOST_SWITCHES:
                require_few(horizon, max(float(time.min()), _TINY) / (WORDS * block))
            if jumps_read > 2.0 * MOST_JUMPS:
                _refuse(size, horizon)
            draw, own = _numbers(size, block), read_only(numbers[rows])
            shape = rows.size, WORDS * blocks
            # Where a mode leads to one other, whatever is drawn decides the same.
            jumps = draw(key, own, block, blocks, _JUMPS) if choices else np.full(shape, 0.5)
            path, mode = walk(bounds, mode, jumps)
            sojourns = self.sojourn(path, draw(key, own, block, blocks, _SOJOURNS))
            times, modes, used, time, last = lay(path, sojourns, time, last, horizon)
            rounds.append((rows, used, times, modes))
            going = time < horizon
            rows, mode, time, last = rows[going], mode[going], time[going], last[going]
            block += blocks
        return _pack(rounds, size)

    def _bounds(self) -> Float[np.ndarray, "mode mode"]:
        """Cumulated probabilities of the next mode; a mode that nothing leaves leads to itself."""
        bounds = np.cumsum(self.transition, axis=1)
        left = bounds[:, -1] > 0.0
        bounds[left] /= bounds[left, -1:]
        bounds[~left] = np.triu(np.ones(bounds.shape))[~left]
        return read_only(bounds)


def require_few(horizon: float, mean: float) -> None:
    """Refuse a horizon that would hold more switches than memory."""
    if horizon / mean > MOST_SWITCHES:
        raise ArgumentError(
            f"horizon = {horizon:g} s would hold about {horizon / mean:.0e} switches, more than "
            f"{MOST_SWITCHES:.0e}: shorten it or lengthen the sojourns."
        )


def _numbers(signals: int, block: int) -> Callable[..., np.ndarray]:
    """What gives random numbers: NumPy where few are asked for, else compiled; bitwise equal."""
    if signals <= FEW_SIGNALS and block <= FEW_BLOCKS:
        return uniforms
    from deadtime.numerics import philox

    return philox.uniforms


def _pack(rounds: Sequence[tuple[np.ndarray, ...]], size: int) -> Switches:
    """The rounds' sojourns, signal by signal."""
    sizes = np.zeros(size, np.int64)
    for rows, used, _, _ in rounds:
        sizes[rows] += used
    first = np.concatenate(([0], np.cumsum(sizes)))
    times, modes = np.empty(first[-1]), np.empty(first[-1], np.int64)
    to = first[:-1].copy()
    for rows, used, round_times, round_modes in rounds:
        place(to, rows, used, round_times, round_modes, times, modes)
    return Switches(first, times, modes)


def _refuse(size: int, horizon: float) -> None:
    raise ArgumentError(
        f"count = {size} signals of {horizon:g} s would hold more than {MOST_JUMPS:.0e} switches: "
        "draw fewer at once, shorten the horizon or lengthen the sojourns."
    )
