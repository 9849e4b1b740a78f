"""
Outputs instead of states
=========================

A plant of which two of three states are measured: observer, disturbance, reference.

A made-up reactor with three settings of its coolant pump, two heaters and a dead time that is no
multiple of the period. What one learns: a law on estimates becomes the law on states, and a switch
between samples costs a little of it; where the plant switches and is disturbed, feed-forward alone
misses the reference, and a sum of the errors brings it back.
"""

import numpy as np
from matplotlib.figure import Figure

import deadtime as dt
from deadtime.imperfections import Noise, StepDisturbance

# Reactor, product and jacket temperatures, in K from rest; minutes.
A = np.array([
    [[0.10, 0.0, 0.30], [0.40, -0.50, 0.0], [0.20, 0.0, -0.60]],
    [[0.05, 0.0, 0.35], [0.45, -0.55, 0.0], [0.20, 0.0, -0.75]],
    [[0.12, 0.0, 0.25], [0.35, -0.45, 0.0], [0.20, 0.0, -0.50]],
])  # fmt: skip
B = np.array([
    [[0.0, 0.0], [0.0, 0.8], [1.0, 0.0]],
    [[0.1, 0.0], [0.0, 0.9], [1.0, 0.0]],
    [[0.0, 0.0], [0.0, 0.7], [0.9, 0.1]],
])  # fmt: skip
C = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
plant, step, horizon = dt.SwitchedSystem(A, B, delay=0.87), 0.1, 60.0
signal = dt.SwitchingSignal.random(3, horizon + 1.0, dwell_time=2.0, seed=7)

# 1. The state from the outputs.
law = dt.AveragedPredictor(plant, dt.lqr(plant, np.eye(3), np.eye(2), step=step))
observer = dt.kalman(plant, C, process=0.1 * np.eye(3), measurement=0.01 * np.eye(2), step=step)
print(f"error decays at {observer.rates.round(2)} 1/min in the modes")
start = [2.0, -1.0, 1.0]
plain = dt.simulate(plant, law, signal, start, horizon, step)
loop = dt.simulate(plant, dt.OutputFeedback(law, observer), signal, start, horizon, step)
print(f"cost {plain.metrics()['cost']:.2f} on the state, {loop.metrics()['cost']:.2f} observed")

# 2. A reference and a constant disturbance; the outputs are noisy.
times, values = [0.0, 5.0, 35.0], [[0.0, 0.0], [2.0, 1.0], [2.0, 3.0]]
disturbed = [StepDisturbance([0.3, 0.0, 0.2], start=20.0), Noise(0.02)]
runs = {}
for name, integral in (("feed-forward alone", False), ("with the sum of the errors", True)):
    servo = dt.Servo(plant, C, integral=integral)
    weight = np.eye(3 + servo.sums)
    gains = servo.lqr(weight, 0.3 * np.eye(2), step=step)
    tracking = dt.OutputFeedback(
        dt.AveragedPredictor(servo.plant, gains, allow_unstable=True),
        observer,
        servo=servo,
        reference=(times, values),
    )
    run = dt.simulate(plant, tracking, signal, np.zeros(3), horizon, step, imperfections=disturbed)
    runs[name] = run
    late = run.time >= 50.0
    error = np.abs((run.states[:2, late] - np.array(values[-1])[:, None]).mean(axis=1)).max()
    print(f"{name}: mean error of the last 10 min {error:.3f} K")

figure = Figure(figsize=(8, 8))
first, second, third = figure.subplots(3, 1, height_ratios=(1, 1.4, 0.4))
first.semilogy(loop.time, np.linalg.norm(loop.estimates - loop.states, axis=0), label="|x − x̂|")
first.semilogy(plain.time, np.linalg.norm(plain.states, axis=0), label="|x|, on the state")
first.semilogy(loop.time, np.linalg.norm(loop.states, axis=0), "--", label="|x|, observed")
first.set(xlim=(0, 30), ylim=(1e-6, 10), ylabel="K", title="The observed loop and its error")
first.legend()
for (name, run), style in zip(runs.items(), (":", "-"), strict=True):
    for i, colour in enumerate(("C0", "C1")):
        second.plot(run.time, run.states[i], style, color=colour, label=f"y{i + 1}, {name}")
schedule = np.array(values)[np.searchsorted(times, run.time, "right") - 1]
second.plot(run.time, schedule, color="0.4", linewidth=0.8, label=["reference", "_"])
second.axvline(20.0, color="0.7", linestyle="--", linewidth=0.8)
second.text(20.3, -0.3, "disturbance", color="0.4")
second.set(xlim=(0, horizon), ylim=(-0.6, 5.6), ylabel="K", title="References through switches")
second.legend(fontsize="small", loc="upper left")
third.step(run.time, run.mode, where="post", color="0.3")
third.set(xlim=(0, horizon), yticks=(0, 1, 2), ylabel="mode", xlabel="time, min")
figure.tight_layout()
figure.savefig("output_feedback.png", dpi=110)
