"""Which inputs follow from measurements, as in a loop that only regulates."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.uneven import gridded

_PAST = 3  # rows: of measurements and of the input itself, that a controller reads
_SHARE = 0.5  # of what is new in an input, that measurements explain in a loop with little else
_MOVES = 1e-9  # of an input's variance: an input that its own past tells so well is no feedback's


def fed_back(recording: Recording) -> Bool[np.ndarray, " m"]:
    """Which inputs follow from the measurements of their row and the last ones.

    What is new in an input, beside its own past, is compared with what is left of that once
    measurements are known, by linear regressions in each mode.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> y, r = rng.standard_normal((2, 200, 1))
    >>> def log(u):
    ...     part = Part(np.arange(200.0), y, u, np.zeros(200, int))
    ...     return Recording((part,), 1.0, True, ("y",), ("u",), ("mode 0",), True)
    >>> [bool(fed_back(log(u))[0]) for u in (-2.0 * y, -2.0 * np.cumsum(y, axis=0), r - 0.5 * y)]
    [True, True, False]
    """
    grid = gridded(recording)
    m = grid.parts[0].input.shape[1]
    new, left, total = np.zeros(m), np.zeros(m), np.zeros(m)
    for i in range(len(grid.modes)):
        rows = [_rows(part, i) for part in grid.parts]
        y, u = (np.concatenate(each) for each in zip(*rows, strict=True))
        if len(u) < 2 * (y.shape[1] + _PAST * m + 1):
            continue
        for j in range(m):
            own = np.column_stack((u[:, 1:, j], np.ones(len(u))))
            new[j] += _rest(own, u[:, 0, j])
            left[j] += _rest(np.hstack((own, y)), u[:, 0, j])
            total[j] += float(((u[:, 0, j] - u[:, 0, j].mean()) ** 2).sum())
    return (new > _MOVES * total) & (left < _SHARE * new)


def _rows(part: Part, mode: int) -> tuple[np.ndarray, np.ndarray]:
    """Measurements of rows of a mode and of those before, in one line each; inputs likewise."""
    k = np.arange(_PAST, part.time.size)
    lags = k[:, None] - np.arange(_PAST + 1)
    y, u = part.output[lags].reshape(k.size, lags.shape[1] * part.output.shape[1]), part.input[lags]
    known = np.isfinite(y).all(axis=1) & np.isfinite(u).all(axis=(1, 2))
    own = known & (part.mode[lags] == mode).all(axis=1)
    return y[own], u[own]


def _rest(z: np.ndarray, u: np.ndarray) -> float:
    unit = np.maximum(np.sqrt((z**2).sum(axis=0)), 1e-300)
    return float(((u - z @ (np.linalg.lstsq(z / unit, u, rcond=1e-13)[0] / unit)) ** 2).sum())
