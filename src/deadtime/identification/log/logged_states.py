"""States of a log, its switching model, and inputs before a log that begins at rest.

The log of a step test often begins shortly before the step, and the delays searched may be longer
than that. Where inputs and states keep their first values for a while, the plant was at rest, and
earlier inputs are assumed equal to the first ones. The assumption is tested on the residuals of the
rows that depend on it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import real_array
from deadtime.base.errors import ArgumentError
from deadtime.identification.log.recording import Part, Recording
from deadtime.switching import SwitchingSignal
from deadtime.switching.models.semi_markov import SemiMarkov

_SAME = 1e-13  # smallest eigenvalue of the correlation of states that are independent
_SIZES = 1e-70, 1e70  # of measurements and inputs: squares of ratios stay within doubles


def sensors_of(C: ArrayLike | None, recording: Recording) -> Float[np.ndarray, "p n"]:
    """C, checked; the identity where the states themselves are logged."""
    count = len(recording.outputs)
    if C is None:
        return np.eye(count)
    given = real_array("C", C, "(p, n)", 2)
    p, n = given.shape
    if p != count:
        raise ArgumentError(f"C must have a row for each output, {count}, got {p}.")
    rank = np.linalg.matrix_rank(given)
    if rank < n:
        raise ArgumentError(
            f"C must have rank n = {n}, got {rank}: from fewer outputs than states the "
            "matrices are known only up to a change of states. Log all states, or leave C out and "
            "say how many states each output has: order=2 takes it and its derivative."
        )
    return given


def as_states(recording: Recording, C: Float[np.ndarray, "p n"]) -> Recording:
    """The recording with states in place of outputs, by least squares."""
    if np.array_equal(C, np.eye(C.shape[0])):
        return recording
    back, level = np.linalg.pinv(C).T, recording.level
    parts = tuple(part._replace(output=part.output @ back) for part in recording.parts)
    level = level and level._replace(output=level.output @ back)
    return recording._replace(parts=parts, level=level)


def require_sizes(recording: Recording) -> None:
    """Refuse columns whose squares, or the squares of whose ratios, overflow."""
    least, most = _SIZES
    for at, names in ((1, recording.outputs), (2, recording.inputs)):
        every = np.abs(np.vstack([part[at] for part in recording.parts]))
        for name, size in zip(names, np.nanmax(every, axis=0, initial=0.0), strict=True):
            if size > 0.0 and not least <= size <= most:
                raise ArgumentError(
                    f"{name} must be of a size between {least:g} and {most:g}, got {size:.3g}: "
                    "log it in another unit."
                )


def require_states(recording: Recording, names: Sequence[str]) -> None:
    """Refuse states that never move or are linear combinations of others."""
    every = np.vstack([part.output for part in recording.parts])
    every = every[np.isfinite(every).all(axis=1)]
    spread = every.std(axis=0) if len(every) else np.zeros(len(names))
    still = [name for name, one in zip(names, spread, strict=True) if not one > 0.0]
    if still:
        got = "the same in every row" if len(every) else "no row"
        raise ArgumentError(
            f"{still[0]} must move, got {got} where all states are known: leave it out by "
            "states=[…], --states, or log it."
        )
    values, vectors = np.linalg.eigh(np.corrcoef(every.T).reshape(len(names), -1))
    if values[0] < _SAME:
        part = [name for name, one in zip(names, vectors[:, 0], strict=True) if abs(one) > 0.1]
        raise ArgumentError(
            f"{', '.join(part)} must be states of their own, got such that one is a sum of the "
            "others: leave it out by states=[…], --states."
        )


def signals_of(recording: Recording) -> list[SwitchingSignal]:
    """The logged modes as signals, each of rows whose modes are known.

    A mode that begins in the last row lasts one period.
    """
    signals = []
    for part in (piece for whole in recording.parts for piece in _with_modes(whole)):
        first = np.flatnonzero(np.diff(part.mode, prepend=-1))
        time = part.time - part.time[0]
        end = max(float(time[-1]), float(time[first[-1]]) + recording.step)
        signals.append(SwitchingSignal(time[first], part.mode[first], end=end))
    return signals


def _with_modes(part: Part) -> list[Part]:
    """The stretches of a part without lost rows, whose modes are unknown."""
    rows = np.flatnonzero(part.mode >= 0)
    return [part.rows(own) for own in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)]


def fit_switching(recording: Recording) -> tuple[SemiMarkov | None, str]:
    """The switching model, or None and the reason."""
    if len(recording.modes) < 2:
        return None, ""
    try:
        signals = signals_of(recording)
        return SemiMarkov.fit(signals, modes=len(recording.modes), first="drop"), ""
    except ArgumentError as error:
        return None, f"There is no switching model: {error}"


CHANCE = 1e-3  # significance level of the test of the rows that inputs before the log affect
_STILL = 0.05  # of a state's range: a state that moves less is at rest
_FEW = 10  # constant stretches of inputs: a step test has fewer, and may begin with a step
_LONGER = 3.0  # times the median constant stretch: a rest is at least so long
_NOISE = 3.0  # standard deviations by which the mean of a state at rest may move
_AT_LEAST = 3  # rows in which states must be at rest


def resting(recording: Recording, rest: bool | None) -> Recording:
    """The recording with `Part.rests` set: to `rest`, or found from the first rows if None.

    After a gap a part never rests: the inputs of the lost rows are unknown.
    """
    parts = tuple(
        part._replace(rests=not part.after_gap and (_rests(part) if rest is None else rest))
        for part in recording.parts
    )
    return recording._replace(parts=parts)


def _rests(part: Part) -> bool:
    """Whether inputs are constant for a while at first, with states at rest."""
    if not np.isfinite(part.input[0]).all() or len(part.input) < _AT_LEAST:
        return False
    rows, known = rest_rows(part.input), part.input[np.isfinite(part.input).all(axis=1)]
    stays = np.diff(np.flatnonzero((known[1:] != known[:-1]).any(axis=1)))
    usual = rows < _LONGER * np.median(stays) if stays.size else False
    if rows == len(part.input) or (usual and stays.size >= _FEW):
        return False
    own = part.output[: max(rows + 1, _AT_LEAST)]
    return all(still(own[:, a], part.output[:, a]) for a in range(part.output.shape[1]))


def still(x: Float[np.ndarray, " row"], every: Float[np.ndarray, " sample"]) -> bool:
    """Whether a state is constant in some rows up to noise: by the means of their two halves."""
    x, every = x[np.isfinite(x)], every[np.isfinite(every)]
    if x.size < 2:
        return False
    # Second differences of white noise have 6 times its variance; 0.6745 deviations is the median.
    noise = np.median(np.abs(np.diff(every, 2))) / (0.6745 * np.sqrt(6.0))
    half = max(1, x.size // 2)
    moved = abs(float(np.mean(x[-half:]) - np.mean(x[:half])))
    return bool(moved <= _STILL * float(np.ptp(every)) + _NOISE * noise * np.sqrt(2.0 / half))


def disproved(
    recording: Recording, white: tuple[Float[np.ndarray, "sample p"], ...], longest: float
) -> bool:
    """Whether residuals of rows that inputs before the log affect are too large (F test).

    white : residuals over their deviations, NaN where there are none; longest : delay, seconds
    """
    from scipy.stats import f

    early, late = [], []
    for part, rest in zip(recording.parts, white, strict=True):
        known = np.isfinite(rest).all(axis=1)
        before = part.time <= part.time[0] + longest + recording.step
        early.append(rest[known & before & part.rests].ravel())
        late.append(rest[known & ~(before & part.rests)].ravel())
    own, others = np.concatenate(early), np.concatenate(late)
    if not own.size or not others.size:
        return False
    ratio = float(np.mean(own**2) / max(np.mean(others**2), np.finfo(float).tiny))
    return ratio > float(f.isf(CHANCE, own.size, others.size))


def rest_rows(u: Float[np.ndarray, "sample m"]) -> int:
    """The number of first rows in which no input has moved yet."""
    moved = np.flatnonzero((u != u[0]).any(axis=1))
    return int(moved[0]) if moved.size else len(u)
