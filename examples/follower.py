"""A car that follows another by throttle or brake: is prediction worth it?

Sources: see `deadtime.problems.follower`. What one learns: with a delay that is short beside
the closed loop's time constants, ignoring it is not a disaster but costs half as much again.
"""

import deadtime as dt
from deadtime.plotting import plot_run

problem = dt.problems.follower()
costs = {name: problem.simulate(name).metrics()["cost"] for name in problem.laws}
for name, cost in costs.items():
    print(f"{name:16s} cost {cost / costs['oracle']:.3f} of the oracle's")

run = problem.simulate("averaged")
plot_run(run, "Follower, averaged law", problem.states, problem.modes).savefig("follower.png")
