"""
A plant of one's own
====================

Three modes, two inputs, a delay that is no multiple of the period.

The numbers are made up. What one learns: the whole path from matrices to a figure, with a law
whose model has the wrong delay beside one that has the right one.
"""

import numpy as np

import deadtime as dt

A = np.array([
    [[0.2, 1.0, 0.0], [0.0, -0.1, 1.0], [0.3, 0.0, -0.5]],
    [[0.3, 1.1, 0.0], [0.0, -0.2, 0.9], [0.2, 0.1, -0.4]],
    [[0.1, 0.9, 0.1], [0.1, -0.1, 1.1], [0.4, 0.0, -0.6]],
])  # fmt: skip
B = np.array([
    [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
    [[0.0, 0.1], [0.9, 0.0], [0.0, 1.1]],
    [[0.1, 0.0], [1.1, 0.0], [0.0, 0.9]],
])  # fmt: skip
plant = dt.SwitchedSystem(A, B, delay=0.87)
gains = dt.lqr(plant, Q=np.eye(3), R=np.eye(2))
signal = dt.SwitchingSignal.random(3, horizon=12.0, dwell_time=0.4, seed=7)

believed = dt.SwitchedSystem(A, B, delay=1.0)
laws = {
    "right delay": dt.AveragedPredictor(plant, gains),
    "delay believed 1 s": dt.AveragedPredictor(believed, gains),
    "delay ignored": dt.DelayedStateFeedback(plant, gains),
}
for name, law in laws.items():
    run = dt.simulate(plant, law, signal, x0=[1.0, 0.0, -1.0], horizon=10.0, step=0.02)
    print(f"{name:22s} cost {run.metrics()['cost']:.4g}")

run = dt.simulate(plant, laws["right delay"], signal, [1.0, 0.0, -1.0], 10.0, step=0.02)
run.plot("Three modes, two inputs").savefig("own_plant.png")
