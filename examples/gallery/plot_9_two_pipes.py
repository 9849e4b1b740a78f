"""
Two pipes, two flows: a delay for every input and regime
========================================================

Two stirred tanks in series are warmed by two feeds, each mixed far away and piped to its tank. What
is ordered arrives when the pipe has been emptied, so each feed has a delay of its own, and half the
flow doubles both. What one learns: with the four delays a law needs no tuning; with one for all,
the cheapest choice leaves a regime that decays at a third of the rate.

**Source.** Delay of a pipe, volume over flow: D. E. Seborg, T. F. Edgar and D. A. Mellichamp,
*Process Dynamics and Control*, chapter 6. Feedback with a delay per input: D. Tsubakino, T. R.
Oliveira and M. Krstic, Automatica 2016. Ours are the tanks: of equal volume, with a reaction that
warms them by 0.6 and 0.7 /min per kelvin, the second feed half as strong as the first, pipes of 0.4
and 0.15 tank volumes; and flows, weights and sojourns. Time is in minutes.
"""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from scipy import stats

import deadtime as dt
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH

FLOWS, PIPES, STEP = np.array([1.0, 0.5]), np.array([0.4, 0.15]), 0.05  # 1/min, tanks, min

A = np.array([[[0.6 - q, 0.0], [q, 0.7 - 1.5 * q]] for q in FLOWS])
B = np.array([[[q, 0.0], [0.0, 0.5 * q]] for q in FLOWS])
delays = PIPES / FLOWS[:, None]  # a row per regime, a column per feed
plant = dt.SwitchedSystem(A, B, delays)
gains = dt.lqr(plant, 10.0 * np.eye(2), np.eye(2))
print(plant)

# %%
# One delay for all, or each its own
# ----------------------------------
#
# The plant has its four delays throughout; the law believes in them, or in a single one.

flow = dt.SemiMarkov(stats.expon(loc=2.0, scale=2.0))
single = np.linspace(0.15, 0.8, 14)
models = [plant, *(dt.SwitchedSystem(A, B, delay) for delay in single)]
laws = {str(i): dt.ExpectedPredictor(model, gains, flow) for i, model in enumerate(models)}
data = dt.monte_carlo(plant, laws, flow, [1.0, -1.0], 20.0, STEP, scenarios=400)
cost = data.cost.mean("scenario").values
slowest = [max(dt.growth_rate(plant, law, mode, STEP) for mode in (0, 1)) for law in laws.values()]
best = int(np.argmin(cost[1:])) + 1
print(f"own delays: mean cost {cost[0]:.2f}, slowest mode {slowest[0]:+.2f} /min")
print(
    f"the best single one, {single[best - 1]:.2f} min: mean cost {cost[best]:.2f}, "
    f"slowest mode {slowest[best]:+.2f} /min"
)

with rc_context(STYLE):
    figure = Figure(figsize=(WIDTH, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    for axes, values, label in (
        (left, cost / cost[0], "mean cost, relative"),
        (right, np.array(slowest), "growth, slowest regime (1/min)"),
    ):
        axes.plot(single, values[1:], ".-", color=COLOURS[1], label="one delay for all")
        axes.axhline(values[0], color=COLOURS[0], linestyle="--", label="each its own")
        axes.set(xlabel="the one delay (min)", ylabel=label)
    left.set_ylim(0.8, 2.4)
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=2)
figure.savefig("two-pipes.png", dpi=120)

# %%
# What holds for every signal
# ---------------------------
#
# Of the averaged law, which needs no model of the flow: the decay that is proved for every signal
# whose regimes last 0.25 min or more, with the four delays and with the single one that costs it
# the least; and how wrong the delays may be in a regime held. Sentences count times in seconds;
# here these are minutes.

for name, believed in (("own delays", delays), ("0.55 min", 0.55)):
    law = dt.AveragedPredictor(dt.SwitchedSystem(A, B, believed), gains)
    proof = dt.certify(plant, law, 0.25, STEP)
    print(f"{name}: {proof.message}")
    print(f"  Held in a regime, {dt.delay_margin(plant, law, STEP).message}.")

# %%
# A car whose brake is faster than its throttle
# ---------------------------------------------
#
# The follower of this gallery, its throttle late by 0.4 s and its brake by 0.1 s: one input, whose
# delay changes with the mode. Cost is the mean over 400 signals; the margin is by how much both
# true delays may be longer, in every mode held; the dwell time is the shortest with which the loop
# is proved stable. 0.05 s, a period, is the shortest that can be asked about. Taking the
# throttle's delay for both costs 2 % less than the true delays, and leaves a fourteenth of the
# margin.

car = dt.problems.follower()
late = dt.SwitchedSystem(car.plant.A, car.plant.B, [[0.4], [0.1]])
pedals = dt.SemiMarkov(stats.expon(loc=0.5, scale=1.0))
for name, believed in (
    ("own delays", late.delays),
    ("0.1 s", 0.1),
    ("0.25 s", 0.25),
    ("0.4 s", 0.4),
):
    law = dt.AveragedPredictor(dt.SwitchedSystem(late.A, late.B, believed), car.gains)
    runs = dt.monte_carlo(late, {"averaged": law}, pedals, car.x0, car.horizon, STEP, scenarios=400)
    throttle, brake = (dt.growth_rate(late, law, mode, STEP) for mode in (0, 1))
    margin = dt.delay_margin(late, law, STEP)
    dwell = dt.least_dwell_time(late, law, STEP, ratio=1.05).certified
    print(
        f"{name:10s} cost {runs.cost.mean().item():.2f}, throttle {throttle:+.2f}, "
        f"brake {brake:+.2f} 1/s, margin {margin.upper - margin.nominal:.3f} s, "
        f"certified from {dwell:.2f} s on"
    )
