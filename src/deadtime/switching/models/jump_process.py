"""Sampling of switching signals as jump processes: random sojourns and jumps.

Signal i uses random numbers of its own streams only (`deadtime.numerics.streams`): one for its
first mode, and for jump j one for the sojourn before it and one for the mode after it. So it does
not depend on which signals are drawn with it, and a longer horizon continues it.

All signals advance together, a round of jumps at a time: first the modes, which do not depend on
the sojourns, then the sojourns, then the instants. Signals at the horizon drop out.

The number u in (0, 1) gives the sojourn of mode i by the inverse survival function,

    P(S_i > t) = u,    t = a_i − b_i log u for a shifted exponential or a fixed sojourn (b_i = 0),

else `isf` of the distribution, or `ppf` at 1 − u, or a search if both have no formula.

The compiled loops over jumps release Python's lock.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import count, positive, read_only
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.numerics.kernels import kernel
from deadtime.numerics.streams import WORDS, key_of, uniforms
from deadtime.switching.models.sojourns import Distribution, Fixed, ShiftedExponential, log_survival


@dataclass(frozen=True, eq=False)
class Quantiles(Frozen):
    """The inverse survival functions of all modes.

    Attributes
    ----------
    shift, scale : (mode,) arrays
        a_i and b_i, seconds, for modes with a formula; 0 for the others. A mode with an infinite
        scale is never left.
    others : tuple of (name, function, modes)
        The other distributions: name in messages, `isf`, and (mode,) bool for the modes with it.
    """

    shift: Float[np.ndarray, " mode"]
    scale: Float[np.ndarray, " mode"]
    others: tuple[tuple[str, Callable, np.ndarray], ...] = ()

    @classmethod
    def of(cls, sojourn: Sequence[Distribution]) -> Quantiles:
        """The functions of one distribution per mode; modes with the same one share an entry."""
        shift, scale = np.zeros(len(sojourn)), np.zeros(len(sojourn))
        others: dict[int, tuple[str, Callable, np.ndarray]] = {}
        for i, dist in enumerate(sojourn):
            formula = _formula(dist)
            if formula is not None:
                shift[i], scale[i] = formula
                continue
            new = np.zeros(len(sojourn), dtype=bool)
            others.setdefault(id(dist), (*_inverse(f"sojourn[{i}]", dist), new))[2][i] = True
        return cls(shift, scale, tuple(others.values()))

    def __call__(
        self, modes: Int[np.ndarray, "scenario jump"], u: Float[np.ndarray, "scenario jump"]
    ) -> Float[np.ndarray, "scenario jump"]:
        """The sojourns in `modes`, seconds, for the numbers u in (0, 1)."""
        if len(self.others) == 1 and self.others[0][2].all():
            name, inverse, _ = self.others[0]
            return _invert(name, inverse, u.ravel()).reshape(u.shape)
        result = np.log(u)  # in place from here on: batches draw millions of sojourns
        result *= -self.scale[modes]
        result += self.shift[modes]
        for name, inverse, holds in self.others:
            here = holds[modes]
            if here.any():
                result[here] = _invert(name, inverse, u[here])
        return result


def _formula(dist: Distribution) -> tuple[float, float] | None:
    """(a, b) of t = a − b log u, where that is the inverse survival function."""
    if isinstance(dist, Fixed):
        return dist.length, 0.0
    if isinstance(dist, ShiftedExponential):
        return dist.loc, dist.scale
    family = type(getattr(dist, "dist", None))
    if family.__name__ != "expon_gen" or not family.__module__.startswith("scipy.stats"):
        return None
    given = dict(zip(("loc", "scale"), getattr(dist, "args", ()), strict=False))
    given |= getattr(dist, "kwds", {})
    return float(given.get("loc", 0.0)), float(given.get("scale", 1.0))


def _inverse(name: str, dist: Distribution) -> tuple[str, Callable]:
    """The inverse survival function of a distribution, and its name in messages."""
    isf, ppf = (getattr(dist, word, None) for word in ("isf", "ppf"))
    if _is_searched(dist) or not (callable(isf) or callable(ppf)):
        return f"{name}.sf", partial(_search, dist)
    if callable(isf):
        return f"{name}.isf", isf
    assert ppf is not None
    return f"{name}.ppf", lambda u: ppf(1.0 - u)  # exact: u is a multiple of 2⁻⁵³


def _is_searched(dist: Distribution) -> bool:
    """Whether it is a SciPy distribution without a formula for `isf`.

    SciPy then solves for each number with a root search of milliseconds; `_search` is vectorised.

    Examples
    --------
    >>> from scipy.stats import foldnorm, gamma
    >>> _is_searched(gamma(2.0)), _is_searched(foldnorm(1.0))
    (False, True)
    """
    if not type(dist).__module__.startswith("scipy.stats"):
        return False
    from scipy.stats import rv_continuous

    family = getattr(dist, "dist", None)
    return isinstance(family, rv_continuous) and all(
        getattr(type(family), word) is getattr(rv_continuous, word) for word in ("_ppf", "_isf")
    )


def _search(dist: Distribution, u: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """The least doubles t with P(S > t) ≤ u, by bisection.

    Examples
    --------
    >>> _search(Fixed(0.3), np.array([0.2, 0.9]))
    array([0.3, 0.3])
    """
    level, most = np.log(u), np.ones(u.size)
    while (short := (log_survival(dist, most) > level) & (most < np.inf)).any():
        most[short] *= 2.0
    # Doubles ≥ 0 are ordered as their bits are as integers: 62 steps at most find them exactly.
    low, high = np.zeros(u.size, np.int64), most.view(np.int64)
    while (high - low > 1).any():
        middle = low + (high - low) // 2
        longer = log_survival(dist, middle.view(np.float64)) > level
        low, high = np.where(longer, middle, low), np.where(longer, high, middle)
    return high.view(np.float64)


def _invert(name: str, inverse: Callable, u: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    with np.errstate(all="ignore"):
        drawn = np.asarray(inverse(u), dtype=np.float64)
    if drawn.shape != u.shape:
        raise ArgumentError(f"{name} must return shape {u.shape} for that of u, got {drawn.shape}.")
    if not drawn.min(initial=0.0) >= 0.0:  # NaN is refused, too
        raise ArgumentError(f"{name} must return numbers ≥ 0, in s, got {drawn.min():g}.")
    return drawn


@kernel(nogil=True)
def walk(bounds, mode, u):
    """The modes (signal, jump) of the next sojourns of every signal, and the mode after them.

    `bounds` (mode, mode) are cumulative probabilities of the next mode, each row ending in 1;
    `mode` (signal,) is the first mode, and u (signal, jump) are numbers in (0, 1).
    """
    path = np.empty(u.shape, np.int64)
    after = np.empty(mode.size, np.int64)
    for i in range(mode.size):
        now = mode[i]
        for j in range(u.shape[1]):
            path[i, j] = now
            following = 0
            while u[i, j] >= bounds[now, following]:
                following += 1
            now = following
        after[i] = now
    return path, after


@kernel(nogil=True)
def sample_signals(path, sojourns, time, last, horizon):
    """Start times and modes (signal, jump) of sojourns; the first `used` of each row are valid.

    `time` is the start of the first sojourn of each row and `last` the mode before it, −1 for
    none. A sojourn without a length in doubles is left out, and one in the same mode as the one
    before it is merged with that. Returns also the time and the mode at the end of each row; a time
    at or beyond the horizon ends the signal.
    """
    count, jumps = path.shape
    times, modes = np.empty((count, jumps)), np.empty((count, jumps), np.int64)
    used, end, held = np.zeros(count, np.int64), time.copy(), last.copy()
    for i in range(count):
        t, mode, kept = time[i], last[i], 0
        for j in range(jumps):
            then = t + sojourns[i, j]
            # A sojourn that ends at its start is none; one in the same mode extends the last.
            if then > t and path[i, j] != mode:
                mode = path[i, j]
                times[i, kept], modes[i, kept] = t, mode
                kept += 1
            t = then
            if not t < horizon:
                break
        used[i], end[i], held[i] = kept, t, mode
    return times, modes, used, end, held


@kernel(nogil=True)
def place(to, rows, used, times, modes, flat_times, flat_modes):
    """Copy the sojourns of a round to the flat arrays at `to`, the next index of each signal."""
    for i in range(rows.size):
        at, kept = to[rows[i]], used[i]
        for j in range(kept):
            flat_times[at + j], flat_modes[at + j] = times[i, j], modes[i, j]
        to[rows[i]] = at + kept


MOST_SWITCHES = 1e7  # of a signal
MOST_JUMPS = 1e8  # of all signals of a draw
FEW_SIGNALS = 8
FEW_BLOCKS = 2**12  # per signal: up to these NumPy's generators are faster than compiling
_FIRST_MODE, _SOJOURNS, _JUMPS = 1, 2, 3  # streams of a signal's random numbers
_FIRST_BLOCKS = 2  # of the first round
_TINY = float(np.finfo(float).tiny)


class Switches(NamedTuple):
    """Sojourns of many signals; signal i has first[i], …, first[i + 1] − 1."""

    first: Int[np.ndarray, " signal_and_end"]
    times: Float[np.ndarray, " sojourn"]
    modes: Int[np.ndarray, " sojourn"]


@dataclass(frozen=True, eq=False)
class JumpProcess(Frozen):
    """A jump process of modes with random sojourns; the first mode is uniform.

    A sojourn so short that both ends are the same double is left out.

    Parameters
    ----------
    sojourn : Quantiles
        The modes' inverse survival functions.
    transition : (mode, mode) array
        Weights of the next mode; a mode with a row of zeros is never left.
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
            they hold too many switches, or the quantiles are not times.
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
            # Rounds grow by a quarter, so that at most a quarter of the numbers is drawn in vain.
            blocks = max(_FIRST_BLOCKS, block // 4)
            jumps_read += rows.size * blocks * WORDS
            if WORDS * block > MOST_SWITCHES:
                require_few(horizon, max(float(time.min()), _TINY) / (WORDS * block))
            if jumps_read > 2.0 * MOST_JUMPS:
                _refuse(size, horizon)
            draw, own = _numbers(size, block), read_only(numbers[rows])
            shape = rows.size, WORDS * blocks
            # If every mode has one successor, the jumps need no random numbers.
            jumps = draw(key, own, block, blocks, _JUMPS) if choices else np.full(shape, 0.5)
            path, mode = walk(bounds, mode, jumps)
            sojourns = self.sojourn(path, draw(key, own, block, blocks, _SOJOURNS))
            times, modes, used, time, last = sample_signals(path, sojourns, time, last, horizon)
            rounds.append((rows, used, times, modes))
            going = time < horizon
            rows, mode, time, last = rows[going], mode[going], time[going], last[going]
            block += blocks
        return _pack(rounds, size)

    def _bounds(self) -> Float[np.ndarray, "mode mode"]:
        """Cumulative probabilities of the next mode; a mode that is never left leads to itself."""
        bounds = np.cumsum(self.transition, axis=1)
        left = bounds[:, -1] > 0.0
        bounds[left] /= bounds[left, -1:]
        # Rows 0 … 0 1 … 1 from the diagonal on: any number leads to the mode itself.
        bounds[~left] = np.triu(np.ones(bounds.shape))[~left]
        return read_only(bounds)


def require_few(horizon: float, mean: float) -> None:
    """Refuse a horizon with more switches than fit into memory."""
    if horizon / mean > MOST_SWITCHES:
        raise ArgumentError(
            f"horizon = {horizon:g} s would hold about {horizon / mean:.0e} switches, more than "
            f"{MOST_SWITCHES:.0e}: shorten it or lengthen the sojourns."
        )


def _numbers(signals: int, block: int) -> Callable[..., np.ndarray]:
    """The generator of random numbers: NumPy for few, else compiled; bitwise equal."""
    if signals <= FEW_SIGNALS and block <= FEW_BLOCKS:
        return uniforms
    from deadtime.numerics import generators

    return generators.uniforms


def _pack(rounds: Sequence[tuple[np.ndarray, ...]], size: int) -> Switches:
    """The sojourns of all rounds, by signal."""
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
