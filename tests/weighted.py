"""A plant, its laws and a weight that sees states and inputs together."""

import numpy as np

import deadtime as dt
import plants

MODEL = plants.generic()
GAINS = plants.gains(MODEL)
TRUTH = dt.SwitchedSystem(1.02 * MODEL.A, 0.97 * MODEL.B, 0.251)
SIGNAL = dt.SwitchingSignal([0.0, 0.3718, 0.81, 1.3727, 1.8, 2.5234], [0, 2, 1, 0, 1, 2])
X0 = np.array([1.0, -0.5, 0.3])
Q = np.array([[2.0, 0.5, 0.0], [0.5, 1.0, -0.2], [0.0, -0.2, 0.1]])
R = np.array([[0.3, 0.1], [0.1, 0.2]])
WEIGHT = dt.Weight(Q, R)
LAWS = {
    "averaged": dt.AveragedPredictor(MODEL, GAINS),
    "dwell-aware": dt.AveragedPredictor(MODEL, GAINS, dwell_time=0.21),
    "expected": dt.ExpectedPredictor(MODEL, GAINS, dt.Markov(np.ones((3, 3)) - np.eye(3))),
    "oracle": dt.ExactPredictor(MODEL, GAINS),
}
