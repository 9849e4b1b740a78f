"""The curves of a page: one panel per signal, one colour per law, all over the same time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from bokeh.events import Tap
from bokeh.models import ColumnDataSource, FixedTicker, HoverTool, PlainText, Range1d, Span
from bokeh.plotting import figure

from deadtime.app.page_run import ProblemOutcome
from deadtime.app.style import dash_of
from deadtime.base.figure_style import GREY
from deadtime.reports.figures.colours import looks_of
from deadtime.reports.figures.runs import frame, mismatch_floor, mismatch_norm
from deadtime.simulation import Trajectory

MOST_POINTS = 1500
MOST_PANELS = 4  # of states
_TIMES = 34  # pixels of the axis of times


class ProblemPanels:
    """The panels of one problem: states, outputs, inputs, the switching signal, the mismatch.

    A reference is drawn beside the state that follows it, or beside an output where that is no
    state that is shown. Where no run has a mismatch, there is no panel of it.

    Parameters
    ----------
    outcome : Outcome
        What is shown first.
    laws : sequence of str
        All that may be shown; they share the colours.
    states : sequence of int
        Which states have a panel.
    """

    def __init__(self, outcome: ProblemOutcome, laws: Sequence[str], states: Sequence[int]) -> None:
        problem = outcome.problem
        self.laws = list(laws)
        self.shown = list(states)
        self.modes = list(problem.modes)
        self.x_range = Range1d(start=0.0, end=problem.horizon)
        self.cursor = Span(location=0.0, dimension="height", line_color=GREY, visible=False)
        self._references = _references(outcome, self.shown)
        self._rows = {f"x{i}": problem.states[i] for i in self.shown}
        outputs = {row: i for row, i in self._references.items() if row not in self._rows}
        self._rows |= {row: problem.tracked[i] for row, i in outputs.items()}
        self._rows |= {f"u{i}": name for i, name in enumerate(problem.inputs)}
        self._rows |= {"w": "|mismatch|"} if _has_mismatch(outcome) else {}
        self.panels = {row: self._panel(row, label) for row, label in self._rows.items()}
        self.strip, self._signal = self._mode_panel()
        self._sources: dict[str, Any] = {}
        self._followed = self._reference_curves()

    @property
    def all(self) -> list[Any]:
        """The panels from the top down."""
        *others, last = self.panels.values()
        return [*others, self.strip, last] if "w" in self.panels else [*others, last, self.strip]

    def fits(self, outcome: ProblemOutcome) -> bool:
        """Whether it has the panels for what is to be shown."""
        return ("w" in self.panels) == _has_mismatch(outcome)

    def _panel(self, row: str, label: str) -> Any:
        dashed = "; dashed its reference" if row in self._references else ""
        panel = _blank(self.x_range, label + dashed, 116 + _TIMES * (row == "w"))
        _show_times(panel, row == "w")
        panel.y_range = Range1d(start=-1.0, end=1.0)
        panel.add_layout(self.cursor)
        return panel

    def _mode_panel(self) -> tuple[Any, ColumnDataSource]:
        count = len(self.modes)
        lowest = "w" not in self.panels
        strip = _blank(self.x_range, "", 40 + 22 * count + _TIMES * lowest)
        _show_times(strip, lowest)
        strip.y_range = Range1d(start=-0.5, end=count - 0.5)
        strip.yaxis.ticker = FixedTicker(ticks=list(range(count)))
        labels = {i: PlainText(text=name) for i, name in enumerate(self.modes)}
        strip.yaxis.major_label_overrides = labels
        strip.ygrid.visible = False
        source = ColumnDataSource({"t": [0.0], "mode": [0.0]})
        strip.step("t", "mode", source=source, mode="after", line_color=GREY, line_width=2.0)
        strip.add_layout(self.cursor)
        return strip, source

    def _reference_curves(self) -> ColumnDataSource:
        """Curves of the references, of which the source has a column for each panel."""
        source = ColumnDataSource({name: [] for name in ("t", *self._references)})
        for row in self._references:
            self.panels[row].step(
                "t", row, source=source, mode="after", line_color=GREY, line_dash="dashed",
                line_width=1.3, level="overlay", name="reference",
            )  # fmt: skip
        return source

    def on_draw(self, act: Callable[[float, int], None]) -> None:
        """Call act(time, mode) where the strip of modes is clicked."""

        def on_tap(event: Tap) -> None:
            if event.x is not None and event.y is not None:
                act(float(event.x), round(event.y))

        self.strip.on_event(Tap, on_tap)

    def show(self, outcome: ProblemOutcome) -> None:
        """Draw what the laws did."""
        self.x_range.end = outcome.problem.horizon
        runs = outcome.runs
        for law, run in runs.items():
            self._source(law, run).data = self._columns(run)
        for law, source in self._sources.items():
            if law not in runs:
                source.data = {name: [] for name in source.data}
        longest = max(runs.values(), key=lambda run: run.time[-1])
        along = longest.reference
        references = {} if along is None else {r: along[i] for r, i in self._references.items()}
        kept = _samples_to_draw(longest.time.size, list(references.values()))
        columns = {"t": longest.time, **references}
        self._followed.data = {name: values[kept] for name, values in columns.items()}
        for row, panel in self.panels.items():
            values = [one for run in runs.values() if (one := _values(run, row)) is not None]
            if values:
                floor = mismatch_floor(list(runs.values())) if row == "w" else 0.0
                ends = frame(values, floor, references.get(row))
                panel.y_range.start, panel.y_range.end = ends
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
            for row, panel in self.panels.items():
                if row.startswith("u") and run.record.held:
                    panel.step("t", row, mode="after", **look)
                else:
                    panel.line("t", row, **look)
            self._sources[law] = source
        return self._sources[law]


def _references(outcome: ProblemOutcome, shown: Sequence[int]) -> dict[str, int]:
    """The row that every reference is drawn beside, and its number among the references."""
    followed = next(iter(outcome.runs.values())).followed
    rows: dict[str, int] = {}
    for i, state in enumerate([] if followed is None else followed.states):
        beside = f"x{state}"
        rows[beside if state in shown and beside not in rows else f"y{i}"] = i
    return rows


def _has_mismatch(outcome: ProblemOutcome) -> bool:
    return any(run.mismatch is not None for run in outcome.runs.values())


def _show_times(panel: Any, shown: bool) -> None:
    """The axis of times, of the lowest panel alone."""
    panel.xaxis.visible = shown
    if shown:
        panel.xaxis.axis_label = "time (s)"


def _blank(x_range: Range1d, label: str, height: int) -> Any:
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
    panel.title.text = PlainText(text=label)  # where $$ would be set as a formula
    panel.title.text_font_size = "9pt"
    panel.title.text_font_style = "normal"
    panel.title.standoff = 2
    panel.yaxis.ticker.desired_num_ticks = 4
    return panel


def _values(run: Trajectory, row: str) -> np.ndarray | None:
    """The samples of a panel's row."""
    if row == "w":
        return mismatch_norm(run)
    if row[0] == "y":
        return None if run.tracked is None else run.tracked[int(row[1:])]
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
