"""
What a wider delay margin costs
===============================

How wide can it be at all, and at what cost?

The law of the paper's example, designed for cost alone, is lost when the delay is about 1 % off.
What one learns: gains alone bring that to 2 % for half as much cost again; near what small gain
promises for some linear controller the cost has no bound; the averaged law pays dearly for not
knowing the mode; and the follower, whose plant has no unstable pole, has margin to spare.
"""

import deadtime as dt
from deadtime.reports import plot_designs

BUDGET = 150  # of designs to try; a few times as many find a little more

paper, follower = dt.problems.paper().plant, dt.problems.follower()
designs = {}
for mode in range(paper.modes):
    alone = dt.SwitchedSystem(paper.A[[mode]], paper.B[[mode]], paper.delay)
    designs[f"paper, mode {mode}"] = dt.design(alone, delay_margin=0.03, budget=BUDGET)
designs["paper, both modes, averaged"] = dt.design(paper, delay_margin=0.005, budget=BUDGET)
designs["follower, averaged"] = dt.design(
    follower.plant, delay_margin=0.05, gains=follower.gains, budget=BUDGET
)
for title, design in designs.items():
    print(f"{title}: {design.message}")

plot_designs(designs).savefig("design.png")
