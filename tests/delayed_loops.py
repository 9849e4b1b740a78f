"""The lifted loop of a plant whose modes and inputs have delays of their own, by definition.

A second method: which sample an input is read from is asked in the middle of every part of a
period, in exact fractions; nothing here knows of lags, marks or segments.
"""

import itertools
import math
from fractions import Fraction
from functools import cache

import numpy as np

import certificate_reference as reference
from certificate_reference import decimal, exponential, many_digits, precise


class Plant:
    """A period: x⁺ = E (x, u_k, u_{k−1}, …, u_{k−N}), in floats or with 50 digits."""

    def __init__(self, A, B, delays, step, digits=False) -> None:
        self.A, self.B = (many_digits(X) if digits else np.asarray(X) for X in (A, B))
        self.h, self.digits = decimal(step), digits
        self.delays = [[decimal(delay) for delay in row] for row in np.asarray(delays).tolist()]
        self.count = max(math.ceil(delay / self.h) for row in self.delays for delay in row)
        self.modes, self.n, self.m = self.B.shape
        self.rows = cache(self._rows)

    def _rows(self, mode: int, after: int | None = None, s=1) -> np.ndarray:
        """E of a period in `mode`, and from the fraction `s` of it on in `after`."""
        n, m, s = self.n, self.m, Fraction(s) * self.h
        arrivals = {delay % self.h for row in self.delays for delay in row}
        E = np.eye(n, n + (self.count + 1) * m).astype(self.A.dtype)
        for a, b in itertools.pairwise(sorted({Fraction(0), *arrivals, s, self.h})):
            i = mode if a < s or after is None else after
            tau = precise(b - a) if self.digits else float(b - a)
            block = np.zeros((n + m, n + m)).astype(E.dtype)
            block[:n, :n], block[:n, n:] = self.A[i] * tau, self.B[i] * tau
            whole = exponential(block)[:n]
            E = whole[:, :n] @ E
            for j, delay in enumerate(self.delays[i]):
                sample = math.floor(((a + b) / 2 - delay) / self.h)  # 0 is u_k
                E[:, n - sample * m + j] += whole[:, n + j]
        return E


class Loop(reference.Loop):
    """`certificate_reference.Loop` of such a plant."""

    def __init__(self, plant, table, digits=False) -> None:
        super().__init__(plant.A, plant.B, plant.longest_delay, table, digits)
        self.plant = Plant(plant.A, plant.B, plant.delays, table.step, digits)

    def step(self, mode: int, age: int, after: int | None = None, s=1) -> np.ndarray:
        """M of a period that begins in `mode` at an age; a switch at the fraction `s` of it."""
        w, u = self.outputs(self.row(mode, age))
        state = np.eye(self.plant.n, self.order).astype(u.dtype)
        x = self.plant.rows(mode, after, s) @ np.concatenate((state, *u[: self.plant.count + 1]))
        return np.concatenate((x, w, *u[: self.held]))
