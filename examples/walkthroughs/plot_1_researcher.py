r"""
A researcher: a law of the literature against the averaged one
==============================================================

You have a law, from a paper or your own, and want to know within minutes whether it is worth more
thought. Here it is *truncated predictor feedback* (B. Zhou, Z. Lin and G.-R. Duan, Automatica 48,
2012): of the exact prediction over the delay it keeps the part of the state,
:math:`u(t) = K_{\sigma(t)}\, e^{A_{\sigma(t)} D}\, x(t)`, and drops the integral over past inputs,
so that it needs no memory. After this page you can write such a law, compare it over random
switching signals, and prove or refute it.

**Source.** The plant is the example of arXiv 2503.08446. Ours are the comparison and its numbers.
"""

from dataclasses import dataclass

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from scipy.linalg import expm

import deadtime as dt
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH
from deadtime.feedback import Feedback
from deadtime.feedback.law import TableLaw, cache_table

# %%
# The law in ten lines
# --------------------
#
# At a sampling period a law is a table: gains of the state, (rows, m, n), and of the past inputs,
# (rows, N, m, m), with a row for every mode that it reads. This one has no gain on past inputs.


@dataclass(frozen=True, eq=False, repr=False)
class TruncatedPredictor(TableLaw):
    """The prediction without its integral."""

    label = "truncated"

    @cache_table
    def digital(self, step, signal=None, steps=None):
        window, (modes, m, _) = self.window(step), self.gains.shape
        pairs = zip(self.gains, self.plant.A, strict=True)
        F = np.stack([K @ expm(A * window.delay) for K, A in pairs])
        return Feedback(F, np.zeros((modes, window.count, m, m)), "mode", window.step)

    def ideal(self, signal, horizon):
        raise dt.ArgumentError("step must be given: this law has a digital form only.")


# %%
# Two hundred signals at every delay
# ----------------------------------
#
# Every law meets the same random signals. The example's delay of 1 s is long for a law without a
# memory, so the comparison begins at a fiftieth of it.

problem, step = dt.problems.paper(), 0.01
model = dt.Markov([[0.0, 1.25], [1.25, 0.0]])  # a mode lasts 0.8 s on average
delays = np.array([0.02, 0.05, 0.1, 0.15, 0.2])


def laws_at(delay):
    """The plant with this delay, and three laws for it."""
    plant = dt.SwitchedSystem(problem.plant.A, problem.plant.B, delay)
    return plant, {
        "averaged": dt.AveragedPredictor(plant, problem.gains),
        "truncated": TruncatedPredictor(plant, problem.gains),
        "delay ignored": dt.DelayedStateFeedback(plant, problem.gains),
    }


cost = {}
for delay in delays:
    plant, laws = laws_at(delay)
    runs = dt.monte_carlo(plant, laws, model, problem.x0, 10.0, step, scenarios=200)
    for name in laws:
        cost.setdefault(name, []).append(runs.cost.sel(law=name).quantile([0.1, 0.5, 0.9]).values)
    medians = ", ".join(f"{name} {values[-1][1]:.4g}" for name, values in cost.items())
    print(f"D = {delay:.2f} s, median cost: {medians}")

with rc_context(STYLE):
    figure = Figure(figsize=(WIDTH, 3.0), layout="constrained")
    axes = figure.subplots()
    for (name, values), colour in zip(cost.items(), COLOURS, strict=False):
        low, middle, high = np.array(values).T
        axes.semilogy(delays, middle, ".-", color=colour, label=name)
        axes.fill_between(delays, low, high, color=colour, alpha=0.15, linewidth=0.0)
    axes.set(xlabel="delay (s)", ylabel="cost, median and 10 to 90 %", ylim=(10.0, 1e5))
    axes.legend()
figure.savefig("researcher.png", dpi=120)

# %%
# A proof, or a signal that refutes
# ---------------------------------
#
# Random signals show what is usual. `certify` asks about all signals whose modes last 0.5 s or
# more: it proves a decay, or finds the signal along which the loop grows, to be run and plotted.

for delay in delays:
    plant, laws = laws_at(delay)
    for name in ("averaged", "truncated"):
        proof = dt.certify(plant, laws[name], 0.5, step)
        print(f"D = {delay:.2f} s, {name}: {proof.message}")
