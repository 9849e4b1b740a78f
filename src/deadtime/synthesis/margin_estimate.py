"""The delay margin of constant modes, found fast: for searches, which decide with the exact one.

At the limit of stability det(M − r p) = 0 (`spectrum.response`). Far below the Nyquist frequency a
delay longer by δ turns the delay line p by e^{−iωδ}, so each eigenvalue λ(ω) of M⁻¹ r p with
|λ| = 1 asks for ωδ = arg λ, modulo 2π. Crossings of |λ| = 1 are read off a grid of frequencies;
from the nearest of them Newton's method goes to solutions (ω, D + δ) of det Δ = 0, p being exact
there. A crossing between two points of the grid is missed: `spectrum.margin` misses none.
"""

from __future__ import annotations

import math

import numpy as np

from deadtime.feedback import Feedback
from deadtime.plant import SwitchedSystem
from deadtime.spectrum.digital_response import DigitalResponse
from deadtime.spectrum.newton import decompose

_LOW, _FINE = 0.02, 0.25  # rad, of delay × frequency: the lowest, and the distance higher up
_FEW = 160
_STARTS, _NEWTON, _CONVERGED = 24, 12, 1e-6
_NEAREST = 0.6  # of a start's δ: so much nearer its solution may be
_HIGH = -0.2  # of log|λ|: a peak that may reach 1 at another delay


def estimated_margin(plant: SwitchedSystem, feedback: Feedback, mode: int) -> float:
    """The smallest error of the delay, relative to it, that loses a mode stable without one.

    Of several delays, which all err by as many seconds, relative to the shortest.
    """
    response = DigitalResponse.of(plant, feedback, mode)
    delay = plant.shortest_delay
    omega = frequencies(plant.longest_delay, response.highest)
    z, _ = response.free(omega)
    M, _ = response.law(omega)
    p, _, _ = response.delay_line(omega, np.full(omega.size, delay))
    loop = np.linalg.solve(M, feedback_to_state(response.F, z) @ p)
    values = loop[:, :, 0] if loop.shape[1] == 1 else np.linalg.eigvals(loop)
    values = np.take_along_axis(values, np.argsort(np.abs(values), axis=1), axis=1)
    w, away, sure = _starts(omega, values)
    best, batch = math.inf, 0
    while batch < w.size and _NEAREST * abs(away[batch]) < best:
        some = slice(batch, batch + _STARTS)
        found = _refine(response, w[some], away[some], sure[some], delay)
        best, batch = min(best, found), batch + _STARTS
    return best / delay


def feedback_to_state(F: np.ndarray, free: np.ndarray) -> np.ndarray:
    """r = F (zI − Φ)⁻¹ at every frequency."""
    return np.linalg.solve(free.transpose(0, 2, 1), F.T).transpose(0, 2, 1)


def frequencies(delay: float, highest: float) -> np.ndarray:
    """Even in the logarithm while that is closer, then as close as the loop turns."""
    low = np.geomspace(_LOW / delay, highest, _FEW, endpoint=False)
    even = np.arange(_FINE / delay, highest, _FINE / delay)
    return np.unique(np.concatenate((low, even)))


def _starts(omega: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies where a modulus passes 1 or peaks close to it, and the δ of either sign, seconds.

    The nearest first; and whether a modulus is sure to pass 1 there.
    """
    level = np.log(np.maximum(np.abs(values), 1e-300))
    angle = np.angle(values)
    rows, columns = np.nonzero(np.sign(level[1:]) != np.sign(level[:-1]))
    before, after = level[rows, columns], level[rows + 1, columns]
    part = before / (before - after)
    turn = np.angle(np.exp(1j * (angle[rows + 1, columns] - angle[rows, columns])))
    w = omega[rows] + part * np.diff(omega)[rows]
    at = angle[rows, columns] + part * turn
    inner = level[1:-1]
    peak = (inner >= level[:-2]) & (inner >= level[2:]) & (inner > _HIGH)
    rows, columns = np.nonzero(peak)
    sure = np.arange(w.size + rows.size) < w.size
    w = np.concatenate((w, omega[rows + 1]))
    at = np.concatenate((at, angle[rows + 1, columns]))
    longer = np.mod(at, 2.0 * np.pi) / w
    away = np.concatenate((longer, longer - 2.0 * np.pi / w))
    order = np.argsort(np.abs(away))
    return np.tile(w, 2)[order], away[order], np.tile(sure, 2)[order]


def _refine(
    response: DigitalResponse, w: np.ndarray, away: np.ndarray, sure: np.ndarray, delay: float
) -> float:
    """The smallest |δ| after Newton's method from every start; unrefined where it fails."""
    start, sign = np.where(sure, np.abs(away), np.inf), np.sign(away)
    d = delay + away
    able = d > 0.0
    w, d, start, sign = w[able], d[able], start[able], sign[able]
    best, alive = start.copy(), np.arange(w.size)
    for _ in range(_NEWTON):
        if alive.size == 0:
            break
        now = decompose(*response.matrix(w[alive], d[alive]))
        # 1 + a dω + b dD = 0: with b divided out, the imaginary part has no dD.
        a, b = now.slope(0), now.slope(1)
        with np.errstate(divide="ignore", invalid="ignore"):
            dw = -np.imag(1.0 / b) / np.imag(a / b)
            dd = -np.real(1.0 / b) - dw * np.real(a / b)
        step = np.maximum(np.abs(dw) / w[alive], np.abs(dd) / delay)
        near = (step < 0.3) & (d[alive] + dd > 0.0)
        alive, step = alive[near], step[near]
        w[alive] += dw[near]
        d[alive] += dd[near]
        moved = sign[alive] * (d[alive] - delay)
        done = (step < _CONVERGED) & (moved > 0.0) & (moved < 2.0 * start[alive])
        best[alive[done]] = moved[done]
        alive = alive[step >= _CONVERGED]
    return float(best.min()) if best.size else math.inf
