"""The curves of a page: one panel per signal, one colour per law, all over the same time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from bokeh.events import Tap
from bokeh.models import ColumnDataSource, FixedTicker, HoverTool, Range1d, Span
from bokeh.plotting import figure

from deadtime.app.outcome import Outcome
from deadtime.app.style import dash_of
from deadtime.base.palette import GREY
from deadtime.problems import Problem
from deadtime.reports.figures.colours import looks_of
from deadtime.reports.figures.runs import frame, mismatch_floor
from deadtime.simulation import Trajectory

MOST_POINTS = 1500
MOST_PANELS = 4  # of states


class Figures:
    """The panels of one problem: states, inputs, the switching signal, the mismatch.

    Parameters
    ----------
    problem : Problem
    laws : sequence of str
        All that may be shown; they share the colours.
    states : sequence of int
        Which states have a panel.
    """

    def __init__(self, problem: Problem, laws: Sequence[str], states: Sequence[int]) -> None:
        self.laws = list(laws)
        self.shown = list(states)
        self.modes = list(problem.modes)
        self.x_range = Range1d(start=0.0, end=problem.horizon)
        self.cursor = Span(location=0.0, dimension="height", line_color=GREY, visible=False)
        self._rows = {f"x{i}": problem.states[i] for i in self.shown}
        self._rows |= {f"u{i}": name for i, name in enumerate(problem.inputs)}
        self._rows["w"] = "|mismatch|"
        self.panels = {row: self._panel(row, label) for row, label in self._rows.items()}
        self.strip, self._signal = self._mode_panel()
        self._sources: dict[str, Any] = {}
        self.mismatch = self.panels.pop("w")
        self.mismatch.xaxis.axis_label = "time (s)"

    @property
    def all(self) -> list[Any]:
        """The panels from the top down."""
        return [*self.panels.values(), self.strip, self.mismatch]

    def _panel(self, row: str, label: str) -> Any:
        panel = _blank(self.x_range, 150 if row == "w" else 116, label)
        panel.xaxis.visible = row == "w"
        panel.y_range = Range1d(start=-1.0, end=1.0)
        panel.add_layout(self.cursor)
        return panel

    def _mode_panel(self) -> tuple[Any, ColumnDataSource]:
        count = len(self.modes)
        strip = _blank(self.x_range, 40 + 22 * count, "")
        strip.xaxis.visible = False
        strip.y_range = Range1d(start=-0.5, end=count - 0.5)
        strip.yaxis.ticker = FixedTicker(ticks=list(range(count)))
        strip.yaxis.major_label_overrides = dict(enumerate(self.modes))
        strip.ygrid.visible = False
        source = ColumnDataSource({"t": [0.0], "mode": [0.0]})
        strip.step("t", "mode", source=source, mode="after", line_color=GREY, line_width=2.0)
        strip.add_layout(self.cursor)
        return strip, source

    def on_draw(self, act: Callable[[float, int], None]) -> None:
        """Call act(time, mode) where the strip of modes is clicked."""

        def on_tap(event: Tap) -> None:
            if event.x is not None and event.y is not None:
                act(float(event.x), round(event.y))

        self.strip.on_event(Tap, on_tap)

    def show(self, outcome: Outcome) -> None:
        """Draw what the laws did."""
        self.x_range.end = outcome.problem.horizon
        runs = outcome.runs
        for law, run in runs.items():
            self._source(law, run).data = self._columns(run)
        for law, source in self._sources.items():
            if law not in runs:
                source.data = {name: [] for name in source.data}
        for row, panel in [*self.panels.items(), ("w", self.mismatch)]:
            values = [one for run in runs.values() if (one := _values(run, row)) is not None]
            if values:
                floor = mismatch_floor(list(runs.values())) if row == "w" else 0.0
                panel.y_range.start, panel.y_range.end = frame(values, floor)
        times, modes = outcome.signal.times, outcome.signal.modes
        inside = times < outcome.problem.horizon
        self._signal.data = {
            "t": np.append(times[inside], outcome.problem.horizon),
            "mode": np.append(modes[inside], modes[inside][-1]).astype(float),
        }

    def _columns(self, run: Trajectory) -> dict[str, np.ndarray]:
        """What the panels read, of at most so many samples as can be told apart."""
        rows = {row: _values(run, row) for row in self._rows}
        kept = _samples_to_draw(run.time.size, [row for row in rows.values() if row is not None])
        columns = {"t": run.time[kept]}
        for name, values in rows.items():
            whole = np.full(run.time.size, np.nan) if values is None else values
            columns[name] = np.clip(whole[kept], -1e30, 1e30).astype(np.float32)
        return columns

    def _source(self, law: str, run: Trajectory) -> Any:
        """The samples of a law; its curves are made when it is first shown."""
        if law not in self._sources:
            colour, dash = looks_of([*self.laws, *self._sources, law])[law]
            source = ColumnDataSource({name: [] for name in ("t", *self._rows)})
            look: dict[str, Any] = {
                "source": source,
                "line_color": colour,
                "line_dash": dash_of(dash),
                "line_width": 1.8,
                "name": law,
            }
            for row, panel in [*self.panels.items(), ("w", self.mismatch)]:
                if row.startswith("u") and run.record.held:
                    panel.step("t", row, mode="after", **look)
                else:
                    panel.line("t", row, **look)
            self._sources[law] = source
        return self._sources[law]


def _blank(x_range: Range1d, height: int, label: str) -> Any:
    """A panel that a phone can scroll past: nothing is dragged or zoomed by itself."""
    panel: Any = figure(
        height=height,
        sizing_mode="stretch_width",
        x_range=x_range,
        tools="xbox_zoom,reset",
        toolbar_location="right",
        active_drag=None,
        active_scroll=None,
        min_border_left=60,
    )
    panel.toolbar.logo = None
    panel.toolbar.autohide = True
    panel.add_tools(
        HoverTool(
            tooltips=[("law", "$name"), ("t", "$x{0.000} s"), ("value", "$snap_y")],
            line_policy="nearest",
            mode="mouse",
        )
    )
    panel.title.text = label
    panel.title.text_font_size = "9pt"
    panel.title.text_font_style = "normal"
    panel.title.standoff = 2
    panel.yaxis.ticker.desired_num_ticks = 4
    return panel


def _values(run: Trajectory, row: str) -> np.ndarray | None:
    """The samples of a panel's row."""
    if row == "w":
        return None if run.mismatch is None else np.linalg.norm(run.mismatch, axis=0)
    return (run.states if row[0] == "x" else run.inputs)[int(row[1:])]


def _samples_to_draw(count: int, rows: Sequence[np.ndarray]) -> np.ndarray:
    """Which samples to draw: all, or per piece of time the ends and every row's least and most."""
    if count <= MOST_POINTS:
        return np.arange(count)
    pieces = max(1, MOST_POINTS // (2 * len(rows) + 1))
    edges = np.linspace(0, count, pieces + 1).astype(int)
    chosen = {0, count - 1, *edges[:-1].tolist()}
    for row in rows:
        for first, last in pairwise(edges.tolist()):
            piece = row[first:last]
            chosen |= {first + int(piece.argmin()), first + int(piece.argmax())}
    return np.array(sorted(chosen))
