"""
What does a loop stand?
=======================

Three modes, two inputs, a delay that is no multiple of the period.
"""

import deadtime as dt
from deadtime.reports import plot_robustness

A = [
    [[0.4, 1.0, 0.0], [0.0, -0.2, 0.5], [0.1, 0.0, -0.6]],
    [[0.5, 0.9, 0.0], [0.1, -0.3, 0.5], [0.0, 0.1, -0.5]],
    [[0.3, 1.1, 0.1], [0.0, -0.1, 0.4], [0.1, 0.0, -0.7]],
]
B = [
    [[0.0, 0.2], [1.0, 0.0], [0.0, 1.0]],
    [[0.0, 0.2], [1.1, 0.0], [0.0, 0.9]],
    [[0.1, 0.2], [0.9, 0.0], [0.0, 1.1]],
]
plant = dt.SwitchedSystem(A, B, delay=0.37)
gains = dt.place(plant, [-1.0, -1.5, -2.0])
model = dt.Markov([[0.0, 1.0, 0.5], [1.0, 0.0, 1.0], [0.5, 1.5, 0.0]])
law = dt.ExpectedPredictor(plant, gains, model)
signal = model.sample(14.0, seed=3)

result = dt.robustness(plant, law, signal, [1.0, -0.5, 0.2], horizon=12.0, step=0.05)
print("\n".join(result.sentences))
plot_robustness(result).savefig("robustness.png")
