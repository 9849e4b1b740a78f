"""Errors that a loop tolerates as a figure, and how many drawn plants every law stabilises."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from deadtime.base.errors import DeadtimeError
from deadtime.base.figure_files import new_figure
from deadtime.base.figure_style import COLOURS, LINES, STYLE, WIDTH, plain
from deadtime.base.wording import as_rate
from deadtime.margins import DrawnStability, Robustness, Tolerance, drawn_stability
from deadtime.plant import SwitchedSystem
from deadtime.problems import Problem
from deadtime.spectrum import growth_rate
from deadtime.spectrum.held_mode_checks import MOST, seconds_of

DRAWN_HEADINGS = ("law, each mode held", "stable plants", "largest growth, 1/s")


def drawn_of(problem: Problem, step: float, seed: int = 0) -> dict[str, DrawnStability]:
    """Of every law that has growth rates; nothing where the file has no [uncertainty]."""
    counts: dict[str, DrawnStability] = {}
    for name, law in problem.laws.items():
        if problem.uncertain is None or not law.is_linear:
            continue
        try:
            counts[name] = drawn_stability(problem.uncertain, law, step, seed=seed)
        except DeadtimeError:  # a law that has no rates at this period
            continue
    return counts


def drawn_rows(drawn: dict[str, DrawnStability]) -> list[tuple[str, ...]]:
    """Rows of the table, columns as in `DRAWN_HEADINGS`."""
    return [
        (name, f"{one.stable} of {len(one.growth)}", as_rate(float(one.growth.max())))
        for name, one in drawn.items()
    ]


def drawn_record(drawn: dict[str, DrawnStability]) -> dict[str, Any]:
    """Drawn plants and how many of them are stable, for JSON."""
    return {
        name: {"plants": len(one.growth), "stable": one.stable, "slowest": float(one.growth.max())}
        for name, one in drawn.items()
    }


GOOD, BAD = "#e3f0f8", COLOURS[1]
HEADINGS = (
    "delay error", "gain error", "noise", "lost samples", "late samples", "mode detection delay"
)  # fmt: skip
_RATE = "growth rate (1/s)"
_POINTS, _FEWEST = 41, 5
_LARGEST = 1e4  # cost, relative: beyond a run is drawn as lost


def plot_robustness(
    result: Robustness, title: str | None = None, modes: Sequence[str] | None = None
) -> Figure:
    """Growth rates over errors of delay and gain; costs over what was simulated.

    `modes` are names for the legend. Costs are relative to the loop as it is: the line is the
    median of the runs, the band their extremes, crosses are values at which runs were lost or did
    not settle. The tolerated range is shaded.
    """
    names = modes or [f"mode {i}" for i in range(result.plant.modes)]
    with rc_context(STYLE):
        figure = new_figure(1.55 * WIDTH, 4.9)
        panels = figure.subplots(2, 3)
        _delay_panel(panels[0, 0], result)
        _gain_panel(panels[0, 1], result)
        _noise_panel(panels[0, 2], result)
        _cost_panel(panels[1, 0], result.drops, "samples lost (%)", 100.0)
        _cost_panel(panels[1, 1], result.late, "samples late (periods)", 1.0)
        _cost_panel(panels[1, 2], result.lag, "delay (periods)", 1.0)
        for panel, heading in zip(panels.flat, HEADINGS, strict=True):
            panel.set_title(heading)
        keys = [Line2D([], [], color=COLOURS[i % 6], linestyle=LINES[i % len(LINES)],
                       label=plain(name)) for i, name in enumerate(names)]  # fmt: skip
        keys += [Patch(color=GOOD, label="tolerated")]
        keys += [Line2D([], [], color=BAD, marker="x", linestyle="", label="lost, or not settling")]
        figure.legend(handles=keys, loc="outside lower center", ncols=6)
        if result.weight is not None:
            title = "\n".join([*([title] if title else []), f"Cost: {result.weight.text}"])
        if title:
            figure.suptitle(plain(title), fontsize=9.5, x=0.02, ha="left")
    return figure


def _growth_curves(
    panel: Axes,
    result: Robustness,
    x: np.ndarray,
    plants: Sequence[SwitchedSystem],
    ends: Sequence[float | None],
) -> None:
    """The growth rate of every mode over x, a plant for each, and where none grows shaded."""
    for mode in range(result.plant.modes):
        rates = [growth_rate(plant, result.law, mode, result.step) for plant in plants]
        panel.plot(x, rates, color=COLOURS[mode % 6], linestyle=LINES[mode % len(LINES)])
    low, high = ends
    if low is not None and high is not None:
        _shade(panel, *np.clip([low, high], x[0], x[-1]))
    panel.axhline(0.0, color=COLOURS[6], linewidth=0.8)
    panel.set_ylabel(_RATE)


def _no_margin(panel: Axes, result: Robustness) -> None:
    panel.set_ylabel(_RATE)
    _nothing(panel, "left out: D/h is\ntoo large" if result.left_out else "the law is no table")


def _points(result: Robustness) -> int:
    """How many, fewer where each takes long."""
    each = seconds_of("growth rate", result.plant, result.law, result.step)
    return _POINTS if each == 0.0 else int(np.clip(2.0 * MOST / each, _FEWEST, _POINTS))


def _delay_panel(panel: Axes, result: Robustness) -> None:
    panel.set_xlabel("error of the delay (%)")
    if result.delay is None:
        _no_margin(panel, result)
        return
    plant, margin = result.plant, result.delay
    D, relative = margin.nominal, margin.relative
    reach = min(0.9, 0.1 if relative is None else 2.0 * min(relative, 0.4))
    errors = np.linspace(-reach, reach, _points(result))
    if margin.differ:
        panel.set_xlabel("error of all delays (s)")
        plants = [plant.like(plant.A, plant.B, plant.delays + e * D) for e in errors]
        ends = [None if end is None else end - D for end in (margin.lower, margin.upper)]
        _growth_curves(panel, result, errors * D, plants, ends)
        return
    plants = [plant.like(plant.A, plant.B, (1.0 + e) * plant.delays) for e in errors]
    ends = [
        None if end is None else 100.0 * (end / D - 1.0) for end in (margin.lower, margin.upper)
    ]
    _growth_curves(panel, result, 100.0 * errors, plants, ends)


def _gain_panel(panel: Axes, result: Robustness) -> None:
    panel.set_xlabel("gain, relative to the model")
    if result.gain is None:
        _no_margin(panel, result)
        return
    plant, margin = result.plant, result.gain
    low = 0.8 if margin.lower is None else max(0.05, 1.0 - 2.0 * (1.0 - margin.lower))
    high = 1.2 if margin.upper is None else 1.0 + 2.0 * (min(margin.upper, 3.0) - 1.0)
    factors = np.linspace(low, high, _points(result))
    plants = [plant.like(plant.A, k * plant.B) for k in factors]
    _growth_curves(panel, result, factors, plants, [margin.lower, margin.upper])


def _cost_panel(panel: Axes, tolerance: Tolerance | None, label: str, unit: float) -> None:
    panel.set_xlabel(label)
    panel.set_ylabel("cost, relative")
    if tolerance is None:
        _nothing(panel, "the law does not\nread the mode")
        return
    if tolerance.tolerated is None:
        _nothing(panel, "fails as it is")
        return
    base = float(np.median(tolerance.cost[0]))
    values, cost = unit * tolerance.values, np.minimum(tolerance.cost / base, _LARGEST)
    complete = ~tolerance.lost.any(axis=1)
    panel.fill_between(
        values[complete],
        cost[complete].min(axis=1),
        cost[complete].max(axis=1),
        color=COLOURS[0],
        alpha=0.25,
    )
    panel.plot(values[complete], np.median(cost[complete], axis=1), ".-", color=COLOURS[0])
    panel.set_yscale("log")
    panel.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    panel.yaxis.set_major_formatter("{x:g}")
    panel.yaxis.set_minor_locator(NullLocator())
    panel.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    for value in values[~complete]:
        panel.plot([value], [0.97], "x", color=BAD, transform=panel.get_xaxis_transform())
    if tolerance.tolerated is not None:
        _shade(panel, 0.0, unit * tolerance.tolerated)
    highest = float(cost[complete].max()) if complete.any() else 1.0
    panel.set_ylim(0.85 * float(min(1.0, cost[complete].min(initial=1.0))), 1.3 * max(1.6, highest))


def _noise_panel(panel: Axes, result: Robustness) -> None:
    panel.set_xlabel("std of measurement noise")
    panel.set_ylabel("cost, relative")
    noise = result.noise
    if not math.isfinite(noise.doubling):
        _nothing(panel, "could not be\ncomputed")
        return
    complete = np.isfinite(noise.cost).all(axis=1)  # runs may diverge at twice the noise
    std, cost = noise.std[complete], noise.cost[complete] / noise.base
    panel.vlines(std, cost.min(axis=1), cost.max(axis=1), color=COLOURS[0], alpha=0.5, linewidth=3)
    panel.plot(std, cost.mean(axis=1), ".", color=COLOURS[0])
    panel.xaxis.set_major_locator(MaxNLocator(3))
    panel.axvline(noise.doubling, color=COLOURS[6], linewidth=0.8, linestyle=":")
    panel.text(noise.doubling, 0.97, " doubled", transform=panel.get_xaxis_transform(), va="top",
               ha="right", rotation=90, fontsize=7.5)  # fmt: skip


def _shade(panel: Axes, low: float, high: float) -> None:
    panel.axvspan(low, high, color=GOOD, zorder=0)


def _nothing(panel: Axes, why: str) -> None:
    panel.text(0.5, 0.5, why, ha="center", va="center", transform=panel.transAxes, fontsize=8.5)
    panel.set_xticks([])
    panel.set_yticks([])
    panel.grid(False)
