"""A car cuts in: the follower brakes, and its own deceleration decides when the brake acts.

Plant and gains: `deadtime.problems.follower`. The rule is ours: what the engine alone cannot
slow, below −0.3 m/s², the brake does, with a shorter lag. What one learns: the mode a delay ahead
need not be guessed where the state decides it. The law that runs the rule forward leaves no
mismatch; others cost more here, though not from every start, since exact is not optimal.
"""

import numpy as np

import deadtime as dt
from deadtime.plotting import plot_run

problem = dt.problems.follower()
plant, gains = problem.plant, problem.gains
brake = dt.HalfSpace([0.0, 0.0, -1.0], offset=0.3)  # mode 1 where −acceleration ≥ 0.3 m/s²
laws = {
    "rule run forward": dt.StateDependentPredictor(plant, gains, brake),
    "averaged": dt.AveragedPredictor(plant, gains),
    "throttle only": dt.SingleModePredictor(plant, gains, 0),
    "delay ignored": dt.DelayedStateFeedback(plant, gains),
}
too_close = [-3.0, -1.5, 0.0]  # 3 m short of the gap, closing at 1.5 m/s
runs = {name: dt.simulate(plant, law, brake, too_close, 10.0) for name, law in laws.items()}
for name, run in runs.items():
    largest = np.abs(run.mismatch).max()
    print(f"{name:18s} cost {run.metrics()['cost']:6.1f}   max |w| {largest:8.2e} m/s²")

run = runs["rule run forward"]
print("switches at", ", ".join(f"{t:.6f} s" for t in run.signal.times[1:]))
figure = plot_run(run, "Braking by rule, predicted", problem.states, problem.modes)
figure.savefig("state_dependent.png")
