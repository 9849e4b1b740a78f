"""The figure of paper.md, into paper/figure.png: `python paper/figure.py`, about two minutes.

Left: what 10,000 random switching signals cost a car follower under four laws. Right: the growth
rate of its averaged law under every signal with a dwell time, proved and found, over the delay.
"""

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import deadtime as dt
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH

DELAYS = np.array([0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8])
STEP, DWELL = 0.1, 1.0
LAWS = ("averaged", "mean", "delay ignored", "oracle")


def costs(problem: dt.problems.Problem) -> dict[str, np.ndarray]:
    """Cost of each law on each signal, sorted."""
    laws, plant = problem.laws, problem.plant
    data = dt.monte_carlo(
        plant, {name: laws[name] for name in LAWS}, dt.Markov([[0.0, 0.5], [0.5, 0.0]]), problem.x0,
        problem.horizon, STEP, 10_000, seed=1,
    )  # fmt: skip
    return {name: np.sort(data.cost.sel(law=name).values) for name in LAWS}


def rates(problem: dt.problems.Problem) -> tuple[list[float], list[float]]:
    """Growth rates (1/s) over `DELAYS`: the lowest proved of every signal, and the worst found."""
    proved, found = [], []
    for delay in DELAYS:
        plant = dt.SwitchedSystem(problem.plant.A, problem.plant.B, delay)
        law = dt.AveragedPredictor(plant, problem.gains)
        found.append(dt.falsify(plant, law, DWELL, STEP).growth_rate)
        slow, fast = 0.0, -found[-1]  # decay rates: proved, and not to be proved
        for _ in range(6):
            asked = 0.5 * (slow + fast)
            stable = dt.certify(plant, law, DWELL, STEP, decay_rate=asked).stable
            slow, fast = (asked, fast) if stable else (slow, asked)
        proved.append(-slow)
    return proved, found


def main() -> None:
    problem = dt.problems.follower()
    with rc_context(STYLE):
        figure = Figure(figsize=(2.0 * WIDTH, 3.0), layout="constrained")
        left, right = figure.subplots(1, 2)
        for (name, cost), colour in zip(costs(problem).items(), COLOURS, strict=False):
            left.semilogx(cost, np.linspace(0.0, 1.0, len(cost)), color=colour, label=name)
        left.set_xticks([2, 3, 5, 10, 20], ["2", "3", "5", "10", "20"], minor=False)
        left.minorticks_off()
        left.set(xlabel="cost ∫|x|² + |u|² dt", ylabel="share of signals")
        left.legend()
        proved, found = rates(problem)
        right.plot(DELAYS, proved, "o-", color=COLOURS[0], label="proved for every signal")
        right.plot(DELAYS, found, "x--", color=COLOURS[1], label="worst signal found")
        right.axhline(0.0, color="0.6", linewidth=0.8)
        right.set(xlabel="delay (s)", ylabel="growth rate (1/s)")
        right.legend()
        figure.savefig(Path(__file__).with_name("figure.png"), dpi=200)


if __name__ == "__main__":
    main()
