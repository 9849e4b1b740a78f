"""The loop's gain at the plant's input, and the bands of frequencies in which it may be one.

With the plant's delay line p at the true delay D (`deadtime.spectrum.response`) a root lies on the
limit of stability at the frequency ω exactly if

    X(ω, D) = M⁻¹ r p    has the eigenvalue λ = 1.

In the ideal loop a longer delay turns λ by e^{−iωD} and leaves |λ| as it is; in the digital loop
|λ| also depends on where in a period the delay ends, and on nothing else about it. So no delay
puts a root at ω unless some |λ| is 1 there at some part of a period: the gain alone leaves a
few short bands. A perturbation of X gives, for an eigenvalue with left and right vectors y, x,

    d ln λ = yᴴ dX x/(λ yᴴ x),    dX = M⁻¹ (d(r p) − dM X).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from deadtime.numerics.small_matrices import inverses, traces
from deadtime.spectrum.response import Response, Samples

_FINE = 0.25  # of |d ln λ/dω|, times the distance of two samples
_FINEST = 1e-12  # of the highest frequency: closer than this nothing is sampled
_END = 1e-6  # of the lowest even sample
_LARGE = 1e150
_NOTHING = 1e-12  # relative to the largest entry


class Gain(NamedTuple):
    """Eigenvalues λ of X and d ln λ by frequency and by delay, each (points, m)."""

    value: np.ndarray
    by_frequency: np.ndarray
    by_delay: np.ndarray


class Band(NamedTuple):
    """Frequencies next to each other between which |λ| may be 1 at some delay.

    spread : by how much ln|λ| may differ between delays within a period.
    around : e^{−iωD} tells where λ turns to but for so many seconds of delay.
    """

    samples: Samples
    spread: float
    around: float


def loop_gain(response: Response, samples: Samples, delay: np.ndarray) -> Gain:
    """λ and its slopes at samples, a delay for each or one for all."""
    p, p_slope, p_speed = response.delay_line(samples.omega, delay)
    inverse = inverses(samples.M)
    X = inverse @ samples.r @ p
    turned = inverse @ (samples.r_slope @ p + samples.r @ p_slope - samples.M_slope @ X)
    moved = inverse @ samples.r @ p_speed
    X, turned, moved = (np.where(np.isfinite(part), part, _LARGE) for part in (X, turned, moved))
    if X.shape[-1] == 1:
        value, parts = X[:, :, 0], (turned[:, :, 0], moved[:, :, 0])
    else:
        value, right = np.linalg.eig(X)
        left = inverses(right)
        parts = tuple(np.einsum("pij,pjk,pki->pi", left, part, right) for part in (turned, moved))
    # Fewer states than inputs, or a gain with a row of 0, leave eigenvalues that are 0 but for
    # round-off, whose logarithm has no slope.
    floor = _NOTHING * (1.0 + np.abs(X).max(axis=(1, 2)))[:, None]
    nothing = np.abs(value) <= floor
    value = np.where(nothing, floor, value)
    by_frequency, by_delay = (np.where(nothing, 0.0, part / value) for part in parts)
    return Gain(value, by_frequency, by_delay)


def bands(response: Response, delay: float) -> list[Band]:
    """Where |λ| may be 1 at some delay, in rising order; the first samples are for this delay."""
    count = int(2.0 * response.highest * (response.memory + delay)) + 64
    omega = (np.arange(count) + 0.5) / count * response.highest
    # Between the outermost samples and the ends of the range there is next to nothing.
    outer = response.samples(np.array([_END * omega[0], response.highest - _END * omega[0]]))
    inner = response.samples(omega, even=True)
    parts = zip(outer, inner, strict=True)
    samples = Samples(*(np.concatenate((a[:1], b, a[1:])) for a, b in parts))
    low, high, rate, lag = _levels(response, samples)
    least = _FINEST * response.highest
    while True:
        points = np.concatenate(([0.0], samples.omega, [response.highest]))
        gap = np.diff(points)
        turns = _ends(rate, np.maximum) * gap
        away = np.maximum(_ends(low, np.minimum), -_ends(high, np.maximum)).min(axis=1)
        clear = turns <= np.clip(away, 0.0, _FINE)
        coarse = np.flatnonzero(~clear & ~(turns <= _FINE) & (gap > least))
        if coarse.size == 0:
            break
        more = response.samples(points[coarse] + gap[coarse] / 2.0)
        new = (*more, *_levels(response, more))
        old = (*samples, low, high, rate, lag)
        merged = [np.insert(a, coarse, b, axis=0) for a, b in zip(old, new, strict=True)]
        samples, (low, high, rate, lag) = Samples(*merged[:-4]), merged[-4:]
    return _runs(samples, clear, high - low, lag)


def _levels(response: Response, samples: Samples) -> tuple[np.ndarray, ...]:
    """The least and the largest ln|λ| over all delays, moduli in order; rate of change; lag."""
    cuts, points = response.cuts, samples.omega.size
    delay = np.repeat(cuts, points)
    gain = loop_gain(response, samples.repeat(cuts.size), delay)
    level = np.sort(np.log(np.abs(gain.value)), axis=1).reshape(cuts.size, points, -1)
    rates = np.abs(gain.by_frequency + 1j * delay[:, None]).max(axis=1).reshape(cuts.size, points)
    turns = np.imag(gain.by_delay).reshape(level.shape) / samples.omega[:, None]
    lags = np.abs(1.0 + turns).max(axis=2)
    # Between two of these delays it may go on by half of what it changed; the first follows the
    # last, for a delay of a whole period is one of none.
    slack = 0.5 * np.abs(np.diff(level, axis=0, prepend=level[-1:])).max(axis=0)
    low, high = level.min(axis=0) - slack, level.max(axis=0) + slack
    # Where |λ| is small its zeros make ln|λ| steep but |λ| not; poles make both steep.
    own = np.max(rates, axis=0) * np.exp(np.minimum(high.max(axis=1), 0.0))
    law = np.abs(traces(inverses(samples.M), samples.M_slope))
    rate = np.nan_to_num(np.max([own, np.abs(samples.plant), law], axis=0), nan=np.inf)
    lag = (response.period or 0.0) * np.minimum(np.nan_to_num(np.max(lags, axis=0), nan=1.0), 1.0)
    return low, high, rate, lag


def _ends(value: np.ndarray, choose: np.ufunc) -> np.ndarray:
    """Of the values at both ends of every cell, the ones chosen; there is one at the outer two."""
    return np.concatenate((value[:1], choose(value[1:], value[:-1]), value[-1:]))


def _runs(samples: Samples, clear: np.ndarray, spread: np.ndarray, lag: np.ndarray) -> list[Band]:
    """Samples around cells that are not clear, cells next to each other in one band."""
    # Cell i lies between the samples i − 1 and i; the outer two have one sample each.
    inside = np.concatenate(([False], ~clear, [False]))
    edges = np.flatnonzero(np.diff(inside.astype(int)))
    found = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        part = slice(max(first - 1, 0), min(last, samples.omega.size - 1) + 1)
        inner = Samples(*(x[part] for x in samples))
        found.append(Band(inner, float(spread[part].max()), float(lag[part].max())))
    return found
