"""
Three modes: what is a forecast worth?
======================================

Three unstable modes that stay for 0.9 s at least, and a second of delay: whoever computes the
input does not know the mode in which it will arrive. What one learns: the laws differ in nothing
but what they believe about that mode, and their errors shrink with every bit of knowledge: a
dwell time, the statistics of the sojourns, the future itself.

**Source.** A. Katsanikakis and N. Bekiaris-Liberis, arXiv 2506.03908 (2025), simulation section:
matrices, delay and dwell time. Initial state, horizon and sojourns are ours: 0.9 s plus an
exponential time of mean 0.9 s.
"""

from matplotlib import rc_context
from matplotlib.figure import Figure
from scipy import stats

import deadtime as dt
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH
from deadtime.reports import plot_monte_carlo

problem = dt.problems.three_mode()
plant, gains = problem.plant, problem.gains
sojourn = stats.expon(loc=problem.dwell_time, scale=0.9)
laws = {
    "nothing (averaged)": problem.laws["averaged"],
    "the dwell time": dt.AveragedPredictor(plant, gains, dwell_time=problem.dwell_time),
    "the statistics": dt.ExpectedPredictor(plant, gains, dt.SemiMarkov(sojourn, modes=3)),
    "the future (oracle)": problem.laws["oracle"],
}

# %%
# The error of a forecast
# -----------------------
#
# w(t) = u(t) − K x(t + D), K being the gain of the mode that turns out to be active at t + D:
# what a law asks for, less what it would have asked for had it known. The oracle's is zero.

step, horizon = 0.02, problem.horizon
runs = {
    name: dt.simulate(plant, law, problem.signal, problem.x0, horizon, step)
    for name, law in laws.items()
}
with rc_context(STYLE):
    figure = Figure(figsize=(1.3 * WIDTH, 3.6))
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    for colour, (name, run) in zip(COLOURS, runs.items(), strict=False):
        upper.plot(run.time, run.mismatch[0], color=colour, label=name)
    upper.set(ylabel="mismatch w", title="What the law knows, and its error")
    lower.step(run.time, run.mode, where="post", color=COLOURS[6], linewidth=1.0)
    lower.set(xlim=(0, horizon), yticks=(0, 1, 2), ylabel="mode", xlabel="time (s)")
    figure.align_ylabels()
    figure.legend(loc="outside lower center", ncols=4)
figure.savefig("three-modes-mismatch.png", dpi=110)

# %%
# One signal proves little: 200 of them
# -------------------------------------

model = dt.SemiMarkov(sojourn, modes=3)
data = dt.monte_carlo(plant, laws, model, problem.x0, horizon, step, scenarios=200, seed=1)
for name in laws:
    cost = data.cost.sel(law=name)
    print(f"knows {name:20s} median cost {float(cost.median()):8.0f}")

figure = plot_monte_carlo(data, "Cost by what the law knows, 200 signals")
figure.savefig("three-modes-costs.png", dpi=110)
