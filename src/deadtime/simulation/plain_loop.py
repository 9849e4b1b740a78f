"""The loop of a run of which nothing but the law's rows is asked, in Python's own numbers.

`simulation.digital_kernel.closed_loop` reads arrays element by element, which costs Python several
times what lists do. Most runs are told the state itself at every sample and have neither limits nor
disturbances; of these little is left of the loop, and it is done here over lists: the same
products, added in the same order, so the bits are those of the kernel.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from deadtime.plant.pieces import PieceTable
from deadtime.simulation.loop_arrays import LIMIT, DelayLine, Rows

if TYPE_CHECKING:
    from deadtime.imperfections.sensors_and_actuators import InputLimits
    from deadtime.simulation.sight import Sight


def is_bare(
    table: PieceTable, line: DelayLine, sight: Sight, limits: InputLimits, shift: np.ndarray
) -> bool:
    """Whether every sample is told the state there, and the plant given what the law asks for."""
    seen = not (sight.noise.size or sight.C.shape[1]) and (sight.way < 0).all()
    given = line.told is line.inputs is line.asked and not (limits.relative.size or shift.size)
    return bool(given and seen and np.array_equal(sight.piece, table.first[: sight.piece.size]))


def bare_loop(
    table: PieceTable, rows: Rows, line: DelayLine, x0: np.ndarray
) -> tuple[int, np.ndarray]:
    """`closed_loop` of a run that `is_bare`, by rows: it fills `line` and returns the same."""
    past, m, samples = line.past, line.inputs.shape[1], rows.row.size
    first, entry, row = table.first.tolist(), table.entry.tolist(), rows.row.tolist()
    moves, lag = np.concatenate((table.Phi, table.Gamma), axis=2).tolist(), table.lag.tolist()
    F, G, window = rows.F.tolist(), rows.G.tolist(), rows.G.shape[2]
    flat, x = line.inputs[:past].ravel().tolist(), x0.tolist()
    path = [x]
    for k in range(len(first) - 1):
        if 0 < k < samples and not _within_limit(x):
            samples = k
        if k < samples:
            line.measured[k] = x
            recent = flat[len(flat) - window :]
            of = row[k]
            flat += [_dot(g, recent) + _dot(f, x) for f, g in zip(F[of], G[of], strict=True)]
        for q in range(first[k], first[k + 1]):
            lags = lag[entry[q]]
            if k - min(lags) >= samples:
                return _filled(line, samples, flat, path)
            acting = [flat[(past + k - late) * m + i] for i, late in enumerate(lags)]
            x = _moved(moves[entry[q]], x + acting)
            path.append(x)
    return _filled(line, samples, flat, path)


def _filled(
    line: DelayLine, samples: int, flat: list[float], path: list[list[float]]
) -> tuple[int, np.ndarray]:
    """What `closed_loop` returns, its inputs in their line."""
    line.inputs[line.past : line.past + samples] = np.reshape(
        flat[line.past * line.inputs.shape[1] :], (samples, -1)
    )
    return samples, np.array(path)


def _moved(rows: list[list[float]], z: list[float]) -> list[float]:
    """[Φ Γ] z, added from left to right."""
    result = []
    for row in rows:
        total = 0.0
        for a, b in zip(row, z, strict=True):
            total += a * b
        result.append(total)
    return result


def _dot(a: list[float], b: list[float]) -> float:
    """Σ a_i b_i in the four sums of the kernel's `_dot`."""
    first = second = third = fourth = 0.0
    whole = len(a) - len(a) % 4
    for i in range(0, whole, 4):
        first += a[i] * b[i]
        second += a[i + 1] * b[i + 1]
        third += a[i + 2] * b[i + 2]
        fourth += a[i + 3] * b[i + 3]
    total = (first + second) + (third + fourth)
    for i in range(whole, len(a)):
        total += a[i] * b[i]
    return total


def _within_limit(x: list[float]) -> bool:
    """Whether |x| ≤ LIMIT (false when x is not a number)."""
    square = 0.0
    for part in x:
        square += (part / LIMIT) * (part / LIMIT)
    return square <= 1.0
