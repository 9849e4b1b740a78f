"""One session of the explorer: the page, and its response when something is moved."""

from __future__ import annotations

import html
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import panel as pn
import panel_material_ui as pmui
from bokeh.layouts import column

from deadtime.app import uploaded_log
from deadtime.app.actions import Actions
from deadtime.app.background_jobs import BackgroundJobs
from deadtime.app.controls import WIDE, Controls
from deadtime.app.documents import MOST_BYTES, Document, file_stem, open_named, to_toml, too_large
from deadtime.app.file_upload import FileUpload
from deadtime.app.first_view import FirstView
from deadtime.app.jobs import try_upload
from deadtime.app.log_card import LogCard
from deadtime.app.page_outcome import ProblemOutcome, run_draft, table_of
from deadtime.app.page_panels import MOST_PANELS, ProblemPanels
from deadtime.app.settings import DrawnSignal, GivenSignal, draft_of, switch_at
from deadtime.app.workers import Workers
from deadtime.base.errors import DeadtimeError
from deadtime.problems import NAMED
from deadtime.reports.report_folder import render

GROUPS = ("Plant", "Switching", "Run", "Imperfections")
_TRIAL = 60.0  # seconds after which a trial of an uploaded problem is stopped
_LONG = 200  # characters of a title that are shown
_SLOW = 1.0  # seconds of a processor above which a page cannot follow every move


class Page:
    """A page, one per session, which begins with a document.

    `workers` do what takes longer than a moment; `first_view` is the document's, made once where
    many pages begin with it. What is shown is the `outcome` of the `document` that was opened.
    """

    def __init__(
        self, document: Document, workers: Workers, first_view: FirstView | None = None
    ) -> None:
        self.workers = workers
        self.message = pmui.Alert(object="", severity="info", visible=False, margin=(4, 10))
        self.costs = pn.pane.HTML(
            "", sizing_mode="stretch_width", stylesheets=[render("costs.css")]
        )
        self.about = pn.pane.HTML("", sizing_mode="stretch_width", margin=(0, 10))
        self.log = LogCard(self, workers)
        self.panels = pmui.Column(sizing_mode="stretch_width", margin=0)
        self.groups = {name: pmui.Column(sizing_mode="stretch_width") for name in GROUPS}
        self.laws = pmui.Column(sizing_mode="stretch_width")
        self.actions = Actions(self)
        self.outcome: ProblemOutcome
        self._scheduled = self._closed = False
        self._jobs = BackgroundJobs(workers)
        self._begin(FirstView.of(document) if first_view is None else first_view)

    # -- opening ---------------------------------------------------------------------------

    def open(self, document: Document) -> None:
        """Show another problem."""
        self._begin(FirstView.of(document))
        self.log.close()

    def _begin(self, first_view: FirstView) -> None:
        document, outcome = first_view.document, first_view.outcome
        controls = Controls(document, dict(first_view.offer), first_view.chosen, self.touch)
        self._jobs.stop()
        self.document, self.offer, self.controls = document, first_view.offer, controls
        self._shown = dict(document.draft)
        states = range(min(outcome.problem.plant.states, MOST_PANELS))
        self._draw(outcome, list(states))
        for name, group in self.groups.items():
            group.objects = controls.widgets(name)
        self.laws.objects = [controls.laws, *self._state_choice(outcome)]
        self.actions.on_opened()
        self._show(outcome)

    def _draw(self, outcome: ProblemOutcome, states: list[int]) -> None:
        self.figures = ProblemPanels(outcome, list(self.offer), states)
        self.figures.on_draw(self.draw_by_hand)
        self.figures.show(outcome)  # what a browser is still laying out had better not change
        panels = column(*self.figures.all, sizing_mode="stretch_width")
        self.panels.objects = [pn.pane.Bokeh(panels, sizing_mode="stretch_width", margin=0)]
        self.actions.on_drawn()

    def _state_choice(self, outcome: ProblemOutcome) -> list[Any]:
        """Which states have a panel, where there are too many for all."""
        names = list(outcome.problem.states)
        if len(names) <= MOST_PANELS:
            return []
        choice = pmui.MultiChoice(
            label="States shown", options=names, value=names[:MOST_PANELS], **WIDE
        )

        def on_chosen(event: Any) -> None:
            self._draw(self.outcome, [names.index(name) for name in event.new])

        choice.param.watch(on_chosen, "value")
        return [choice]

    def open_named(self, name: str) -> None:
        """Show a named problem."""
        if self.attempt(lambda: self.open(open_named(name))):
            self.say(f"Opened {name}.")

    def upload(self, name: str, content: bytes) -> None:
        """Show a problem file that came through the browser, once a trial of it has worked."""
        if len(content) > MOST_BYTES:
            self.refuse(str(too_large(name, len(content))))
            return

        def on_tried(result: tuple[Document, float]) -> None:
            document, seconds = result
            called = f"{document.name}.toml"
            if self._is_quick(seconds, called, "simulate") and self.attempt(
                lambda: self.open(document)
            ):
                self.say(f"Opened {document.name}.toml.")

        self.say("Trying the file …")
        self.elsewhere(_TRIAL, on_tried, self.refuse, try_upload, name, content)

    def _is_quick(self, seconds: float, called: str, command: str) -> bool:
        """Whether a document that took so long to run can be shown.

        Else what was called so is refused, and a command named that has time.
        """
        if seconds > _SLOW:
            self.refuse(
                f"{called} takes {seconds:.1f} s of a processor to run, too "
                f"slow for a page that follows every move: use `deadtime {command}`."
            )
        return seconds <= _SLOW

    def upload_log(self, name: str, content: bytes) -> None:
        """Show the card of a log that came through the browser."""
        if len(content) > uploaded_log.MOST_BYTES:
            self.refuse(str(uploaded_log.too_large(name, len(content))))
        else:
            self.log.take(name, content)

    def open_found(self, document: Document, seconds: float, called: str) -> bool:
        """Show the problem of a log, whose card stays; whether it was shown."""
        return self._is_quick(seconds, called, "identify") and self.attempt(
            lambda: self._begin(FirstView.of(document))
        )

    def take(self, name: str, size: int, content: bytes | None) -> None:
        """Open a chosen or dropped file; one that is too large comes without its content."""
        ending = name.lower().rpartition(".")[2]
        if ending not in ("csv", "toml"):
            self.refuse(
                f"{file_stem(name)} is neither a problem (.toml) nor a log (.csv) by its name."
            )
        elif content is None:
            large = uploaded_log.too_large if ending == "csv" else too_large
            self.refuse(str(large(name, size)))
        else:
            (self.upload_log if ending == "csv" else self.upload)(name, content)

    def elsewhere(
        self,
        limit: float,
        done: Callable[[Any], None],
        failed: Callable[[str], None],
        job: Any,
        *given: Any,
    ) -> None:
        """Run a job in another process, then go on here with its result or its error.

        Nothing comes of it once another problem was opened, or the session is over.
        """
        self._jobs.begin(limit, done, lambda error: failed(str(error)), job, *given)

    def close(self) -> None:
        """The session is over: release its objects, even if something still refers to the page.

        Its document is gone, so no widget is touched.
        """
        self._closed = True
        names = ("panels", "groups", "laws", "controls", "figures", "outcome", "actions", "log")
        with ExitStack() as steps:
            for name in names:
                steps.callback(vars(self).pop, name, None)
            steps.callback(self.log.drop)
            steps.callback(self._jobs.stop)

    # -- showing ---------------------------------------------------------------------------

    def touch(self) -> None:
        """Schedule one run for all changes until it starts."""
        if self._scheduled:
            return
        self._scheduled = True
        if pn.state.curdoc is None:
            self.update()
        else:
            pn.state.curdoc.add_next_tick_callback(self.update)

    def update(self) -> None:
        """Run the settings of the controls; after an error the page stays as it is."""
        self._scheduled = False
        if not self._closed:
            self.attempt(self._run)

    def _run(self) -> None:
        draft = self.draft()
        outcome = run_draft(draft, self.document.source)
        self._shown = draft
        self._move(outcome)

    def draft(self, without: Sequence[str] = ()) -> dict[str, Any]:
        """The problem file of the settings, some parameters left as in the document."""
        settings = self.controls.settings()
        values = {name: one for name, one in settings.values.items() if name not in without}
        return draft_of(self.document, self.offer, replace(settings, values=values))

    def toml(self) -> str:
        """The problem file shown, without added laws that do not run."""
        draft = dict(self._shown)
        own = self.document.draft.get("law", [])
        if "law" in draft:
            idle = [self.offer.get(name) for name in self.outcome.reasons]
            draft["law"] = [law for law in draft["law"] if law in own or law not in idle]
        return to_toml(self.document, draft)

    def attempt(self, act: Callable[[], None]) -> bool:
        """Try an action and report a refusal; whether the action succeeded."""
        try:
            act()
        except (DeadtimeError, ValueError, OverflowError) as error:
            self.say(str(error), "error")
            return False
        if self.message.severity == "error":
            self.message.visible = False
        return True

    def refuse(self, why: str) -> None:
        """Say why something was not opened."""
        self.say(f"{why} Nothing was changed.", "error")

    def say(self, text: str, severity: str = "info") -> None:
        """A message above the curves."""
        self.message.param.update(object=html.escape(text), severity=severity, visible=True)

    def _move(self, outcome: ProblemOutcome) -> None:
        if self.message.severity == "info":
            self.message.visible = False
        if self.figures.fits(outcome):
            self.figures.show(outcome)
        else:
            self._draw(outcome, self.figures.shown)
        self._show(outcome)

    def _show(self, outcome: ProblemOutcome) -> None:
        self.outcome = outcome
        self.costs.object = table_of(outcome, list(self.offer))
        self.about.object = self._about(outcome)
        self.actions.on_shown()

    def _about(self, outcome: ProblemOutcome) -> str:
        problem, signal = outcome.problem, outcome.signal
        match self.controls.signal:
            case DrawnSignal(seed):
                kind = f"drawn with seed {seed}"
            case GivenSignal(about=about):
                kind = about
            case None:
                kind = "the file's"
        switches = int(((signal.times > 0) & (signal.times < problem.horizon)).sum())
        diverged = [name for name, run in outcome.runs.items() if run.diverged]
        more = f" Diverged: {html.escape(', '.join(diverged))}." if diverged else ""
        notes = "".join(f"<br>{html.escape(one)}" for one in outcome.notes)
        return (
            f"<div class='about'><b>{html.escape(problem.title[:_LONG])}</b><br>"
            f"Signal: {html.escape(kind)}, {switches} switches.{more}{notes}</div>"
        )

    # -- drawing ---------------------------------------------------------------------------

    def draw_by_hand(self, at: float, mode: int) -> None:
        """Switch to a mode at an instant, as `drawing.switch_at` does."""
        problem, signal = self.outcome.problem, self.outcome.signal
        at, instants = min(max(at, 0.0), problem.horizon), problem.signals.at
        if instants == "samples" and problem.step is not None:
            at = problem.step * round(at / problem.step)
        at = round(at, 3 if instants == "anywhere" else 12)
        mode = min(max(mode, 0), problem.plant.modes - 1)
        inside = signal.times < problem.horizon
        times, modes = signal.times[inside].tolist(), signal.modes[inside].tolist()

        def draw() -> None:
            drawn = switch_at(times, modes, at, mode, problem.plant.modes)
            self.controls.choose(replace(drawn, at=instants))

        self.attempt(draw)

    # -- layout ----------------------------------------------------------------------------

    def view(self) -> pmui.Page:
        """The whole page."""
        choice = pmui.Select(
            label="Problem", options=["", *NAMED], value="", helper_text="or a file:", **WIDE
        )
        choice.param.watch(lambda event: event.new and self.open_named(event.new), "value")
        # By the name that the browser gives itself: there the controls would cover the curves.
        phone = "Mobi" in pn.state.headers.get("User-Agent", "")

        def take(name: str, size: int, content: bytes | None) -> None:
            page.sidebar_open = page.sidebar_open and not phone
            self.take(name, size, content)

        chooser = FileUpload(take, self.refuse, **WIDE)
        groups = pmui.Accordion(
            ("Laws", self.laws),
            *self.groups.items(),
            active=[0, 1, 2], title_variant="subtitle1", disable_gutters=True,
            sizing_mode="stretch_width", margin=(5, 5),
        )  # fmt: skip
        left = pmui.Column(self.about, self.panels, *self.actions.drawing())
        right = pmui.Column(self.costs, *self.actions.judging(), sizing_mode="stretch_width")
        body = pmui.Grid(
            pmui.Grid(left, size={"xs": 12, "lg": 7}),
            pmui.Grid(right, size={"xs": 12, "lg": 5}),
            container=True, spacing=1, sizing_mode="stretch_width",
        )  # fmt: skip
        # On a phone the drawer lies over the header, and so over the button that opened it.
        closing = pmui.Button(label="Close", variant="outlined", visible=phone, **WIDE)
        page = pmui.Page(
            title="deadtime explorer",
            sidebar=[closing, choice, chooser, *self.actions.downloads(), groups],
            sidebar_width=330,
            sidebar_open=not phone,
            main=[pmui.Column(self.message, self.log.view, body, sizing_mode="stretch_width")],
            theme_toggle=True,
        )  # fmt: skip

        closing.on_click(lambda _: setattr(page, "sidebar_open", False))
        return page
