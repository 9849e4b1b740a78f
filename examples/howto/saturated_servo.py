"""
What does a saturated servo stand?
==================================

A motor with two inertias follows 100 rad/s over 30 ms of delay, from rest, with at most 12 V.
Limits keep every oscillation bounded, so that the question is whether the speed still settles.
"""

import numpy as np

import deadtime as dt
from deadtime.imperfections import Saturation
from deadtime.reports import plot_robustness

R, L, k, b = 1.0, 5e-3, 0.05, 1e-4
A = [[[-b / J, k / J], [-k / L, -R / L]] for J in (2e-4, 6e-4)]
plant = dt.SwitchedSystem(A, [[[0.0], [1.0 / L]]] * 2, delay=0.030)
step = 0.005

servo = dt.Servo(plant, C=np.eye(2), tracked=[[1.0, 0.0]])
gains = servo.lqr(np.diag([1.0, 0.01, 100.0]), [[20.0]], step=step)
law = dt.AveragedPredictor(servo.plant, gains, allow_unstable=True)
observer = dt.luenberger(servo.model, servo.C, poles=[-150.0, -200.0], step=step)
loop = dt.OutputFeedback(law, observer, servo=servo, reference=100.0)
signal = dt.SwitchingSignal.random(2, 4.0, dwell_time=0.3, seed=1)

result = dt.robustness(
    plant, loop, signal, [0.0, 0.0], horizon=3.0, step=step, scenarios=5,
    imperfections=[Saturation(-12.0, 12.0)],
)  # fmt: skip
print("\n".join(result.sentences))
names = ["light", "heavy"]
plot_robustness(result, modes=names).savefig("saturated_servo.png")
