"""
A car that follows: is prediction worth it?
===========================================

A car keeps its distance by throttle or by brake; the two answer with different lags, and both
late. What one learns: a delay of 0.2 s is no disaster for a law that ignores it, only dear. The
picture says where dear becomes unstable, and the certificate that the predictor is stable however
throttle and brake take turns, if each lasts for a second.

**Source.** Lag of the engine 0.5 s: R. Rajamani, *Vehicle Dynamics and Control*, 2nd edition,
Springer 2012. Lag of the brake 0.2 s: brake time constant of the Plexe engine model in SUMO (M.
Segata, 2015). Delay 0.2 s: J. Ploeg and others, IEEE ITSC 2011, identified on a passenger car.
Time gap 0.8 s: ISO 15622. Poles, dwell time and the signal are ours, as is which lag belongs to
which actuator; ``deadtime.problems.follower`` has the equations.
"""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import deadtime as dt
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH
from deadtime.simulation.run_figure import plot_run

problem = dt.problems.follower()
costs = {name: problem.simulate(name).metrics()["cost"] for name in problem.laws}
for name, cost in costs.items():
    print(f"{name:16s} cost {cost / costs['oracle']:.3f} times the oracle's")

run = problem.simulate("averaged")
figure = plot_run(run, "A metre too far: the averaged law", problem.states, problem.modes)
figure.savefig("follower.png", dpi=120)

# %%
# Is it safe for every signal?
# ----------------------------
#
# Throttle and brake may take turns in any way, as long as each lasts for a second; and the delay
# may be wrong by a quarter in either direction.

plant, averaged, step = problem.plant, problem.laws["averaged"], 0.05
for delays in ((0.15, 0.20), (0.20, 0.25)):
    certificate = dt.certify(
        plant, averaged, problem.dwell_time, step, delays=delays, decay_rate=0.0
    )
    print(certificate.message)

# %%
# From which delay on does prediction pay?
# ----------------------------------------
#
# The same car with other delays, every law with the true delay. Ignoring it ends where a
# mode that lasts begins to grow: from there on not cost is at stake, but stability.


def relative_cost(law, delay):
    """Cost over the oracle's, with another delay of the actuators."""
    late = dt.SwitchedSystem(plant.A, plant.B, delay)
    runs = [
        dt.simulate(late, kind(late, problem.gains), problem.signal, problem.x0, 10.0, step)
        for kind in (law, dt.ExactPredictor)
    ]
    return runs[0].metrics()["cost"] / runs[1].metrics()["cost"]


delays = np.linspace(0.0, 0.7, 15)[1:]
kinds = {"averaged": dt.AveragedPredictor, "delay ignored": dt.DelayedStateFeedback}
ratios = {name: [relative_cost(law, D) for D in delays] for name, law in kinds.items()}
limit = dt.delay_margin(plant, problem.laws["delay ignored"], step).upper
print(f"ignoring the delay is stable in either mode up to {limit:.3f} s")

with rc_context(STYLE):
    figure = Figure(figsize=(WIDTH, 3.2))
    axes = figure.subplots()
    for colour, (name, ratio) in zip(COLOURS, ratios.items(), strict=False):
        axes.plot(delays, ratio, ".-", color=colour, label=name)
    axes.axvline(plant.delay, color="0.5", linestyle="--", label="this car")
    axes.axvline(limit, color=COLOURS[1], linestyle=":", label="a mode begins to grow")
    axes.set(xlim=(0, 0.7), ylim=(0.9, 6), xlabel="delay (s)", ylabel="cost over the oracle's")
    figure.legend(loc="outside lower center", ncols=2)
figure.savefig("follower-delays.png", dpi=120)
