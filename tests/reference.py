"""A second method for the digital loop that shares no code with the package.

Events are exact fractions; between events the state is a Taylor series of the differential
equation itself in extended precision; a law is evaluated from its definition, by running its
model forward over the delay under its forecast. There is no Φ, no Γ, no window and no table.
"""

from __future__ import annotations

import bisect
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

LONG = np.longdouble


@dataclass
class Model:
    """A plant with exact delay."""

    A: np.ndarray
    B: np.ndarray
    delay: Fraction


@dataclass
class Signal:
    """Right-continuous modes with exact switching instants."""

    times: list[Fraction]
    modes: list[int]

    def __call__(self, t: Fraction) -> int:
        return self.modes[bisect.bisect_right(self.times, t) - 1]


def flow(A: np.ndarray, force: np.ndarray, x: np.ndarray, tau: Fraction) -> np.ndarray:
    """x(τ) of dx/dt = A x + force, by the Taylor series of x."""
    pieces = max(1, int(np.ceil(float(tau) * np.abs(A).sum(axis=1).max())))
    span = LONG(tau.numerator) / LONG(tau.denominator) / pieces
    for _ in range(pieces):
        term, total = (A @ x + force) * span, x.copy()
        for k in range(2, 40):
            total += term
            term = (A @ term) * (span / k)
        x = total
    return x


def run_model(
    model: Model,
    mode: Callable[[Fraction], int],
    switches: list[Fraction],
    held: Callable[[int], np.ndarray],
    step: Fraction,
    x: np.ndarray,
    start: Fraction,
    end: Fraction,
) -> np.ndarray:
    """x(end) from x(start), u held on the grid of `step` and arriving model.delay late."""
    first = (start - model.delay) // step
    last = (end - model.delay) // step
    arrivals = [j * step + model.delay for j in range(first, last + 1)]
    cuts = sorted({start, end, *(t for t in (*arrivals, *switches) if start < t < end)})
    for a, b in itertools.pairwise(cuts):
        i = mode(a)
        force = model.B[i].astype(LONG) @ held((a - model.delay) // step)
        x = flow(model.A[i].astype(LONG), force, x, b - a)
    return x


class Loop:
    """The sampled loop: `law` maps (loop, k, x) to (u, sum of the magnitudes of its terms)."""

    def __init__(self, plant: Model, signal: Signal, step: Fraction, history: np.ndarray) -> None:
        self.plant, self.signal, self.step = plant, signal, step
        self.inputs = {j: history[j].astype(LONG) for j in range(-len(history), 0)}

    def held(self, j: int) -> np.ndarray:
        return self.inputs[j]

    def predict(self, model: Model, forecast: Signal, k: int, x: np.ndarray) -> list[np.ndarray]:
        """Free and forced response of the model over its delay, from t_k."""
        start, end = k * self.step, k * self.step + model.delay
        zero = np.zeros(model.B.shape[2], LONG)
        arguments = (model, forecast, forecast.times)
        free = run_model(*arguments, lambda j: zero, self.step, x, start, end)
        forced = run_model(*arguments, self.held, self.step, np.zeros_like(x), start, end)
        return [free, forced]

    def run(self, law, x0: np.ndarray, samples: int) -> tuple[np.ndarray, np.ndarray, float]:
        """States and inputs at the samples, and the largest sum of magnitudes of terms."""
        x = np.array(x0, LONG)
        states, inputs, scale = [x], [], float(np.abs(x).max())
        for k in range(samples):
            u, terms = law(self, k, x)
            self.inputs[k] = u
            inputs.append(u)
            t = k * self.step
            scale = max(scale, float(np.abs(x).max()), float(np.abs(terms).max()))
            x = run_model(
                self.plant,
                self.signal,
                self.signal.times,
                self.held,
                self.step,
                x,
                t,
                t + self.step,
            )
            states.append(x)
        return np.array(states[:-1]), np.array(inputs), scale


def _weighted(parts: list[tuple[np.ndarray, list[np.ndarray]]]) -> tuple[np.ndarray, np.ndarray]:
    """Σ K y and Σ |K| |y| over gains K and lists of terms y."""
    u = sum(K.astype(LONG) @ y for K, ys in parts for y in ys)
    terms = sum(np.abs(K).astype(LONG) @ np.abs(y) for K, ys in parts for y in ys)
    return u, terms


def constant(mode: int) -> Signal:
    return Signal([Fraction(0)], [mode])


def averaged(model: Model, gains: np.ndarray, weights: np.ndarray):
    def law(loop: Loop, k: int, x: np.ndarray):
        return _weighted(
            [(w * K, loop.predict(model, constant(i), k, x))
             for i, (w, K) in enumerate(zip(weights, gains, strict=True))]
        )  # fmt: skip

    return law


def single(model: Model, gains: np.ndarray, mode: int):
    return lambda loop, k, x: _weighted([(gains[mode], loop.predict(model, constant(mode), k, x))])


def mean(model: Model, gain: np.ndarray):
    centre = Model(
        model.A.mean(axis=0, keepdims=True), model.B.mean(axis=0, keepdims=True), model.delay
    )
    return lambda loop, k, x: _weighted([(gain, loop.predict(centre, constant(0), k, x))])


def dwelling(model: Model, after: Model, gains: np.ndarray, dwell_time: Fraction, age: int = 0):
    """The sampled mode for the rest of its dwell time, then one of the modes of `after` for ever.

    `gains` are the (weighted) gains of these modes; `age` is that of the first mode, in samples.
    """
    modes = model.A.shape[0]
    both = Model(
        np.concatenate((model.A, after.A)), np.concatenate((model.B, after.B)), model.delay
    )
    seen: list[tuple[int, int]] = []

    def law(loop: Loop, k: int, x: np.ndarray):
        now = k * loop.step
        mode = loop.signal(now)
        if not seen:
            seen.append((mode, age))
        else:
            seen.append((mode, seen[-1][1] + 1 if mode == seen[-1][0] else 0))
        rest = dwell_time - seen[-1][1] * loop.step
        parts = []
        for i, K in enumerate(gains):
            forecast = constant(modes + i)
            if rest > 0:
                forecast = Signal([Fraction(0), now + rest], [mode, modes + i])
            parts.append((K, loop.predict(both, forecast, k, x)))
        return _weighted(parts)

    return law


def exact(model: Model, gains: np.ndarray):
    def law(loop: Loop, k: int, x: np.ndarray):
        final = loop.signal(k * loop.step + model.delay)
        return _weighted([(gains[final], loop.predict(model, loop.signal, k, x))])

    return law


def delayed(model: Model, gains: np.ndarray):
    return lambda loop, k, x: _weighted([(gains[loop.signal(k * loop.step)], [x])])
