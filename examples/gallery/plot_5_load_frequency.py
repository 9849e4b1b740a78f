"""
Load-frequency control over a slow network
==========================================

Two areas of a power grid are joined by a tie line that trips and recloses. A control centre sends
its commands every two seconds, and they arrive five seconds late. What one learns: gains for a
controller that works every two seconds must be designed for these two seconds; ignoring the delay
swings the grid; and knowing the state of the line makes the loop decay faster, but does not make
it suffer less from a load that no law knows of.

**Source.** H. Saadat, *Power System Analysis*, McGraw-Hill 1999, example 12.4: two areas, their
governors and turbines, the tie line P₁₂ = P_s ∫ (Δω₁ − Δω₂) dt with P_s = 2 in the book's
scaling, and a load step of 187.5 MW, after which, with governors alone, the frequency settles at
59.7 Hz and the tie line carries −84.5 MW. Ours are the line's tripping (in for 30 s, out for 15 s
on average), the five seconds, and the weights.
"""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import deadtime as dt
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH
from deadtime.imperfections import StepDisturbance

BASE, NOMINAL = 1000.0, 60.0  # MW, Hz; all else is per unit of these, and seconds
INERTIA, DAMPING, DROOP = (5.0, 4.0), (0.6, 0.9), (0.05, 0.0625)
GOVERNOR, TURBINE, TIE = (0.2, 0.3), (0.5, 0.6), 2.0
DELAY, PERIOD, LOAD = 5.0, 2.0, 0.1875


def grid(tie):
    """A and B of (∫ω₁, ∫ω₂, ω₁, ω₂, P_m1, P_m2, P_v1, P_v2): turbines m, valves v."""
    A, B = np.zeros((8, 8)), np.zeros((8, 2))
    for i, other in ((0, 1), (1, 0)):
        angle, speed, turbine, valve = i, 2 + i, 4 + i, 6 + i
        A[angle, speed] = 1.0
        A[speed, [angle, other]] = -tie / (2 * INERTIA[i]), tie / (2 * INERTIA[i])
        A[speed, [speed, turbine]] = -DAMPING[i] / (2 * INERTIA[i]), 1 / (2 * INERTIA[i])
        A[turbine, [turbine, valve]] = -1 / TURBINE[i], 1 / TURBINE[i]
        A[valve, [valve, speed]] = -1 / GOVERNOR[i], -1 / (DROOP[i] * GOVERNOR[i])
        B[valve, i] = 1 / GOVERNOR[i]
    return A, B


A, B = map(np.stack, zip(grid(TIE), grid(0.0), strict=True))
plant = dt.SwitchedSystem(A, B, DELAY)
load = StepDisturbance([0, 0, -LOAD / (2 * INERTIA[0]), 0, 0, 0, 0, 0])

# %%
# Governors alone
# ---------------
#
# The check against the book: 59.7 Hz and −84.5 MW.

idle = dt.DelayedStateFeedback(plant, np.zeros((2, 2, 8)), allow_unstable=True)
always = dt.SwitchingSignal.constant(0)
run = dt.simulate(plant, idle, always, np.zeros(8), 60.0, PERIOD, imperfections=[load])
frequency = NOMINAL * (1 + run.states[2, -1])
tie_power = BASE * TIE * (run.states[0, -1] - run.states[1, -1])
print(f"after a minute {frequency:.2f} Hz, tie line {tie_power:.1f} MW")

# %%
# Two seconds are long
# --------------------
#
# The integrals of the frequencies are states, so their feedback is integral action. The same
# weights give two designs: for a law that is updated continuously, and for one that is updated
# every two seconds. Both are run every two seconds, with a delay of two and a half periods.

weights = np.diag([100.0, 100.0, 100.0, 100.0, 0, 0, 0, 0]), np.eye(2)
continuous, sampled = dt.lqr(plant, *weights), dt.lqr(plant, *weights, step=PERIOD)
model = dt.Markov([[0.0, 1 / 30.0], [1 / 15.0, 0.0]])


def laws(gains):
    """What is compared."""
    return {
        "expected": dt.ExpectedPredictor(plant, gains, model, allow_unstable=True),
        "averaged": dt.AveragedPredictor(plant, gains, allow_unstable=True),
        "delay ignored": dt.DelayedStateFeedback(plant, gains, allow_unstable=True),
    }


for title, gains in (("continuous time", continuous), ("the period", sampled)):
    for name, law in laws(gains).items():
        rates = [dt.growth_rate(plant, law, mode, PERIOD) for mode in (0, 1)]
        print(f"designed for {title:15s} {name:13s} growth {rates[0]:+.3f}, {rates[1]:+.3f} /s")

# %%
# A load step, and a line that trips
# ----------------------------------

signal, times = model.sample(200.0, seed=3), np.linspace(0.0, 120.0, 1201)
runs = {
    name: dt.simulate(
        plant, law, signal, np.zeros(8), 120.0, PERIOD, times=times, imperfections=[load]
    )
    for name, law in laws(sampled).items()
}
with rc_context(STYLE):
    figure = Figure(figsize=(1.35 * WIDTH, 4.6))
    upper, middle, lower = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2.4, 0.8))
    for colour, (name, run) in zip(COLOURS, runs.items(), strict=False):
        upper.plot(times, NOMINAL * run.states[2], color=colour, label=name)
        flow = BASE * TIE * (run.states[0] - run.states[1]) * (run.mode == 0)
        middle.plot(times, flow, color=colour)
    upper.set(ylabel="Δf in area 1 (Hz)", title="187.5 MW more load in area 1 at time 0")
    middle.set(ylabel="tie line (MW)")
    lower.step(times, run.mode, where="post", color=COLOURS[6], linewidth=1.0)
    lower.set_yticks((0, 1), ("line in", "line out"))
    lower.set(xlim=(0, 120), ylim=(-0.3, 1.3), xlabel="time (s)")
    figure.align_ylabels()
    figure.legend(loc="outside lower center", ncols=3)
figure.savefig("load-frequency.png", dpi=110)

# %%
# Is it one lucky signal?
# -----------------------
#
# The same step on twenty histories of the line: how far the frequency of area 1 is off between 20
# and 120 s.

late = times >= 20.0
compared = laws(sampled)
errors = {name: [] for name in compared}
for seed in range(20):
    signal = model.sample(200.0, seed=100 + seed)
    for name, law in compared.items():
        run = dt.simulate(
            plant, law, signal, np.zeros(8), 120.0, PERIOD, times=times, imperfections=[load]
        )
        errors[name].append(NOMINAL * np.sqrt(np.mean(run.states[2, late] ** 2)))
for name, error in errors.items():
    print(
        f"{name:13s} median {1e3 * np.median(error):.0f} mHz, worst {1e3 * np.max(error):.0f} mHz"
    )
