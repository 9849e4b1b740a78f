"""Charts of designs for margin: what a wider delay margin costs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from deadtime.plotting import COLOURS, STYLE, WIDTH, plain

if TYPE_CHECKING:
    from deadtime.design import Design, TradeOff

REACHED, BEYOND = "#e4f2e4", "#f3c3a3"


def plot_designs(designs: Mapping[str, Design], columns: int = 2) -> Figure:
    """Cost over delay margin, a panel per design: the trade-off, the answer, and the limits.

    The cost is relative to the cheapest design that was found, on a logarithmic axis. Green is
    what some linear controller of each mode alone reaches; what none reaches is shaded red.

    Parameters
    ----------
    designs : mapping
        From a panel's title to a `Design`.
    columns : int
        Panels beside each other.
    """
    columns = min(columns, len(designs))
    rows = -(-len(designs) // columns)
    with rc_context(STYLE):
        figure = Figure(figsize=(1.5 * WIDTH if columns > 1 else WIDTH, 0.8 + 2.3 * rows))
        panels = figure.subplots(rows, columns, squeeze=False)
        for panel, (title, design) in zip(panels.flat, designs.items(), strict=False):
            _panel(panel, design)
            panel.set_title(plain(title))
        for spare in panels.flat[len(designs) :]:
            spare.set_axis_off()
        for panel in panels[:, 0]:
            panel.set_ylabel("cost / cheapest found")
        keys = [
            Line2D([], [], color=COLOURS[0], marker="o", markersize=4, label="gains"),
            Line2D([], [], color=COLOURS[2], marker="s", markersize=4, ls="", label="with filter"),
            Line2D([], [], color=COLOURS[6], marker="X", ls="", label="plain design"),
            Line2D([], [], color=COLOURS[1], ls="--", label="asked for"),
            Patch(facecolor=REACHED, label="some linear controller, per mode"),
            Patch(facecolor=BEYOND, label="no linear controller, in some mode"),
        ]
        figure.legend(
            handles=keys,
            loc="outside lower center",
            ncols=3 if columns > 1 else 2,
            handlelength=1.6,
        )
    return figure


def _panel(panel: Axes, design: Design) -> None:
    points = [point for point in design.points if math.isfinite(point.margin)]
    cheapest = min((point.cost for point in design.points), default=math.nan)
    drawn = [*points, design.plain] if math.isfinite(design.plain.cost) else points
    widest = max([design.asked, *(p.margin for p in drawn if math.isfinite(p.margin))])
    reached = min(limit.reached for limit in design.limits)
    most = min(limit.most for limit in design.limits)
    right = 100.0 * (1.08 * most if widest < most < 3.0 * widest else 1.15 * widest)
    panel.axvspan(0.0, min(100.0 * reached, right), color=REACHED, linewidth=0.0, zorder=0)
    if 100.0 * most < right:
        panel.axvspan(100.0 * most, right, color=BEYOND, linewidth=0.0, zorder=0)
    panel.axvline(100.0 * design.asked, color=COLOURS[1], linestyle="--", linewidth=1.0)
    x, y = _coordinates(points, cheapest)
    panel.plot(x, y, color=COLOURS[0], linewidth=1.0)
    for filtered, marker, colour in ((False, "o", COLOURS[0]), (True, "s", COLOURS[2])):
        kind = [point for point in points if (point.time_constant is not None) is filtered]
        panel.plot(*_coordinates(kind, cheapest), marker, color=colour, markersize=4)
    if design.plain in drawn and math.isfinite(design.plain.margin):
        panel.plot(*_coordinates([design.plain], cheapest), "X", color=COLOURS[6], markersize=6)
    panel.set_yscale("log")
    top = max([2.0, *y.tolist(), *_coordinates(drawn, cheapest)[1].tolist()])
    panel.set_ylim(0.85, 1.4 * top)
    panel.set_xlim(0.0, right)
    panel.set_xlabel("delay margin (% of D)")
    ticks = [tick for tick in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0) if tick <= 1.4 * top]
    panel.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    panel.minorticks_off()


def _coordinates(points: list[TradeOff], cheapest: float) -> tuple[np.ndarray, np.ndarray]:
    """Margins in percent and relative costs."""
    margins = np.array([100.0 * point.margin for point in points])
    return margins, np.array([point.cost / cheapest for point in points])
