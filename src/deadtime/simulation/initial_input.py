"""The input before time 0: samples for the digital loop, a function for the ideal one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.checks import real_array, require_shape, require_unmasked
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.numerics.polynomials import Nodes, gauss

_TOLERANCE = 1e-12  # of the largest value of a piece, to which its polynomial must fit
_MOST_PIECES = 2000  # of a bisection: beyond, the function is noise


@dataclass(frozen=True, eq=False)
class InputHistory(Frozen):
    """Inputs before time 0: a function (T,) → (T, m), and the times at which it is not smooth."""

    function: Callable[[np.ndarray], np.ndarray]
    jumps: Float[np.ndarray, " jump"]

    def __call__(self, time: float) -> np.ndarray:
        """u at one time before 0."""
        return self.function(np.array([time]))[0]

    def on(self, edges: np.ndarray, nodes: Nodes) -> Float[np.ndarray, "segment node m"]:
        """Values at the support nodes of segments; the ends are extrapolated from inside."""
        inside = gauss(nodes.support.size).points
        times = edges[:-1, None] + np.diff(edges)[:, None] * inside
        values = self.function(times.ravel()).reshape(*times.shape, -1)
        return np.einsum("ij,sjm->sim", refit(inside, nodes.support), values)


def refit(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Matrix from values at points of [0, 1] to those of their polynomial at others."""
    degree = points.size - 1
    from_points = np.polynomial.legendre.legvander(2.0 * points - 1.0, degree)
    return np.polynomial.legendre.legvander(2.0 * others - 1.0, degree) @ np.linalg.inv(from_points)


InitialInput = ArrayLike | InputHistory | Callable[[float], ArrayLike] | None


def input_function(u0: InitialInput, m: int, delay: float) -> InputHistory:
    """`simulate`'s u0 for the ideal loop, on [−delay, 0), `delay` the longer of the two.

    Where a function jumps or bends is found by bisection.
    """
    if isinstance(u0, InputHistory):
        return u0
    if callable(u0):
        function = _check_values(u0, m)
        return InputHistory(function, _rough_places(function, delay))
    constant, held = _constant_or_held(u0, m)
    if held is None:
        return InputHistory(lambda s: np.tile(constant, (s.size, 1)), np.empty(0))
    if held.shape[0] != m:
        raise ArgumentError(f"u0 must hold (m, N) = ({m}, N) samples, got {held.shape}.")
    count = held.shape[1]
    jumps = -delay * np.arange(1, count + 1) / count

    def sample_and_hold(times: np.ndarray) -> np.ndarray:
        sample = np.floor((1.0 + times / delay) * count)
        return held.T[np.clip(sample, 0, count - 1).astype(int)]

    return InputHistory(sample_and_hold, jumps)


def held_samples(
    u0: InitialInput, m: int, past: int, step: float, delay: float
) -> Float[np.ndarray, "past m"]:
    """`simulate`'s u0 for the digital loop: the `past` inputs before time 0, oldest first."""
    if callable(u0):
        instants = np.maximum(-step * np.arange(past, 0, -1), -delay)
        function = u0.function if isinstance(u0, InputHistory) else _check_values(u0, m)
        return function(instants)
    constant, held = _constant_or_held(u0, m)
    if held is None:
        return np.tile(constant, (past, 1))
    if held.shape != (m, past):
        raise ArgumentError(
            f"u0 must hold (m, N) = ({m}, {past}) samples, oldest first, one per period of "
            f"the longer delay {delay:g} s, got {held.shape}."
        )
    return held.T


def _constant_or_held(u0: ArrayLike | None, m: int) -> tuple[np.ndarray, np.ndarray | None]:
    """A constant (m,), or samples (m, N) as the second."""
    constant = np.zeros(m)
    if u0 is None:
        return constant, None
    require_unmasked("u0", u0)
    try:
        given = np.asarray(u0)
    except ValueError:
        raise ArgumentError(
            "u0 must be a number, (m,), (m, N) or a function, got rows of different lengths."
        ) from None
    if given.ndim == 2:
        return constant, real_array("u0", given, "(m, N)", 2)
    constant = require_shape("u0", real_array("u0", np.atleast_1d(given), "(m,)", 1), (m,), "(m,)")
    return constant, None


def _check_values(u0: Callable[[float], ArrayLike], m: int) -> Callable[[np.ndarray], np.ndarray]:
    def function(times: np.ndarray) -> np.ndarray:
        values = [
            real_array("u0", np.atleast_1d(u0(float(t))), "(m,) at every time", 1) for t in times
        ]
        return np.stack([require_shape("u0", v, (m,), "(m,) at every time") for v in values])

    return function


def _rough_places(function: Callable[[np.ndarray], np.ndarray], delay: float) -> np.ndarray:
    """Ends of intervals on each of which one polynomial represents the function."""
    points, check = gauss(10).points, (np.arange(7) + 0.5) / 7.0
    to_check = refit(points, check)
    places: list[float] = []
    work = [(-delay, 0.0)]
    for _ in range(_MOST_PIECES):
        if not work:
            return np.unique(places)
        a, b = work.pop()
        values = function(a + (b - a) * points)
        wrong = np.abs(to_check @ values - function(a + (b - a) * check)).max()
        if wrong <= _TOLERANCE * max(1.0, np.abs(values).max()) or b - a < 1e-13 * delay:
            places += [a, b]
        else:
            work += [(a, (a + b) / 2.0), ((a + b) / 2.0, b)]
    # Noise, which no polynomial fits: an even grid averages over it.
    return np.linspace(-delay, 0.0, 33)
