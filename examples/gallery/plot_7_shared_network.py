"""
Two actuators, one network: the state schedules
===============================================

A reactor has two actuators, and one network that serves one of them at a time; the other gets
nothing. Who is served when a packet arrives is decided by the state at that time, not by the
sender. What one learns: where the state decides the mode, the future need not be guessed; the
rule can be run forward with the plant. And not every rule decides: along the boundary of some the
state slides, which the library follows and says.

**Source.** The chemical reactor of N. Munro: J. Kautsky, N. K. Nichols and P. Van Dooren, "Robust
pole assignment in linear state feedback", International Journal of Control 41 (1985), 1129–1155,
example 1; open-loop poles 1.99, 0.0635, −5.06, −8.67. A benchmark of networked control since G.
C. Walsh, H. Ye and L. G. Bushnell, "Stability analysis of networked control systems", IEEE
Transactions on Control Systems Technology 10 (2002), whose try-once-discard protocol serves the
larger need. Law: arXiv 2603.20027. Ours are the delay, the rule by which actuator 2 is served,
weights and initial state. The source gives no units; time is taken in seconds.
"""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import deadtime as dt
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH

REACTOR = np.array([
    [1.38, -0.2077, 6.715, -5.676],
    [-0.5814, -4.29, 0.0, 0.675],
    [1.067, 4.273, -6.654, 5.893],
    [0.048, 4.273, 1.343, -2.104],
])  # fmt: skip
ACTUATORS = np.array([[0.0, 0.0], [5.679, 0.0], [1.136, -3.146], [1.136, 0.0]])
DELAY, STEP = 0.2, 0.02  # s

# Mode 0 serves the first actuator, mode 1 the second.
B = np.stack([ACTUATORS * [1.0, 0.0], ACTUATORS * [0.0, 1.0]])
plant = dt.SwitchedSystem([REACTOR, REACTOR], B, DELAY)
gains = dt.lqr(plant, np.eye(4), np.eye(2))
poles = np.sort(np.linalg.eigvals(REACTOR))[::-1]
print("open-loop poles", ", ".join(f"{pole:.4g}" for pole in poles), "1/s")

# %%
# The rule, and laws that know it or not
# --------------------------------------
#
# The second actuator is served while x₁ − x₃ ≥ 0.2. A law that sees the mode only when it is
# there sends its packet to an actuator that may not be served when it arrives.

rule = dt.HalfSpace([1.0, 0.0, -1.0, 0.0], offset=0.2)
laws = {
    "rule run forward": dt.StateDependentPredictor(plant, gains, rule),
    "averaged": dt.AveragedPredictor(plant, gains),
    "delay ignored": dt.DelayedStateFeedback(plant, gains),
}
start = [1.0, 1.0, 0.0, 0.0]
runs = {name: dt.simulate(plant, law, rule, start, 6.0, STEP) for name, law in laws.items()}
for name, run in runs.items():
    print(f"{name:17s} cost {run.metrics()['cost']:8.3g}, {run.signal.switches} switches, "
          f"largest mismatch {np.abs(run.mismatch).max():.2g}")  # fmt: skip
exact = runs["rule run forward"]
print(
    "switches at", ", ".join(f"{time:.6f}" for time in exact.signal.times[1:]), "s, between samples"
)

with rc_context(STYLE):
    figure = Figure(figsize=(1.35 * WIDTH, 4.4))
    upper, middle, lower = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2.2, 1))
    for colour, (name, run) in zip(COLOURS, runs.items(), strict=False):
        upper.semilogy(run.time, np.linalg.norm(run.states, axis=0), color=colour, label=name)
        lower.step(run.time, run.mode, where="post", color=colour, linewidth=1.0)
    for i, style in enumerate(("-", "--")):
        middle.step(exact.time, exact.inputs[i], style, where="post", color=COLOURS[3 + i],
                    label=f"packet to actuator {i + 1}, rule run forward")  # fmt: skip
    upper.set(ylabel="|x|", ylim=(1e-3, 1e2), title="One network for two actuators")
    middle.set(ylabel="input")
    lower.set_yticks((0, 1), ("1 served", "2 served"))
    lower.set(xlim=(0, 4), ylim=(-0.3, 1.3), xlabel="time (s)")
    figure.align_ylabels()
    figure.legend(loc="outside lower center", ncols=2)
figure.savefig("shared-network.png", dpi=110)

# %%
# A rule that slides
# ------------------
#
# Serving whichever actuator is asked for more, in the manner of try-once-discard, without a
# minimum time of service: on the boundary either choice pushes the state back to it. Network and
# plant then follow the limit of ever faster switching, along the boundary; and so does the
# prediction, which knows no better than the rule itself whom the next packet will reach.

first, second = dt.lqr(dt.SwitchedSystem([REACTOR], [ACTUATORS], DELAY), np.eye(4), np.eye(2))[0]
less, more = first - second, first + second
larger = dt.Polyhedra(
    [
        ([-less, -more], [0, 0]),
        ([less, more], [0, 0]),
        ([-less, more], [0, 0]),
        ([less, -more], [0, 0]),
    ],
    modes=[0, 0, 1, 1],
)
for name, law in (
    ("rule run forward", dt.StateDependentPredictor(plant, gains, larger)),
    ("delay ignored", laws["delay ignored"]),
):
    run = dt.simulate(plant, law, larger, start, 6.0, STEP)
    print(f"{name}: cost {run.metrics()['cost']:.3g}; {run.message}")
