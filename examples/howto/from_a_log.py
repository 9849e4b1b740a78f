"""
From a log to a certified controller in C
=========================================

A motor's log, integrated by SciPy from the motor's equations (`examples/logs/motor.py`): its
delay, 26.3 ms, comes out with its error; the law is certified, and written as C.
"""

import sys
from pathlib import Path

import numpy as np

import deadtime as dt

log = Path(sys.argv[0]).parents[1] / "logs" / "motor.csv"
fit = dt.identify(
    log, "arm", (0.0, 0.1), switches="samples", states=["speed", "current"], inputs=["voltage"]
)
print(*fit.sentences, sep="\n")
fit.plot().savefig("from_a_log.png")

gains = dt.lqr(fit.plant, np.eye(2), np.eye(1))
law = dt.AveragedPredictor(fit.plant, gains)
print(fit.verdict(dt.delay_margin(fit.plant, law, fit.step), law))

# A proof for every delay of the interval, and every signal that keeps the arm in or out for 0.2 s.
low, high = fit.interval("delay")
certificate = dt.certify(fit.plant, law, 0.2, fit.step, delays=(low, high))
print(certificate.message)
for other in fit.uncertain.draw(3):
    print(dt.certify(other, law, 0.2, fit.step).proven)

exported = dt.Controller(law, fit.step, limits=(-12.0, 12.0)).export_c("motor_c")
print(exported.check.message)
