"""A problem file of one's own, as the explorer opens it."""

# Three modes, two inputs, a delay of 7.3 periods, a plant that is not the laws' model.
OWN = """# my plant
title = "Mixer"

[plant]
delay = 0.365   # measured
A = [[[0.2, 1.0], [0.0, -0.5]], [[0.3, 1.1], [0.1, -0.4]], [[0.1, 0.9], [0.0, -0.6]]]
B = [[[0.1, 1.0], [1.0, 0.0]], [[0.1, 1.1], [1.1, 0.0]], [[0.0, 0.9], [0.9, 0.1]]]
states = ["level", "flow"]

[gains]
poles = [-1.0, -1.5]

[signal]
kind = "switches"
times = [0.0, 0.613, 1.287, 2.004]
modes = [0, 2, 1, 0]

[run]
x0 = [1.0, -0.5]
horizon = 4.0
step = 0.05

[truth]
delay = 0.37

[[law]]
kind = "averaged"

[[law]]
kind = "mean"
name = "middle"
"""
