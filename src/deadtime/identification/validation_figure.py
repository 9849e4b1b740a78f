"""Figures of predictions beside a log that was measured, and of their errors."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Protocol

import numpy as np

from deadtime.base.figure_files import new_figure
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FAR = 1.0  # of a log's range beyond it: predictions that leave this are cut


class Drawn(Protocol):
    """Outputs (sample, p) of a part: measured, run freely, and a row ahead."""

    @property
    def time(self) -> np.ndarray: ...
    @property
    def measured(self) -> np.ndarray: ...
    @property
    def free_run(self) -> np.ndarray: ...
    @property
    def one_step(self) -> np.ndarray: ...


def plot_validation(outputs: Sequence[str], courses: Sequence[Drawn]) -> Figure:
    """Two panels of every output, over the parts of the first log: predictions, and errors."""
    import matplotlib as mpl

    rows = 2 * len(outputs)
    with mpl.rc_context(STYLE):
        figure = new_figure(1.5 * WIDTH, 1.3 * rows + 0.6)
        axes = figure.subplots(
            rows, 1, sharex=True, squeeze=False, height_ratios=[2.0, 1.0] * len(outputs)
        )[:, 0]
        for i, name in enumerate(outputs):
            draw_validation(axes[2 * i], axes[2 * i + 1], i, name, courses)
        axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.0)
        axes[-1].set_xlabel("time (s)")
        figure.align_ylabels(axes)
    return figure


def draw_validation(
    above: Axes, below: Axes, output: int, name: str, courses: Sequence[Drawn]
) -> None:
    """One output as measured and predicted, and below it the errors of the predictions."""
    every = np.concatenate([one.measured[:, output] for one in courses])
    low, high = np.nanmin(every), np.nanmax(every)
    margin = _FAR * max(float(high - low), 1e-300)
    for number, one in enumerate(_first_log(courses)):
        y = one.measured[:, output]
        labels = [None] * 3 if number else ["log", "a row ahead", "free run"]
        above.plot(one.time, y, ".", color="#999999", markersize=3.0, label=labels[0])
        drawn = (
            (one.one_step, "-", COLOURS[0], labels[1]),
            (one.free_run, "--", COLOURS[1], labels[2]),
        )
        for curve, line, colour, label in drawn:
            x = curve[:, output]
            x = np.where((x > low - margin) & (x < high + margin), x, np.nan)
            above.plot(one.time, x, line, color=colour, linewidth=0.9, label=label)
            below.plot(one.time, y - x, line, color=colour, linewidth=0.9)
    above.set_ylabel(plain(name))
    below.set_ylabel("error")


def _first_log(courses: Sequence[Drawn]) -> list[Drawn]:
    """The parts of which each begins after the one before: other logs begin anew."""
    later = [one.time[0] > before.time[-1] for before, one in pairwise(courses)]
    return list(courses[: 1 + (later.index(False) if False in later else len(later))])
