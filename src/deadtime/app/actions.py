"""Actions of the buttons: downloads, drawing by keyboard, the worst signal, the chart."""

from __future__ import annotations

import html
import io
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import panel as pn
import panel_material_ui as pmui

from deadtime.app.controls import WIDE, Controls, download_button
from deadtime.app.documents import Document
from deadtime.app.jobs import growth_elsewhere, growth_rates, lifted_order, margin, worst_signal
from deadtime.app.page_outcome import ProblemOutcome, csv_of
from deadtime.app.page_panels import BOUNDS, KEY, Chart, ProblemPanels
from deadtime.app.script import SCRIPT, script_of
from deadtime.app.settings import GivenSignal
from deadtime.base.wording import as_rate, file_name
from deadtime.problems import Problem
from deadtime.reports.figures.runs import plot_laws
from deadtime.reports.verdict import held_in_words

_LIMIT = 120.0  # seconds that a search may take
_REST = 250  # milliseconds after which a hand that moved something rests
_AT_ONCE = 210  # order of the lifted loop whose growth rates come at once
_PLAY = """
const frames = 120; let i = 0;
cursor.visible = true;
if (cursor.tags.length) { clearInterval(cursor.tags[0]); }
const timer = setInterval(() => {
  cursor.location = range.start + (range.end - range.start) * i / frames;
  i += 1;
  if (i > frames) { clearInterval(timer); cursor.visible = false; cursor.tags = []; }
}, 40);
cursor.tags = [timer];
"""


class ActionPage(Protocol):
    """The page that shows the buttons, and on which they act."""

    document: Document
    offer: Mapping[str, Any]
    outcome: ProblemOutcome
    controls: Controls
    figures: ProblemPanels

    def toml(self) -> str: ...
    def draft(self, without: Sequence[str] = ()) -> dict[str, Any]: ...
    def draw_by_hand(self, at: float, mode: int) -> None: ...
    def elsewhere(
        self, limit: float, done: Callable[[Any], None], failed: Callable[[str], None],
        job: Callable[..., Any], *given: Any,
    ) -> None: ...  # fmt: skip


class Actions:
    """The buttons of a page and the chart."""

    def __init__(self, page: ActionPage) -> None:
        self.page = page
        self.chart = Chart()
        self.law = pmui.Select(label="Law in question", options=[""], **WIDE)
        self.worst = pmui.Button(label="Worst signal", **WIDE)
        self.fill = pmui.Button(label="Compute the chart", variant="outlined", **WIDE)
        look: dict[str, Any] = {"margin": (14, 5)}
        self.play = pmui.Button(label="Watch", variant="outlined", icon="play_arrow", **look)
        self.verdict = pn.pane.HTML("", sizing_mode="stretch_width", margin=(2, 10))
        self.state = pn.pane.HTML(
            "", css_classes=["search"], sizing_mode="stretch_width", margin=(2, 10)
        )
        self.at = pmui.FloatInput(label="at (s)", value=1.0, start=0.0, step=0.1, width=110)
        self.to = pmui.Select(label="switch to", options=["mode 0"], width=150)
        self.switch = pmui.Button(label="Switch", **look)
        self.worst.on_click(self._find_worst)
        self.fill.on_click(self._fill_chart)
        self.switch.on_click(self._switch)
        self.law.param.watch(self._judge, "value")
        self._moves = self._round = 0
        files: dict[str, tuple[str, Callable[[], bytes]]] = {
            "Problem": (".toml", lambda: page.toml().encode()),
            "Figure": (".png", self.figure),
            "Data": (".csv", lambda: csv_of(page.outcome.runs).encode()),
            "Script": (SCRIPT, self.script),
        }
        self._downloads = [
            download_button(label, ending, make, size="small", tags=[ending])
            for label, (ending, make) in files.items()
        ]

    # -- layout ----------------------------------------------------------------------------

    def drawing(self) -> list[Any]:
        """Below the curves: watch, and draw the signal without a mouse."""
        row = pmui.FlexBox(self.at, self.to, self.switch, self.play, margin=(0, 10))
        hint = pn.pane.HTML(
            "Draw the signal: click a mode at an instant in the strip, or switch here.",
            margin=(0, 10),
        )
        return [hint, row]

    def judging(self) -> list[Any]:
        """Beside the curves: the worst signal and the chart."""
        buttons = pmui.Row(self.worst, self.fill, sizing_mode="stretch_width", margin=0)
        chart = pn.pane.Bokeh(self.chart.panel, sizing_mode="stretch_width")
        key = pn.pane.HTML(KEY, sizing_mode="stretch_width", margin=(0, 10))
        return [self.law, self.verdict, buttons, self.state, key, chart]

    def downloads(self) -> list[Any]:
        """The problem, the figure, the data and the script, each as a file."""
        return [pmui.FlexBox(*self._downloads, margin=(5, 6))]

    def figure(self) -> bytes:
        """The figure of what is shown, PNG."""
        outcome = self.page.outcome
        problem = outcome.problem
        file = io.BytesIO()
        drawn = plot_laws(
            outcome.runs, problem.states, problem.modes,
            laws=list(self.page.offer), inputs=problem.inputs, tracked=problem.tracked or None,
        )  # fmt: skip
        drawn.savefig(file, format="png")
        return file.getvalue()

    def script(self) -> bytes:
        """The script that makes what is shown."""
        return script_of(self.page.outcome.problem, list(self.page.offer)).encode()

    # -- what happens ----------------------------------------------------------------------

    def on_opened(self) -> None:
        """Another problem was opened."""
        page = self.page
        called = file_name(page.document.name) or "problem"
        for button in self._downloads:
            button.filename = f"{called}{button.tags[0]}"
        modes = page.figures.modes
        self.to.param.update(options=modes, value=modes[-1])
        self.fill.disabled = len(modes) == 1
        self.fill.loading = self.worst.loading = False
        self._round += 1
        if not self.fill.disabled:
            self.chart.clear(page.controls.value("dwell_time"))
        self.state.object = ""

    def on_drawn(self) -> None:
        """The panels were made anew."""
        figures = self.page.figures
        self.play.js_on_click(code=_PLAY, args={"cursor": figures.cursor, "range": figures.x_range})

    def on_shown(self) -> None:
        """Something else is shown: the point moves, the verdict follows when the hand rests."""
        page = self.page
        names = list(page.outcome.problem.laws)
        if self.law.options != names:
            value = self.law.value if self.law.value in names else names[0]
            self.law.param.update(options=names, value=value)
        if "dwell_time" in page.controls.ranges:
            self.chart.place(page.controls.value("dwell_time"), page.controls.value("distance"))
        self._judge()

    def _judge(self, _: Any = None) -> None:
        """Say soon what the loop does with each mode held."""
        self._moves += 1
        number, document = self._moves, pn.state.curdoc

        def rest() -> None:
            if number == self._moves:
                self._grow(number)

        if document is None:
            rest()
        else:
            document.add_timeout_callback(rest, _REST)

    def _grow(self, number: int) -> None:
        """Find the growth in every mode, here where that takes a moment."""
        page, law = self.page, self.law.value
        problem = page.outcome.problem

        def on_grown(rates: list[float]) -> None:
            if number == self._moves:
                self.verdict.object = verdict(law, problem, rates)

        def unknown(_: str) -> None:
            if number == self._moves:
                self.verdict.object = ""

        if lifted_order(problem) <= _AT_ONCE:
            rates = growth_rates(problem, law)
            on_grown(rates) if rates else unknown("")
        else:
            unknown("")
            page.elsewhere(
                _LIMIT, on_grown, unknown, growth_elsewhere, page.draft(), page.document.source, law
            )

    def _switch(self, _: Any) -> None:
        mode = self.page.figures.modes.index(self.to.value)
        self.page.draw_by_hand(float(self.at.value or 0.0), mode)

    def _find_worst(self, _: Any) -> None:
        page, law = self.page, self.law.value

        def on_found(result: dict[str, Any]) -> None:
            self.state.object = html.escape(result["message"])
            about = f"the worst found for {law} ({as_rate(result['growth_rate'])} /s)"
            times, modes = tuple(result["times"]), tuple(result["modes"])
            page.controls.choose(GivenSignal(times, modes, about, result["at"]))

        self._search(
            self.worst, f"Looking for the worst signal of {law} …", on_found,
            worst_signal, page.draft(), page.document.source, law, self._dwell_time(),
        )  # fmt: skip

    def _fill_chart(self, _: Any) -> None:
        self._round += 1
        page, law = self.page, self.law.value
        draft = page.draft(without=("distance",))
        times = self.chart.clear(self._dwell_time())
        given = (draft, page.document.source, law, BOUNDS)
        self._fill_column(self._round, law, times, [], given)

    def _fill_column(
        self, number: int, law: str, times: list[float], before: list[str], given: tuple
    ) -> None:
        """Compute a column of the chart, then the next, unless another was begun meanwhile.

        `before` says of each column before why it has no answer, or nothing.
        """
        i = len(before)

        def on_found(margin: tuple[float, float, str]) -> None:
            if number != self._round:
                return
            certified, refuted, reason = margin
            self.chart.add(times[i], certified, refuted)
            reasons = [*before, reason]
            if i + 1 < len(times):
                self._fill_column(number, law, times, reasons, given)
                return
            pairs = zip(times, reasons, strict=True)
            missing = [f" No answer at τ_d = {time:.3g} s: {why}" for time, why in pairs if why]
            self.state.object = html.escape(f"{law}: the chart is complete." + "".join(missing))

        text = f"{law}: column {i + 1} of {len(times)}, τ_d = {times[i]:.3g} s …"
        self._search(self.fill, text, on_found, margin, *given, times[i])

    def _search(
        self, button: Any, text: str, found: Callable[[Any], None], job: Any, *given: Any
    ) -> None:
        """Run a job elsewhere, its button busy until it is done."""

        def on_failed(error: str) -> None:
            button.loading = False
            self.state.object = html.escape(error)

        def on_done(result: Any) -> None:
            button.loading = False
            found(result)

        button.loading = True
        self.state.object = html.escape(text)
        self.page.elsewhere(_LIMIT, on_done, on_failed, job, *given)

    def _dwell_time(self) -> float:
        page = self.page
        if "dwell_time" in page.controls.ranges:
            return page.controls.value("dwell_time")
        return page.outcome.problem.plant.longest_delay


def verdict(law: str, problem: Problem, rates: Sequence[float]) -> str:
    """A sentence on the growth of a law's loop if switching stops."""
    if not rates:
        return ""
    judged, _ = held_in_words(problem, rates)
    judged = judged if judged == "stable" else f"<b>{judged}</b>"
    pairs = zip(problem.modes, map(as_rate, rates), strict=True)
    growth = html.escape(", ".join(f"{name} {rate} /s" for name, rate in pairs))
    return (
        f"<div class='verdict'>If switching stops, {html.escape(law)} is {judged}. "
        f"Growth: {growth}.</div>"
    )
