"""How far does each certificate reach on the paper's plant?

    python benchmarks/reach.py docs/images/certificates-reach.png

The distance ε between modes and gains, equation (5), up to which the theorem (printed, corrected,
sharp) and the lifted certificate prove the averaged law stable, and from which a signal grows, as
the modes are moved along their own difference, A_0 + α(A_i − A_0), with gains placed for each α;
τ_d = 0.2 s, period 0.01 s. Prints a table, and draws it where a file is named.
"""

from __future__ import annotations

import math
import sys
from itertools import pairwise

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import deadtime as dt
from deadtime.base.figure_files import new_figure
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH
from deadtime.base.wording import amount
from deadtime.certificates import theorem_bound

DWELL_TIME, STEP, POLES = 0.2, 0.01, (-1.0, -2.0)
TINY = 1e-6  # below this α everything is linear in α
ROUNDS = 6  # of the fixed point; it converges in two or three
PLANT = dt.problems.paper().plant


def reach_of(form: str) -> float:
    """log₁₀ of the ε at which ε(α) = ε*(α) for a form of the theorem, by a fixed point in α."""
    alpha, reach = TINY, 0.0
    for _ in range(ROUNDS):
        alpha = min(max(alpha, TINY), 1.0)
        plant = PLANT.apart(alpha)
        bound = theorem_bound(plant, dt.place(plant, POLES), DWELL_TIME, form=form)
        reach = bound.log10_epsilon_star
        alpha *= 10.0 ** (reach - math.log10(bound.epsilon))
    return reach


def distance(alpha: float) -> float:
    """ε of the paper's plant with its modes α times as far apart."""
    plant = PLANT.apart(alpha)
    return theorem_bound(plant, dt.place(plant, POLES), DWELL_TIME).epsilon


def reaches() -> dict[str, float]:
    """log₁₀ of ε by certificate; the last is that of the signal that grows."""
    names = {"theorem as printed": "printed", "corrected": "corrected", "sharp": "sharp"}

    def loop(alpha: float) -> tuple[dt.SwitchedSystem, dt.Law]:
        plant = PLANT.apart(alpha)
        return plant, dt.AveragedPredictor(plant, dt.place(plant, POLES))

    margin = dt.stability_margin(loop, (0.01, 8.0), DWELL_TIME, STEP, ratio=1.001)
    assert margin.refuted is not None
    found = {name: reach_of(form) for name, form in names.items()}
    found["lifted loop, proved"] = math.log10(distance(margin.certified))
    found["a signal that grows"] = math.log10(distance(margin.refuted))
    return found


def draw(found: dict[str, float]) -> Figure:
    """Every reach on a logarithmic axis, with the factor between two steps."""
    logs, own, last = list(found.values()), math.log10(distance(1.0)), len(found) - 1
    with rc_context(STYLE):
        figure = new_figure(WIDTH, 1.15 + 0.38 * len(logs))
        axes = figure.subplots()
        axes.axvline(own, color="#888888", linewidth=0.9, linestyle="--")
        axes.text(own, -0.62, "this plant ", ha="right", va="center", fontsize=8.0, color="#555555")
        left, right = min(logs) - 0.8, own + 4.0
        axes.hlines(range(last), left, logs[:-1], color=COLOURS[0], linewidth=3.0)
        for row, end in enumerate(logs):
            axes.plot(end, row, "oX"[row == last], color=COLOURS[int(row == last)])
            value = f"{10.0**end:#.4g}" if end > -3.0 else amount(10.0**end)
            axes.annotate(
                value, (end, row), (6.0, 0.0), textcoords="offset points", va="center",
                fontsize=8.5, bbox={"facecolor": "white", "linewidth": 0.0, "pad": 1.0},
            )  # fmt: skip
        for row, (one, two) in enumerate(pairwise(logs[:-1])):
            if two - one > 0.05:
                gain = f"× {amount(10.0 ** (two - one))}"
                axes.text(
                    0.5 * (one + two), row + 0.5, gain, ha="center", va="center", fontsize=8.0,
                    color="#555555",
                )  # fmt: skip
        ticks = np.arange(3 * math.ceil(left / 3), right, 3)
        axes.set_xticks(ticks, [f"$10^{{{tick:.0f}}}$" for tick in ticks])
        axes.set_yticks(range(len(logs)), found)
        axes.set(xlim=(left, right), ylim=(last + 0.6, -0.9))
        axes.set_xlabel("distance ε between modes and gains")
        axes.grid(False, axis="y")
    return figure


def main() -> None:
    """Print the table; draw it into the file that is named."""
    found = reaches()
    print("| certificate | ε |\n|---|---|")
    for name, log in found.items():
        print(f"| {name} | {10.0**log:.4g} |", flush=True)
    if len(sys.argv) > 1:
        draw(found).savefig(sys.argv[1], dpi=180)


if __name__ == "__main__":
    main()
