"""Loops with an observer and sums, a period at a time: exponentials of their own, nothing shared.

A run from sample to sample of plant, observer and law as docs/output-feedback.md has them: NumPy
and matrices' exponentials by halving and a Taylor series, no lifted matrix.
"""

import math
from itertools import pairwise

import numpy as np


def exponential(X):
    """e^X by 2^−k X, a Taylor series, and squares."""
    k = max(0, math.ceil(math.log2(max(np.abs(X).sum(axis=1).max(), 1e-300))) + 4)
    X = X / 2.0**k
    total = term = np.eye(len(X))
    for j in range(1, 20):
        term = term @ X / j
        total = total + term
    for _ in range(k):
        total = total @ total
    return total


def flow(A, b, time):
    """x after a time under dx/dt = A x + b, b held, as a function of x."""
    n = len(A)
    X = np.zeros((n + 1, n + 1))
    X[:n, :n], X[:n, n] = A, b
    return exponential(X * time)


class Line:
    """What was sent, the latest last, and what of it acts when."""

    def __init__(self, sent, step):
        self.sent, self.step = [np.array(u, float) for u in sent], step

    def acting(self, delays, time):
        """The inputs that act `time` seconds after the last sample, by the delay of each."""
        lags = [math.ceil(round((d - time) / self.step, 9)) for d in delays]
        return np.array([self.sent[-1 - lag][j] for j, lag in enumerate(lags)])

    def carry(self, plant, delays, x, spans):
        """x over a period, through (mode, start, stop) in turn."""
        for mode, start, stop in spans:
            cuts = {start, stop}
            for d in delays[mode]:
                arrives = round(d / self.step - math.floor(d / self.step + 1e-9), 12) * self.step
                cuts |= {arrives} if start < arrives < stop else set()
            marks = sorted(cuts)
            for a, b in pairwise(marks):
                u = self.acting(delays[mode], 0.5 * (a + b))
                moved = flow(plant.A[mode], plant.B[mode] @ u, b - a)
                x = moved[:-1, :-1] @ x + moved[:-1, -1]
        return x


def period(plant, loop, table, state, told, spans, lost=False):
    """(x, w, past inputs) a period later; w = (x̄, s), the past inputs the oldest first.

    `told` is (mode, row) that observer and law go by; `table` that of the law inside. Where the
    sample is `lost` the observer corrects nothing, and what it expects counts as measured.
    """
    x, w, past = state
    (mode, row), observer, h = told, loop.observer, loop.observer.step
    n_o = observer.plant.states
    x_bar, s = w[:n_o], w[n_o:]
    y = loop.outputs[spans[0][0]] @ x
    y = observer.C[mode] @ x_bar if lost else y
    estimate = x_bar if lost else x_bar + observer.gain[mode] @ (y - observer.C[mode] @ x_bar)
    value = np.zeros(0) if not s.size else loop.servo.tracked @ y
    q = s + 0.5 * h * value
    references = np.zeros(table.state_gain.shape[2] - n_o - q.size)
    u = table.state_gain[row] @ np.concatenate((estimate, q, references))
    for j, tap in enumerate(table.input_gain[row], 1):
        u = u + tap @ past[-j]
    line = Line([*past, u], h)
    model = observer.plant
    x_after = line.carry(plant, plant.delays, x, spans)
    bar_after = line.carry(model, model.delays, estimate, [(mode, 0.0, h)])
    return x_after, np.concatenate((bar_after, s + h * value)), [*past[1:], u]


PROBLEM = """\
[plant]
A = [[[0.0, 1.0], [-1.0, -0.8]], [[0.0, 1.0], [-1.3, -0.6]]]
B = [[[0.0], [1.0]], [[0.0], [1.1]]]
delay = 0.14
[gains]
poles = [-1.0, -2.0]
[[law]]
kind = "averaged"
[signal]
kind = "random"
dwell_time = 0.5
mean_sojourn = 1.2
seed = 1
[run]
x0 = [1.0, 0.0]
horizon = 2.0
step = 0.1
[observer]
kind = "luenberger"
C = [[1.0, 0.0]]
poles = [-4.0, -5.0]
"""
