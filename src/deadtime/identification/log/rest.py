"""What inputs were before a log: its first ones, where it begins at rest.

A step test is often logged from a little before its step on, and the delays looked for may be
longer than that. Where inputs keep their first value for a while, and states keep theirs, the plant
was at rest, and inputs were what they are. What a log says against that is looked for in what is
left of the rows that it is assumed of.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from deadtime.identification.log.recording import Part, Recording

CHANCE = 1e-3  # that the rows that answer to inputs before the log look otherwise by chance
_STILL = 0.05  # of what a state moves by in all of a log
_FEW = 10  # stays of inputs between changes: fewer are a test by steps, which may begin at once
_LONGER = 3.0  # times what inputs stay otherwise: so long is a rest
_NOISE = 3.0  # deviations of what hardly moves
_AT_LEAST = 3  # rows that states are still in, where there are as many


def resting(recording: Recording, rest: bool | None) -> Recording:
    """The recording, of which each part tells whether it rests before its first row."""
    parts = tuple(
        part._replace(rests=not part.torn and (_rests(part) if rest is None else rest))
        for part in recording.parts
    )
    return recording._replace(parts=parts)


def _rests(part: Part) -> bool:
    """Whether inputs stay for a while at first, in which states are still."""
    if not np.isfinite(part.input[0]).all() or len(part.input) < _AT_LEAST:
        return False
    rows, known = rest_rows(part.input), part.input[np.isfinite(part.input).all(axis=1)]
    stays = np.diff(np.flatnonzero((known[1:] != known[:-1]).any(axis=1)))
    usual = rows < _LONGER * np.median(stays) if stays.size else False
    if rows == len(part.input) or (usual and stays.size >= _FEW):
        return False
    own = part.output[: max(rows + 1, _AT_LEAST)]
    return all(_still(own[:, a], part.output[:, a]) for a in range(part.output.shape[1]))


def _still(x: Float[np.ndarray, " row"], every: Float[np.ndarray, " sample"]) -> bool:
    """Whether a state keeps its value in some rows but for noise: by its halves' medians."""
    x, every = x[np.isfinite(x)], every[np.isfinite(every)]
    if x.size < 2:
        return False
    noise = np.median(np.abs(np.diff(every, 2))) / (0.6745 * np.sqrt(6.0))
    half = max(1, x.size // 2)
    moved = abs(float(np.mean(x[-half:]) - np.mean(x[:half])))
    return bool(moved <= _STILL * float(np.ptp(every)) + _NOISE * noise * np.sqrt(2.0 / half))


def disproved(
    recording: Recording, white: tuple[Float[np.ndarray, "sample p"], ...], longest: float
) -> bool:
    """Whether rows that answer to inputs before the log are further off than noise makes them.

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


def rest_rows(entered: Float[np.ndarray, "sample m"]) -> int:
    """The first rows, in which no input has moved yet."""
    moved = np.flatnonzero((entered != entered[0]).any(axis=1))
    return int(moved[0]) if moved.size else len(entered)
