"""
A teleoperated robot joint that picks up loads
==============================================

The elbow of a robot is held upright by somebody an ocean away, and the gripper now and then holds
a load. Gravity tips the forearm over, faster with a load. What one learns: how heavy a load may
be is a question with two answers that meet, a proof below and a signal that grows above; and the
heavier the load, the more it matters to see it.

**Source.** Elbow (joint 3) and wrist of the PUMA 560: P. Corke and B. Armstrong-Hélouvry, "A
search for consensus among model parameters reported for the PUMA 560 robot", IEEE ICRA 1994, in
the values of Corke's Robotics Toolbox (``Puma560.py``). Delay: J. Marescaux and others operated
from New York in Strasbourg with 155 ms (Annals of Surgery 235, 2002, 487–492; Nature 413, 2001,
DOI 10.1038/35096636) and held up to 330 ms to be safe (Scientific American on the Nature paper),
which we take. Ours are the upright posture, wrist and load as points at the wrist's distance and
at 0.45 m, friction without its Coulomb part, the poles, and a dwell time of 0.5 s.
"""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import deadtime as dt
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH

DELAY, DWELL_TIME, STEP = 0.33, 0.5, 0.03  # s
GRAVITY = 9.81  # m/s²
GEAR, MOTOR_INERTIA, MOTOR_FRICTION = 53.7063, 200e-6, 1.38e-3  # -, kg m², N m s (at the motor)
FOREARM_MASS, FOREARM_CENTRE, FOREARM_INERTIA = 4.8, 0.070, 0.086  # kg, m, kg m² (at the centre)
WRIST_MASS, WRIST_DISTANCE = 0.82 + 0.34 + 0.09, 0.4318  # kg, m
LOAD_DISTANCE = 0.45  # m


def constants(load):
    """Inertia (kg m²), friction (N m s) and moment of gravity (N m) at the joint."""
    inertia = GEAR**2 * MOTOR_INERTIA + FOREARM_INERTIA + FOREARM_MASS * FOREARM_CENTRE**2
    inertia += WRIST_MASS * WRIST_DISTANCE**2 + load * LOAD_DISTANCE**2
    moment = FOREARM_MASS * FOREARM_CENTRE + WRIST_MASS * WRIST_DISTANCE + load * LOAD_DISTANCE
    return inertia, GEAR**2 * MOTOR_FRICTION, GRAVITY * moment


def acceleration(load, angle, speed, torque):
    """Of the forearm, in rad/s², at an angle from upright."""
    inertia, friction, moment = constants(load)
    return (moment * np.sin(angle) - friction * speed + torque) / inertia


def joint(load):
    """Angle and speed, linearised upright, without and with a load of so many kg."""
    A, B = [], []
    for held in (0.0, load):
        inertia, friction, moment = constants(held)
        A.append([[0.0, 1.0], [moment / inertia, -friction / inertia]])
        B.append([[0.0], [1.0 / inertia]])
    return dt.SwitchedSystem(A, B, DELAY)


def averaged(load):
    """The joint and a law that does not look at the gripper."""
    plant = joint(load)
    return plant, dt.AveragedPredictor(plant, dt.place(plant, [-3.0, -5.0]))


# %%
# Without prediction it falls, empty or loaded
# --------------------------------------------

plant, law = averaged(2.0)
for name, pole in zip(("empty", "2 kg"), np.linalg.eigvals(plant.A).max(axis=1), strict=True):
    print(f"{name}: falls like e^({pole:.2f} t)")
ignored = dt.DelayedStateFeedback(plant, law.gains)
for name, one in (("averaged", law), ("delay ignored", ignored)):
    rates = [dt.growth_rate(plant, one, mode, STEP) for mode in (0, 1)]
    print(f"{name:14s} growth {rates[0]:+.2f} /s empty, {rates[1]:+.2f} /s loaded")

# %%
# How heavy may the load be?
# --------------------------
#
# Every signal counts that leaves gripper or load alone for half a second. The answer is a
# bracket: at its lower end a proof, at its upper end a signal under which the arm is lost.

margin = dt.stability_margin(averaged, (0.5, 20.0), DWELL_TIME, STEP, ratio=1.02)
print(f"load in kg: {margin.message}")
print(f"the signal that grows: {margin.witness.message}")

# %%
# A law that sees the gripper
# ---------------------------
#
# The operator sees whether the gripper holds something. The expected law uses that, with a guess
# of how long it will stay so: each state for two seconds on average. Averaged and blind, the loop
# is lost at 4 kg; the same gains with the mode measured hold the arm on the signal below.

model = dt.Markov([[0.0, 0.5], [0.5, 0.0]])


def seeing(load):
    """The joint and a law that reads the mode."""
    plant, law = averaged(load)
    return plant, dt.ExpectedPredictor(plant, law.gains, model)


loads = np.linspace(0.25, 6.0, 13)
kinds = {"averaged": averaged, "expected": seeing}
with rc_context(STYLE):
    figure = Figure(figsize=(WIDTH, 3.2))
    axes = figure.subplots()
    for colour, (name, kind) in zip(COLOURS, kinds.items(), strict=False):
        for mode, style in ((0, "--"), (1, "-")):
            rate = [dt.growth_rate(*kind(load), mode, STEP) for load in loads]
            label = f"{name}, {('empty', 'loaded')[mode]}"
            axes.plot(loads, rate, style, color=colour, label=label)
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    axes.axvline(margin.certified, color="0.4", linestyle=":")
    proved = f"averaged law: at {margin.certified:.2f} kg\nproved for every signal"
    axes.text(margin.certified - 0.1, 1.1, proved, ha="right", fontsize=8)
    axes.set(xlim=(0, 6), ylim=(-5, 2), xlabel="load (kg)", ylabel="growth (1/s)")
    axes.set_title("Growth in a mode that lasts")
    figure.legend(loc="outside lower center", ncols=2)
figure.savefig("robot-joint-loads.png", dpi=120)

# %%
# Four kilograms
# --------------

heavy = joint(4.0)
signal = dt.SwitchingSignal.random(2, 20.0, dwell_time=DWELL_TIME, mean_sojourn=2.0, seed=4)
with rc_context(STYLE):
    figure = Figure(figsize=(WIDTH, 3.2))
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    for colour, (name, kind) in zip(COLOURS, kinds.items(), strict=False):
        run = dt.simulate(heavy, kind(4.0)[1], signal, [np.radians(5.0), 0.0], 12.0, STEP)
        print(f"4 kg, {name}: largest angle {np.degrees(np.abs(run.states[0]).max()):.3g}°")
        upper.plot(run.time, np.degrees(run.states[0]), color=colour, label=name)
    upper.set(ylim=(-40, 40), ylabel="angle (°)", title="4 kg, from 5° off upright")
    lower.step(run.time, run.mode, where="post", color=COLOURS[6], linewidth=1.0)
    lower.set_yticks((0, 1), ("empty", "loaded"))
    lower.set(xlim=(0, 12), ylim=(-0.3, 1.3), xlabel="time (s)")
    figure.legend(loc="outside lower center", ncols=2)
figure.savefig("robot-joint.png", dpi=120)
