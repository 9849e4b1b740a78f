"""The card of a log: a form for its columns, the progress, and the identified plant."""

from __future__ import annotations

from html import escape
from typing import Any, Protocol

import panel as pn
import panel_material_ui as pmui

from deadtime.app.background_jobs import BackgroundJobs, ProgressBar
from deadtime.app.controls import download_button
from deadtime.app.documents import Document, file_stem
from deadtime.app.jobs import look_at_log, try_log
from deadtime.app.page_outcome import MOST_MODES
from deadtime.app.uploaded_log import (
    Columns,
    IdentifiedPlant,
    LogRequest,
    details_html,
    identified_html,
    likelihood_html,
)
from deadtime.app.workers import TooLongError, Workers
from deadtime.base.errors import ArgumentError
from deadtime.reports.identification_report import Picture
from deadtime.reports.report_folder import render

UNUSED, STATE, INPUT, MODE = "not used", "state", "input", "mode"
ONE, HIDDEN = "the plant has one", "there are several, not logged"
_ROLE: dict[str, Any] = {"width": 150, "margin": (6, 5), "size": "small"}
_SHORT: dict[str, Any] = {"width": 140, "margin": (6, 5), "size": "small"}


class LogForm:
    """A role for every column, the modes, the range of delays."""

    def __init__(self) -> None:
        self.roles: dict[str, pmui.Select] = {}
        self.modes = pmui.Select(
            label="Modes", options=[ONE, HIDDEN], value=ONE, width=250, margin=(6, 5), size="small"
        )
        self.least = pmui.IntInput(label="from", value=1, start=1, end=MOST_MODES, **_SHORT)
        self.most = pmui.IntInput(label="to", value=3, start=1, end=MOST_MODES, **_SHORT)
        self.low = pmui.FloatInput(label="Delay, from (s)", value=0.0, start=0.0, **_SHORT)
        self.high = pmui.FloatInput(label="Delay, to (s)", value=2.0, start=0.0, **_SHORT)
        self.samples = pmui.Checkbox(label="Modes change at samples only", margin=(0, 5))
        self.apart = pmui.Checkbox(label="Every mode has delays of its own", margin=(0, 5))
        self.modes.param.watch(self._on_modes, "value")
        self._columns = pmui.FlexBox(margin=0)
        self.view = pmui.Column(
            self._columns,
            pmui.FlexBox(self.modes, self.least, self.most, margin=0),
            pmui.FlexBox(self.low, self.high, margin=0),
            pmui.FlexBox(self.samples, self.apart, margin=0),
            sizing_mode="stretch_width", margin=0,
        )  # fmt: skip

    def fill(self, columns: Columns) -> None:
        """Offer the columns of a log, with roles chosen by their names."""
        guess, self.roles = columns.guess, {}
        known = dict.fromkeys(guess.states, STATE) | dict.fromkeys(guess.inputs, INPUT)
        if isinstance(guess.modes, str):
            known[guess.modes] = MODE
        for name in columns.names:
            options = [UNUSED, *[STATE, INPUT] * (name in columns.numbers)]
            options += [MODE] * (name in columns.modes)
            role = pmui.Select(label=name, options=options, value=known.get(name, UNUSED), **_ROLE)
            role.param.watch(self._on_modes, "value")
            self.roles[name] = role
        self._columns.objects = list(self.roles.values())
        self.modes.value = ONE
        self.low.value, self.high.value = guess.delay
        self.samples.value = self.apart.value = False
        self._on_modes()

    def _of(self, role: str) -> tuple[str, ...]:
        return tuple(name for name, one in self.roles.items() if one.value == role)

    def request(self) -> LogRequest:
        """The request that the form states.

        Raises
        ------
        ArgumentError
            If an entry is missing or impossible.
        """
        states, inputs, column = (self._of(role) for role in (STATE, INPUT, MODE))
        for role, chosen in ((STATE, states), (INPUT, inputs)):
            if not chosen:
                raise ArgumentError(f"No column is said to be {role}: say which are.")
        if len(column) > 1:
            raise ArgumentError(f"{' and '.join(column)}: say of one column that it is the mode.")
        low, high = self.low.value, self.high.value
        if low is None or high is None or not 0.0 <= low < high:
            raise ArgumentError("Delay: give a range of which the first end is the lesser one.")
        modes: str | tuple[int, int] | None = column[0] if column else None
        if self._hidden():
            least, most = self.least.value, self.most.value
            if least is None or most is None or not 1 <= least <= most:
                raise ArgumentError("Modes: give their least number, then their largest.")
            modes = int(least), int(most)
        at_samples, apart = (
            modes is not None and bool(box.value) for box in (self.samples, self.apart)
        )
        return LogRequest(states, inputs, modes, (float(low), float(high)), at_samples, apart)

    def _hidden(self) -> bool:
        return not self._of(MODE) and self.modes.value == HIDDEN

    def _on_modes(self, _: Any = None) -> None:
        """Show the fields of modes, which depend on whether these were logged."""
        logged, hidden = bool(self._of(MODE)), self._hidden()
        self.modes.visible = not logged
        self.least.visible = self.most.visible = hidden
        self.samples.visible = self.apart.visible = logged or hidden


LIMIT = 120.0  # seconds after which a log is given up
_LOOKING = 30.0


class CardPage(Protocol):
    """The page that shows the card."""

    def open_found(self, document: Document, seconds: float, called: str) -> bool: ...
    def refuse(self, why: str) -> None: ...
    def say(self, text: str, severity: str = "info") -> None: ...


class LogCard:
    """The card that a page shows of a log."""

    def __init__(self, page: CardPage, workers: Workers) -> None:
        self._page, self._jobs = page, BackgroundJobs(workers)
        self._name, self._content = "", b""
        self._request: LogRequest | None = None
        self._plant: IdentifiedPlant | None = None
        self._report = b""
        self.form = LogForm()
        html: dict[str, Any] = {
            "sizing_mode": "stretch_width", "margin": (0, 10), "stylesheets": [render("found.css")]
        }  # fmt: skip
        self.about = pn.pane.HTML("", **html)
        self.shown, self.likelihood, self.details = (pn.pane.HTML("", **html) for _ in range(3))
        self.begin = pmui.Button(label="Identify", margin=4)
        self.cancel = pmui.Button(label="Cancel", variant="outlined", margin=4, visible=False)
        self.closing = pmui.Button(label="Close the log", variant="outlined", margin=4)
        self.progress = ProgressBar(LIMIT)
        self._downloads = [
            download_button("Download problem file", "problem.toml", self._problem, visible=False),
            download_button("Download report", "report.html", lambda: self._report, visible=False),
        ]
        self.begin.on_click(lambda _: self.identify())
        self.cancel.on_click(lambda _: self.stop())
        self.closing.on_click(lambda _: self.close())
        self.settings = pmui.Accordion(
            ("Columns, modes and delays", self.form.view),
            active=[0], title_variant="subtitle1", disable_gutters=True,
            sizing_mode="stretch_width", margin=(2, 5),
        )  # fmt: skip
        self.view = pmui.Paper(
            self.about,
            self.settings,
            pmui.FlexBox(self.begin, self.cancel, *self._downloads, self.closing, margin=(2, 6)),
            *self.progress.view,
            pmui.Grid(
                pmui.Grid(self.shown, size={"xs": 12, "lg": 6}),
                pmui.Grid(self.likelihood, size={"xs": 12, "lg": 6}),
                container=True, spacing=1, sizing_mode="stretch_width",
            ),
            self.details,
            sizing_mode="stretch_width", margin=(4, 10), visible=False, elevation=2,
        )  # fmt: skip

    def _problem(self) -> bytes:
        return b"" if self._plant is None else self._plant.document.text.encode()

    # -- a log comes -----------------------------------------------------------------------

    def take(self, name: str, content: bytes) -> None:
        """Look at a log; identify its plant at once where the names of its columns tell all."""

        def on_seen(columns: Columns) -> None:
            self.close()
            self._name, self._content = name, content
            every = f"every {columns.step:.4g} s" if columns.step > 0.0 else "at uneven times"
            self.about.object = (
                f"<b>{escape(file_stem(name))}.csv</b>: {columns.rows:,} rows, {every}."
            )
            self.form.fill(columns)
            self.view.visible = True
            if columns.sure:
                self.identify()
            else:
                self._page.say(
                    f"Say what the columns of {file_stem(name)}.csv are, then press Identify."
                )

        self._jobs.stop()
        self._idle()
        self._page.say("Looking at the log …")
        self._jobs.begin(
            _LOOKING, on_seen, lambda error: self._page.refuse(str(error)),
            look_at_log, name, content,
        )  # fmt: skip

    def identify(self) -> None:
        """Identify the plant, by the form."""
        try:
            self._request = self.form.request()
        except ArgumentError as error:
            self._page.refuse(str(error))
            return
        self._forget_plant()
        self._busy("waiting for a process")
        self._page.say(f"Identifying the plant of {file_stem(self._name)}.csv …")
        self._jobs.begin(
            LIMIT, self._on_done, self._on_failed,
            try_log, self._name, self._content, self._request, on_progress=self._on_progress,
        )  # fmt: skip

    def _on_progress(self, message: str | tuple[IdentifiedPlant, float]) -> None:
        if isinstance(message, str):
            self._busy(message)
            return
        plant, seconds = message
        called = f"The plant of {plant.document.name}.csv"
        if not self._page.open_found(plant.document, seconds, called):
            self._jobs.stop()
            self._idle()
            return
        self._plant = plant
        self.shown.object, self.details.object = identified_html(plant), details_html(plant)
        self.likelihood.object = likelihood_html("The likelihood over the delay follows.")
        self.settings.active = []
        self._downloads[0].param.update(visible=True, filename=f"{plant.document.name}.toml")
        self._page.say(f"{called}, as a problem: its laws run below.")

    def _on_done(self, rest: tuple[Picture, bytes]) -> None:
        self._idle()
        picture, self._report = rest
        self.likelihood.object = likelihood_html(picture)
        self._downloads[1].param.update(
            visible=True, filename=f"{file_stem(self._name)}-report.html"
        )

    def _on_failed(self, error: BaseException) -> None:
        self._idle()
        slow = isinstance(error, TooLongError)
        if self._plant is not None:
            why = f"it takes longer than {LIMIT:g} s" if slow else str(error).rstrip(".")
            self._without_likelihood(why)
            return
        if slow:
            self._page.refuse(
                f"{file_stem(self._name)}.csv takes longer than {LIMIT:g} s, the most that a page "
                "gives a log, and was stopped. Ask less of it and press Identify again: a "
                "narrower range of delays, modes that are logged or fewer of them, fewer states, "
                f"a stretch of the log. Or run, without a limit: {self._command()}"
            )
        else:
            self._page.refuse(str(error))

    def _command(self) -> str:
        """The command line for this request, which has no limit."""
        return "" if self._request is None else self._request.command(self._name)

    def _without_likelihood(self, why: str) -> None:
        self.likelihood.object = likelihood_html(
            f"No curve of the likelihood over the delay: {why}. All else is here; for the curve "
            f"run {self._command()} --report {file_stem(self._name)}.html"
        )

    # -- its end ---------------------------------------------------------------------------

    def stop(self) -> None:
        """Cancel the computation; results so far stay."""
        self._jobs.stop()
        self._idle()
        if self._plant is not None:
            self._without_likelihood("it was cancelled")
        elif self._content:
            self._page.say("Cancelled. Nothing was changed.")

    def close(self) -> None:
        """Close the log and hide the card."""
        self.drop()
        self._idle()
        self._forget_plant()
        self.view.visible = False

    def drop(self) -> None:
        """Release the log, touching no widget: their document may be gone."""
        self._jobs.stop()
        self._name, self._content, self._report = "", b"", b""
        self._request = self._plant = None

    def _forget_plant(self) -> None:
        self._plant, self._report = None, b""
        for pane in (self.shown, self.likelihood, self.details):
            pane.object = ""
        for button in self._downloads:
            button.visible = False
        self.settings.active = [0]

    def _busy(self, stage: str) -> None:
        self.progress.show(stage)
        self.begin.disabled, self.cancel.visible = True, True

    def _idle(self) -> None:
        self.progress.hide()
        self.begin.disabled, self.cancel.visible = False, False
