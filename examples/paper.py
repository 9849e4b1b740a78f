"""The paper's example: every law on one signal, and what happens when switching stops.

Source: arXiv 2503.08446, Section III. What one learns: averaging the modes' predictors works on
this signal, yet the loop it makes is unstable in either mode alone.
"""

import deadtime as dt
from deadtime.plotting import plot_norms

problem = dt.problems.paper()
runs = {name: problem.simulate(name) for name in problem.laws}
for name, run in runs.items():
    print(
        f"{name:14s} cost {run.metrics()['cost']:9.3g}   |x(T)| {run.metrics()['final_norm']:.2g}"
    )

for mode in range(problem.plant.modes):
    growth = -problem.hold(mode, horizon=60.0).metrics()["decay_rate"]
    print(f"mode {mode} for ever under the averaged law: growth {growth:+.3f} /s")

plot_norms(runs, title="The paper's example under every law").savefig("paper.png")
