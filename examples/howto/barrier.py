"""
A barrier on the predicted state
================================

A carriage must not go faster than it may, with a load or without one, and its drive answers half a
second late. A control-barrier filter changes the input of a law as little as it must for that,

    h(x(t + D + step)) ≥ (1 − γ) h(x(t + D)),    h = limit − speed,

and what it has to look at is the state that the input will meet, in either mode, and how surely:
``Controller.prediction``. The same filter on the state of now comes too late.
"""

import argparse
from itertools import cycle

import matplotlib.pyplot as plt
import numpy as np

import deadtime as dt
from deadtime.imperfections import WhiteDisturbance

STEP, HORIZON, LIMIT, SHARE = 0.05, 14.0, 1.0, 0.3  # s, s, m/s, γ
W = np.diag([0.0, 1e-4])  # of the speed, (m/s)² per second
A = [[[0.0, 1.0], [0.0, -0.5]], [[0.0, 1.0], [0.0, -0.3]]]  # position, speed; without a load, with
plant = dt.SwitchedSystem(A, [[[0.0], [1.0]], [[0.0], [0.6]]], delay=0.5)
gains = dt.place(plant, [-0.8, -1.2])
model = dt.Markov([[0.0, 0.5], [0.5, 0.0]])
law = dt.ExpectedPredictor(plant, gains, model)

# %%
# One period ahead the speed is linear in the input, so the filter is the least of a bound per mode.
# It keeps three standard deviations of what the prediction cannot know.

periods = [law.sampled_plant(STEP).period(mode) for mode in (0, 1)]
Phi, Gamma = [p.Phi for p in periods], [p.Gamma.sum(axis=0) for p in periods]


def highest(states, spread):
    """The largest input that the barrier allows, of a state and a margin by mode."""
    bounds = []
    for i, x in enumerate(states):
        ahead = (1.0 - SHARE) * x[1] + SHARE * (LIMIT - spread[i])
        bounds.append((ahead - Phi[i][1] @ x) / Gamma[i][1, 0])
    return min(bounds)


class Barrier(dt.Law):
    """A law behind the filter; `late`: it looks at the state of now."""

    def __init__(self, late):
        vars(self).update(plant=plant, gains=None, outputs=None, late=late)

    @property
    def label(self):
        return "barrier on x(t)" if self.late else "barrier on x̂(t + D)"

    def digital(self, step, signal=None, steps=None):
        raise dt.ArgumentError("a filter is no table.")

    def ideal(self, signal, horizon):
        raise dt.ArgumentError("step must be given: the filter runs at samples.")

    def online(self, step, signal=None, steps=None):
        controller = dt.Controller(law, step)

        def control(x, past, mode, age):
            asked = controller.update(x, mode, applied=past[-1])
            if self.late:
                return np.minimum(asked, highest([x, x], [0.0, 0.0]))
            found = controller.prediction
            spread = 3.0 * np.sqrt(found.covariance_by_mode(W)[0, :, 1, 1])
            return np.minimum(asked, highest(found.by_mode[0], spread))

        return control


# %%
# From 6 m away, along signals that are drawn, with a disturbance.


def run(control, seed):
    signal = model.sample(HORIZON, seed=seed)
    wind = [WhiteDisturbance(W)]
    start = [-6.0, 0.0]
    return dt.simulate(plant, control, signal, start, HORIZON, STEP, imperfections=wind, seed=seed)


def figure(laws):
    whole, axes = plt.subplots(3, 1, sharex=True, figsize=(7, 6), layout="constrained")
    for control, style in zip(laws, cycle((":", "--", "-"))):
        result = run(control, 0)
        for axis, values in zip(axes, (*result.states, result.inputs[0]), strict=True):
            axis.plot(result.time, values, style, label=control.label)
    axes[1].axhline(LIMIT, color="0.6", linewidth=0.8)
    for axis, name in zip(axes, ("position, m", "speed, m/s", "input, m/s²"), strict=True):
        axis.set_ylabel(name)
    axes[0].legend(loc="lower right")
    axes[-1].set_xlabel("time, s")
    whole.savefig("barrier.png")


def main(seeds):
    laws = [law, Barrier(late=True), Barrier(late=False)]
    for control in laws:
        fastest = np.array([run(control, seed).states[1].max() for seed in range(seeds)])
        kept = (fastest <= LIMIT).sum()
        print(f"{control.label}: kept in {kept} of {seeds} runs, fastest {fastest.max():.2f} m/s")
    figure(laws)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=4)
    main(parser.parse_known_args()[0].seeds)
