"""Figures of certificates: charts of margins, and signals along which a loop grows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from deadtime.base.figure_files import new_figure
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH, plain, visible
from deadtime.base.wording import rounded

if TYPE_CHECKING:
    from deadtime.certificates import WorstCase
    from deadtime.margins import StabilityChart
    from deadtime.simulation import Trajectory


GOOD, BAD, GAP = "#9ccbe8", "#f3c3a3", "#ffffff"
CHART_WORDS = {GOOD: "stable for every signal", GAP: "no answer", BAD: "a signal grows"}
CHART_STYLE = {**STYLE, "hatch.linewidth": 0.6, "axes.grid": False}


def plot_chart(chart: StabilityChart, label: str, columns: int = 2) -> Figure:
    """A stability chart: a panel per law, a column per dwell time.

    From below: certified for every admissible signal (filled), no answer (white), and above the
    value at which some admissible signal grows (hatched). The number is the certified value.

    Parameters
    ----------
    chart : StabilityChart
    label : str
        What the value is, with its unit, for the axis.
    columns : int
        Panels beside each other.
    """
    names = list(chart.margins)
    columns = min(columns, len(names))
    rows = -(-len(names) // columns)
    low, high = chart.bounds
    with rc_context(CHART_STYLE):
        figure = new_figure(1.35 * WIDTH if columns > 1 else WIDTH, 0.9 + 2.0 * rows)
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for panel, name in zip(panels.flat, names, strict=False):
            _chart_panel(panel, chart, name)
            panel.set_title(plain(name))
        for spare in panels.flat[len(names) :]:
            spare.set_axis_off()
        panels[0, 0].set_ylim(low, high)
        for panel in panels[:, 0]:
            panel.set_ylabel(plain(label))
        times = [f"{time:g}" for time in chart.dwell_times]
        for i, panel in enumerate(panels.flat[: len(names)]):
            panel.set_xticks(range(len(times)), times)
            if i + columns >= len(names):
                panel.set_xlabel("dwell time (s)")
                panel.xaxis.set_tick_params(labelbottom=True)
        keys = [
            Patch(facecolor=GOOD, label=CHART_WORDS[GOOD]),
            Patch(facecolor=GAP, edgecolor="#888888", lw=0.5, label=CHART_WORDS[GAP]),
            Patch(fc=BAD, ec=COLOURS[1], hatch="////", lw=0.0, label=CHART_WORDS[BAD]),
        ]
        figure.legend(handles=keys, loc="outside lower center", ncols=3, handlelength=1.6)
    return figure


def _chart_panel(panel: Axes, chart: StabilityChart, name: str) -> None:
    low, high = chart.bounds
    sides = zip(chart.certified(name), chart.refuted(name), strict=True)
    for i, (certified, refuted) in enumerate(sides):
        if np.isnan(certified):
            panel.text(
                i, 0.5 * (low + high), CHART_WORDS[GAP], rotation=90, ha="center", va="center",
                fontsize=7.5, color="#666666",
            )  # fmt: skip
            continue
        panel.bar(i, certified - low, 0.94, bottom=low, color=GOOD, linewidth=0.0)
        if not np.isnan(refuted):
            panel.bar(
                i, high - refuted, 0.94, bottom=refuted, color=BAD, edgecolor=COLOURS[1],
                hatch="////", linewidth=0.0,
            )  # fmt: skip
        inside = certified - low > 0.09 * (high - low)
        panel.annotate(
            rounded(certified), (i, certified), (0.0, -2.0 if inside else 2.0),
            textcoords="offset points", ha="center", va="top" if inside else "bottom",
            fontsize=7.5, color="#1b1f24",
        )  # fmt: skip


SHOWN = 3  # cycles of the signal in the strip
GROWTH = 1e3  # by which |x| should grow in the picture
MOST_SAMPLES = 200_000
MANY = 60  # waves of |x| of which only the peaks are drawn


def plot_witness(worst: WorstCase, title: str | None = None, modes: Sequence[str] = ()) -> Figure:
    """A signal under which the loop grows: the norm of the state, and the mode below.

    Parameters
    ----------
    worst : WorstCase
        Its growth rate sets how long it is run. Where :math:`|x|` waves too often to be drawn, its
        peaks are.
    title : str, optional
    modes : sequence of str
        Names of the modes, numbered by default.
    """
    run = worst.simulate(_cycles(worst))
    names = list(modes) or [f"mode {i}" for i in range(run.plant.modes)]
    with rc_context(STYLE):
        figure = new_figure(WIDTH, 3.5 + 0.2 * len(names))
        upper, lower = figure.subplots(2, 1, height_ratios=(3.0, 0.5 + 0.25 * len(names)))
        _draw_growth(upper, run, worst.growth_rate)
        _draw_signal(lower, run, worst)
        lower.set_yticks(range(len(names)), list(map(plain, names)))
        lower.set_ylim(-0.35, len(names) - 0.65)
        figure.align_ylabels()
        figure.legend(loc="outside lower center", ncols=2)
        if title:
            upper.set_title(plain(title))
    return figure


def _draw_growth(axes: Axes, run: Trajectory, rate: float) -> None:
    """|x| and the line that it follows in the end."""
    time, norm, label = run.time, visible(np.linalg.norm(run.states, axis=0)), "|x|"
    inner = norm[1:-1]
    peaks = 1 + np.flatnonzero((inner >= norm[:-2]) & (inner > norm[2:]))
    if peaks.size > MANY:
        time, norm, label = time[peaks], norm[peaks], "peaks of |x|"
    late = time >= 0.5 * time[-1]
    offset = np.mean(np.log(norm[late]) - rate * time[late])
    axes.semilogy(time, norm, color=COLOURS[0], linewidth=1.3, label=label)
    text = f"growth {rate:+.3g} /s".replace("-", "−")
    axes.semilogy(time, np.exp(offset + rate * time), "--", color=COLOURS[1], label=text)
    if norm.max() < 30.0 * norm.min():
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("{x:g}")
    axes.set_xlim(run.time[0], run.time[-1])
    axes.set_xlabel("time (s)")
    axes.set_ylabel("|x|")


def _draw_signal(axes: Axes, run: Trajectory, worst: WorstCase) -> None:
    """The mode over the first cycles; all of it where it is constant."""
    constant, end = len(worst.modes) == 1, float(run.time[-1])
    end = end if constant else min(SHOWN * worst.length, end)
    early = run.signal.times < end
    visited = run.signal.modes[early]
    axes.step(
        np.append(run.signal.times[early], end), np.append(visited, visited[-1]),
        where="post", color=COLOURS[6], linewidth=1.2,
    )  # fmt: skip
    axes.set_xlim(0.0, end)
    axes.grid(False)
    label = "the signal" if constant else f"the first {SHOWN} cycles of the signal"
    axes.set_xlabel(f"{label}, time (s)")


def _cycles(worst: WorstCase) -> int:
    """How many cycles to run for |x| to grow visibly, within reason."""
    if worst.growth_rate <= 0.0:
        return 10 * SHOWN
    wanted = np.log(GROWTH) / (worst.growth_rate * worst.length)
    most = max(2 * SHOWN, MOST_SAMPLES * worst.step / worst.length)
    return int(np.clip(wanted, 2 * SHOWN, most)) + 1
