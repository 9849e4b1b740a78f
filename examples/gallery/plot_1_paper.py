"""
The paper's example
===================

Two unstable modes and a second of delay: the plant that the averaged predictor law was published
with. It works, as the paper shows, on a signal that switches often. What one learns: the loop it
makes is unstable in either mode alone, and a search finds no worse signal than to stop switching.

**Source.** A. Katsanikakis and N. Bekiaris-Liberis, arXiv 2503.08446 (2025), Section III. The
switching signal is ours (the paper prints none): of 201 random ones the one of median cost.
"""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import deadtime as dt
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH
from deadtime.reports import plot_norms

# %%
# Every law on one signal
# -----------------------
#
# ``paper()`` brings plant, gains, laws and the signal. The cost is the integral of ``|x|² + u²``.

problem = dt.problems.paper()
runs = {name: problem.simulate(name) for name in problem.laws}
for name, run in runs.items():
    figures = run.metrics()
    print(f"{name:14s} cost {figures['cost']:9.3g}   |x| at the end {figures['final_norm']:.2g}")

figure = plot_norms(runs, title="Every law on the same signal")
figure.savefig("paper-laws.png", dpi=120)

# %%
# When switching stops
# --------------------
#
# The law mixes the answers of two modes, and neither mode alone agrees with the mixture. The
# growth rates come from the spectrum of the loop; the runs confirm them.

law, step = problem.laws["averaged"], problem.step
rates = [dt.growth_rate(problem.plant, law, mode, step) for mode in (0, 1)]
held = [problem.hold(mode, horizon=30.0) for mode in (0, 1)]
for mode, (rate, run) in enumerate(zip(rates, held, strict=True)):
    measured = -run.metrics()["decay_rate"]
    print(f"mode {mode} held: growth {rate:+.3f} /s, in a run {measured:+.3f} /s")

worst = dt.falsify(problem.plant, law, problem.dwell_time, step=0.1)
print(f"worst of all signals that were tried ({worst.evaluated}): {worst.message}")

with rc_context(STYLE):
    figure = Figure(figsize=(1.3 * WIDTH, 2.9))
    axes = figure.subplots()
    switched = np.linalg.norm(runs["averaged"].states, axis=0)
    axes.semilogy(runs["averaged"].time, switched, color=COLOURS[0], label="switching at random")
    for mode, run in enumerate(held):
        label = f"mode {mode} held ({rates[mode]:+.2f} /s)"
        norm = np.linalg.norm(run.states, axis=0)
        axes.semilogy(run.time, norm, color=COLOURS[1 + mode], label=label)
    axes.set(xlim=(0, 30), xlabel="time (s)", ylabel="|x|", title="The averaged law, three futures")
    figure.legend(loc="outside lower center", ncols=3)
figure.savefig("paper-futures.png", dpi=110)
