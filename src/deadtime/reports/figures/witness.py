"""Figure of a witness: a switching signal along which the loop grows, and how it grows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deadtime.base.figure_files import new_figure
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH, plain, visible

if TYPE_CHECKING:
    from deadtime.certificates import WorstCase
    from deadtime.simulation import Trajectory

SHOWN = 3  # cycles of the signal in the strip
GROWTH = 1e3  # by which |x| should grow in the picture
MOST_SAMPLES = 200_000
MANY = 60  # waves of |x| of which only the peaks are drawn


def plot_witness(worst: WorstCase, title: str | None = None, modes: Sequence[str] = ()) -> Figure:
    """A signal that grows: |x| over many of its cycles, and a few cycles of the mode below.

    Parameters
    ----------
    worst : WorstCase
        Its growth rate sets how long it is run. Where |x| waves too often to be drawn, its
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
    inside = run.signal.times < end
    visited = run.signal.modes[inside]
    axes.step(
        np.append(run.signal.times[inside], end), np.append(visited, visited[-1]),
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
