"""
A drone that holds its place by camera, in wind
===============================================

A quadrotor holds its place over a point by what a camera sees of it: a position thirty times a
second, noisy and late. In wind the air holds it more firmly, and pushes it. What one learns: an
observer gives the law the three states and the wind that the camera does not see; the delay that
makes the plain controller swing is the predictor's to bear; and only a controller that knows of
the wind ends up over the point.

**Source.** The model of J. Engel, J. Sturm and D. Cremers, "Scale-aware navigation of a low-cost
quadrocopter with a monocular camera", Robotics and Autonomous Systems 62 (2014), in the values of
their package tum_ardrone (``DroneKalmanFilter.cpp``) for the Parrot AR.Drone: dv/dt = c₁ (c₂ sin
φ − v) with c₁ = 0.58 /s, c₂ = 17.8 m/s; dφ/dt = c₃ (u − φ) with c₃ = 10 /s; delays of 75 ms for
the video and 100 ms for commands; 0.2 m noise of the camera's position; 33 poses a second.
Linearised at φ = 0. Ours are the wind (it doubles the drag, pushes with 0.8 m/s², and gusts), the
weights, and 30 periods a second.
"""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import deadtime as dt
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH
from deadtime.imperfections import ColouredDisturbance, Noise, StepDisturbance

DRAG, SPEED, TILT = 0.58, 17.8, 10.0  # 1/s, m/s, 1/s
DELAY, PERIOD, NOISE = 0.075 + 0.100, 1.0 / 30.0, 0.2  # s, s, m
WINDY = 2.0  # times the drag
PUSH = np.array([0.0, 0.8, 0.0])  # m/s² on the speed


def derivatives(speed, tilt, command, drag):
    """d(position)/dt, d(speed)/dt, d(tilt)/dt before linearisation."""
    return speed, DRAG * SPEED * np.sin(tilt) - drag * speed, TILT * (command - tilt)


# %%
# Position (m), speed (m/s) and tilt (rad), in calm air and in wind. The delay is five and a
# quarter periods, which the digital loop takes as it is.

drags = (DRAG, WINDY * DRAG)
A = [[[0.0, 1.0, 0.0], [0.0, -drag, DRAG * SPEED], [0.0, 0.0, -TILT]] for drag in drags]
plant = dt.SwitchedSystem(A, [[[0.0], [0.0], [TILT]]] * 2, DELAY)
camera = [[1.0, 0.0, 0.0]]
print(f"delay of {DELAY / PERIOD:.2f} periods")

# %%
# Three controllers on the same camera
# ------------------------------------
#
# The wind's push is a constant disturbance to the observer; it drifts, which lets the Kalman
# filter follow it. One controller predicts and opposes the wind, one predicts only, one does
# neither.

weights = np.diag([4.0, 0.1, 0.0]), [[1.0]]
servo = dt.Servo(plant, camera, integral=False, disturbance=[[0.0], [1.0], [0.0]])
gains = servo.lqr(*weights, step=PERIOD)
process, drift = np.diag([0.0, 0.5, 0.0]), 0.5
knows_wind = dt.kalman(
    servo.model, servo.C, np.diag([*np.diag(process), drift]), [[NOISE**2]], PERIOD
)
knows_none = dt.kalman(plant, camera, process, [[NOISE**2]], PERIOD)
start = [1.0, 0.0, 0.0]
plain = dt.lqr(plant, *weights, step=PERIOD)
laws = {
    "predicts, knows wind": dt.OutputFeedback(
        dt.AveragedPredictor(servo.plant, gains, allow_unstable=True),
        knows_wind,
        servo=servo,
        estimate=[*start, 0.0],
    ),
    "predicts": dt.OutputFeedback(dt.AveragedPredictor(plant, plain), knows_none, estimate=start),
    "delay ignored": dt.OutputFeedback(
        dt.DelayedStateFeedback(plant, plain), knows_none, estimate=start
    ),
}
for name, law in laws.items():
    rates = [dt.growth_rate(plant, law, mode, PERIOD) for mode in (0, 1)]
    print(f"{name:21s} growth {rates[0]:+.2f} /s calm, {rates[1]:+.2f} /s in wind")

# %%
# Calm, wind, calm
# ----------------

signal = dt.SwitchingSignal([0.0, 8.0, 22.0], [0, 1, 0])
weather = [
    StepDisturbance(PUSH, start=8.0, end=22.0),
    ColouredDisturbance(std=0.3, time_constant=1.0, force=[0.0, 1.0, 0.0]),
    Noise(NOISE),
]
runs = {
    name: dt.simulate(plant, law, signal, start, 30.0, PERIOD, imperfections=weather, seed=2)
    for name, law in laws.items()
}
for name, run in runs.items():
    inside = (run.time > 12.0) & (run.time < 22.0)
    held = run.states[0, inside]
    print(f"{name:21s} in wind {held.mean():+.2f} m off, ± {held.std():.2f} m")

with rc_context(STYLE):
    figure = Figure(figsize=(1.35 * WIDTH, 4.6))
    upper, middle, lower = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 0.8))
    run = runs["predicts, knows wind"]
    upper.plot(run.time, run.measured[0], ".", color="0.75", markersize=2, label="camera")
    for colour, (name, one) in zip(COLOURS, runs.items(), strict=False):
        upper.plot(one.time, one.states[0], color=colour, label=name)
    upper.set(ylabel="position (m)", ylim=(-2.5, 2.5), title="From 1 m off; wind from 8 to 22 s")
    middle.plot(run.time, run.estimates[3], color=COLOURS[0], label="push, as estimated")
    pushed = np.where((run.time >= 8.0) & (run.time < 22.0), PUSH[1], 0.0)
    middle.plot(run.time, pushed, "--", color=COLOURS[6], label="push, without gusts")
    middle.set(ylabel="push (m/s²)")
    lower.step(run.time, run.mode, where="post", color=COLOURS[6], linewidth=1.0)
    lower.set_yticks((0, 1), ("calm", "wind"))
    lower.set(xlim=(0, 30), ylim=(-0.3, 1.3), xlabel="time (s)")
    figure.align_ylabels()
    figure.legend(loc="outside lower center", ncols=3)
figure.savefig("drone.png", dpi=110)
