"""How many characteristic roots lie to the right of a line: the argument principle.

With n poles p to the left of the line Re s = c, f(s) = det Δ(s)/(s − p)ⁿ has no pole on it or to
its right, tends to 1 there, and is real on the real axis. So the number of roots to the right is
the turn of f's argument along the upper half of the line, in half turns:

    count = (arg f(c) − arg f(c + i∞))/π.

The argument is followed over points so close that |f'/f| times their distance is below 1, up to
the radius beyond which I − Y(s), Y(s) = W(s) + F (sI − A)⁻¹ B diag(e^{−sD_j}), |Y| < 1, has none
but eigenvalues of positive real part; what is left to infinity is the sum of their arguments.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex, Float

from deadtime.spectrum.ideal import IdealLoop

MOST_POINTS = 400_000
_CHUNK = 20_000


def count_right_of(loop: IdealLoop, line: float) -> int | None:
    """Roots with Re s > `line`; None on a line too close to a root or too long to be followed."""
    radius = loop.radius(line)
    spacing = 1.0 / (float(loop.delays.max()) + loop.lead + 1.0 / radius)
    if not radius / spacing < MOST_POINTS:
        return None
    pole = line - loop.unit
    points = np.linspace(0.0, radius, int(radius / spacing) + 2)
    sign, rate = _values(loop, line + 1j * points, pole)
    while True:
        gap = np.diff(points)
        coarse = np.flatnonzero(~(np.maximum(rate[1:], rate[:-1]) * gap <= 1.0))
        if coarse.size == 0:
            break
        if points.size > MOST_POINTS or gap.min() < 1e-13 * (1.0 + abs(line)):
            return None
        middles = points[coarse] + gap[coarse] / 2.0
        more_sign, more_rate = _values(loop, line + 1j * middles, pole)
        points = np.insert(points, coarse + 1, middles)
        sign, rate = (
            np.insert(sign, coarse + 1, more_sign),
            np.insert(rate, coarse + 1, more_rate),
        )
    turn = float(np.angle(sign[1:] / sign[:-1]).sum())
    half_turns = -(turn - _rest(loop, line + 1j * radius, pole)) / np.pi
    nearest = round(half_turns)
    return nearest if abs(half_turns - nearest) < 1e-3 else None


def _values(
    loop: IdealLoop, s: Complex[np.ndarray, " point"], pole: float
) -> tuple[Complex[np.ndarray, " point"], Float[np.ndarray, " point"]]:
    """f/|f| and |f'/f|."""
    n = loop.A.shape[0]
    sign, rate = np.empty(s.size, complex), np.empty(s.size)
    for start in range(0, s.size, _CHUNK):
        part = slice(start, start + _CHUNK)
        Delta, prime = loop.matrix(s[part])
        phase = np.linalg.slogdet(Delta)[0]
        lost = phase == 0.0  # exactly singular: a root on the line
        Delta[lost] = np.eye(Delta.shape[1])
        away = s[part] - pole
        sign[part] = np.where(lost, 1.0, phase) * (np.abs(away) / away) ** n
        slope = np.trace(np.linalg.solve(Delta, prime), axis1=1, axis2=2) - n / away
        rate[part] = np.where(lost, np.inf, np.abs(slope))
    return sign, rate


def _rest(loop: IdealLoop, end: complex, pole: float) -> float:
    """arg f at the end of the line, followed back from its limit 0 at infinity."""
    n = loop.A.shape[0]
    W = loop.memory(np.array([end]))[0][0]
    free = np.linalg.solve(end * np.eye(n) - loop.A, loop.B * np.exp(-end * loop.delays))
    fed = np.linalg.eigvals(np.eye(W.shape[0]) - W - loop.F @ free)
    open_loop = (end - np.linalg.eigvals(loop.A)) / (end - pole)
    return float(np.angle(fed).sum() + np.angle(open_loop).sum())
