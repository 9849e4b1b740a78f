"""The panels of a page: curves over the same time, one colour per law, and the stability chart."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from bokeh.events import Tap
from bokeh.models import ColumnDataSource, FixedTicker, HoverTool, PlainText, Range1d, Span
from bokeh.plotting import figure

from deadtime.app.page_outcome import ProblemOutcome, dash_of
from deadtime.base.figure_style import GREY
from deadtime.reports.figures.certificates import BAD, CHART_WORDS, GOOD
from deadtime.reports.figures.colours import looks_of
from deadtime.reports.figures.runs import frame, mismatch_floor, mismatch_norm
from deadtime.simulation import Trajectory

MOST_POINTS = 1500
MOST_PANELS = 4  # of states
_TIMES = 34  # pixels of the axis of times


class ProblemPanels:
    """The panels of one problem: states, outputs, inputs, the switching signal, the mismatch.

    A reference is drawn beside the state that follows it, or beside an output where that is no
    state that is shown. Where no run has a mismatch, there is no panel of it. All `laws` that may
    be shown share the colours; `states` are those with a panel.
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
        """Whether the outcome fits the panels."""
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
        """Draw the runs of an outcome."""
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
        samples = _samples_to_draw(longest.time.size, list(references.values()))
        columns = {"t": longest.time, **references}
        self._followed.data = {name: values[samples] for name, values in columns.items()}
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
        """The columns of the panels, of at most as many samples as the eye can separate."""
        rows = {row: _values(run, row) for row in self._rows}
        samples = _samples_to_draw(run.time.size, [row for row in rows.values() if row is not None])
        columns = {"t": run.time[samples]}
        for name, values in rows.items():
            whole = np.full(run.time.size, np.nan) if values is None else values
            columns[name] = np.clip(whole[samples], -1e30, 1e30).astype(np.float32)
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


BOUNDS = (0.02, 2.0)
FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)  # dwell times of the columns, as multiples of the current
HERE = "#f5c518"


def _patch(colour: str, text: str) -> str:
    square = f"display: inline-block; width: 0.9em; height: 0.9em; background: {colour}"
    return f"<span style='white-space: nowrap'><span style='{square}'></span> {text}</span> &ensp;"


KEY = (
    "<div class='key'>The law in question, over all signals with a dwell time: "
    + "".join(_patch(colour, CHART_WORDS[colour]) for colour in (GOOD, BAD))
    + f"{_patch(HERE, 'this problem')}</div>"
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
        """Move the point of this problem."""
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
        """Remove all columns; the dwell times of new ones."""
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
