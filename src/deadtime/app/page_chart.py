"""The stability chart of a page: mode distances that are certified and refuted, per dwell time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, Range1d
from bokeh.plotting import figure

from deadtime.reports.figures.margins import BAD, GOOD

BOUNDS = (0.02, 2.0)
FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)  # dwell times of the columns, as multiples of the current
HERE = "#f5c518"


def _patch(colour: str, text: str) -> str:
    square = f"display: inline-block; width: 0.9em; height: 0.9em; background: {colour}"
    return f"<span style='white-space: nowrap'><span style='{square}'></span> {text}</span> &ensp;"


KEY = (
    "<div class='key'>Stability of the law in question over all signals with a dwell time: "
    f"{_patch(GOOD, 'certified')}{_patch(BAD, 'some signal grows')}{_patch(HERE, 'this problem')}"
    "</div>"
)


class Chart:
    """A column per dwell time: certified up to a distance, refuted from another on."""

    def __init__(self) -> None:
        self.panel: Any = figure(
            height=260,
            sizing_mode="stretch_width",
            x_axis_type="log",
            tools="",
            toolbar_location=None,
            x_range=Range1d(start=0.01, end=1.0),
            y_range=Range1d(start=0.0, end=BOUNDS[1]),
        )
        self.panel.xaxis.axis_label = "dwell time τ_d (s)"
        self.panel.yaxis.axis_label = "mode distance α"
        names = ("left", "right", "bottom", "top")
        self._good: Any = ColumnDataSource({name: [] for name in names})
        self._bad: Any = ColumnDataSource({name: [] for name in names})
        self._point: Any = ColumnDataSource({"x": [1.0], "y": [1.0]})
        quad: dict[str, Any] = {"line_color": None, **{name: name for name in names}}
        self.panel.quad(source=self._good, fill_color=GOOD, **quad)
        self.panel.quad(
            source=self._bad, fill_color=BAD, hatch_pattern="/", hatch_color="#b0643a",
            hatch_alpha=0.5, **quad,
        )  # fmt: skip
        self.panel.scatter(
            "x", "y", source=self._point, size=13, marker="circle_x", fill_color=HERE,
            line_color="black",
        )  # fmt: skip

    def place(self, dwell_time: float, distance: float) -> None:
        """Where the problem stands."""
        self._point.data = {"x": [dwell_time], "y": [distance]}
        ends = self.panel.x_range
        if not self._good.data["left"] and not self._bad.data["left"]:
            ends.start, ends.end = dwell_time / 6.0, dwell_time * 6.0
        else:
            ends.start, ends.end = (
                min(ends.start, dwell_time / 1.2),
                max(ends.end, dwell_time * 1.2),
            )
        self.panel.y_range.end = max(BOUNDS[1], 1.1 * distance)

    def clear(self, dwell_time: float) -> list[float]:
        """Take all columns away; the dwell times of new ones."""
        for source in (self._good, self._bad):
            source.data = {name: [] for name in source.data}
        ends, side = self.panel.x_range, math.sqrt(FACTORS[1] / FACTORS[0])
        ends.start = dwell_time * FACTORS[0] / side
        ends.end = dwell_time * FACTORS[-1] * side
        times = [dwell_time * factor for factor in FACTORS]
        self.panel.xaxis.ticker = times
        self.panel.xaxis.major_label_overrides = {time: f"{time:.3g}" for time in times}
        return times

    def add(self, dwell_time: float, certified: float, refuted: float) -> None:
        """A column: up to where certified, from where refuted; NaN where there is no answer."""
        side = math.sqrt(FACTORS[1] / FACTORS[0])
        ends = {"left": [dwell_time / side], "right": [dwell_time * side]}
        if not np.isnan(certified):
            self._good.stream({**ends, "bottom": [0.0], "top": [certified]})
        if not np.isnan(refuted):
            self._bad.stream({**ends, "bottom": [refuted], "top": [1e3]})
