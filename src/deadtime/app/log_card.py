"""The card of a log: what its columns are, what is looked for, how far that is, what was found."""

from __future__ import annotations

import io
from collections.abc import Callable
from html import escape
from typing import Any, Protocol

import panel as pn
import panel_material_ui as pmui

from deadtime.app import identified_page as page_of
from deadtime.app.documents import Document, file_stem
from deadtime.app.errands import Errands
from deadtime.app.jobs import look_at_log, try_log
from deadtime.app.log_form import LogForm
from deadtime.app.progress import ProgressBar
from deadtime.app.uploaded_log import Columns, FoundPlant, LogRequest
from deadtime.app.workers import TooLongError, Workers
from deadtime.base.errors import ArgumentError
from deadtime.reports.identification_report import Picture

LIMIT = 120.0  # seconds after which a log is given up
_LOOKING = 30.0


class CardPage(Protocol):
    """The page that shows the card."""

    def open_found(self, document: Document, seconds: float, called: str) -> bool: ...
    def refuse(self, why: str) -> None: ...
    def say(self, text: str, severity: str = "info") -> None: ...


class LogCard:
    """What a page shows of a log.

    Parameters
    ----------
    page : Shown
    workers : Workers
    """

    def __init__(self, page: CardPage, workers: Workers) -> None:
        self._page, self._errands = page, Errands(workers)
        self._name, self._content = "", b""
        self._asked: LogRequest | None = None
        self._found: FoundPlant | None = None
        self._report = b""
        self.form = LogForm()
        html: dict[str, Any] = {
            "sizing_mode": "stretch_width", "margin": (0, 10), "stylesheets": [page_of.CSS]
        }  # fmt: skip
        self.about = pn.pane.HTML("", **html)
        self.shown, self.likelihood, self.details = (pn.pane.HTML("", **html) for _ in range(3))
        self.begin = pmui.Button(label="Identify", margin=4)
        self.cancel = pmui.Button(label="Cancel", variant="outlined", margin=4, visible=False)
        self.closing = pmui.Button(label="Close the log", variant="outlined", margin=4)
        self.progress = ProgressBar(LIMIT)
        self._downloads = [
            self._download("Problem file", lambda: self._found and self._found.document.text),
            self._download("Report", lambda: self._report.decode()),
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

    def _download(self, label: str, make: Callable[[], str | None]) -> pmui.FileDownload:
        button = pmui.FileDownload(
            label=f"Download {label.lower()}", filename=label, margin=4,
            visible=False, callback=lambda: io.BytesIO((make() or "").encode()),
        )  # fmt: skip
        button.variant = "outlined"  # as an argument Panel warns of it
        return button

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

        self._errands.stop()
        self._idle()
        self._page.say("Looking at the log …")
        self._errands.begin(
            _LOOKING, on_seen, lambda error: self._page.refuse(str(error)),
            look_at_log, name, content,
        )  # fmt: skip

    def identify(self) -> None:
        """Identify the plant, as the form asks."""
        try:
            self._asked = self.form.asked()
        except ArgumentError as error:
            self._page.refuse(str(error))
            return
        self._forget_found()
        self._busy("waiting for a process")
        self._page.say(f"Identifying the plant of {file_stem(self._name)}.csv …")
        self._errands.begin(
            LIMIT, self._on_done, self._on_failed,
            try_log, self._name, self._content, self._asked, told=self._on_told,
        )  # fmt: skip

    def _on_told(self, said: str | tuple[FoundPlant, float]) -> None:
        if isinstance(said, str):
            self._busy(said)
            return
        found, seconds = said
        called = f"The plant of {found.document.name}.csv"
        if not self._page.open_found(found.document, seconds, called):
            self._errands.stop()
            self._idle()
            return
        self._found = found
        self.shown.object, self.details.object = page_of.shown(found), page_of.details(found)
        self.likelihood.object = page_of.likelihood("The likelihood over the delay follows.")
        self.settings.active = []
        self._downloads[0].param.update(visible=True, filename=f"{found.document.name}.toml")
        self._page.say(f"{called}, as a problem: its laws run below.")

    def _on_done(self, rest: tuple[Picture, bytes]) -> None:
        """The likelihood and the report are there, too."""
        self._idle()
        picture, self._report = rest
        self.likelihood.object = page_of.likelihood(picture)
        self._downloads[1].param.update(
            visible=True, filename=f"{file_stem(self._name)}-report.html"
        )

    def _on_failed(self, error: BaseException) -> None:
        self._idle()
        slow = isinstance(error, TooLongError)
        if self._found is not None:
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
        """What asks the same without a limit."""
        return "" if self._asked is None else self._asked.command(self._name)

    def _without_likelihood(self, why: str) -> None:
        self.likelihood.object = page_of.likelihood(
            f"No curve of the likelihood over the delay: {why}. All else is here; for the curve "
            f"run {self._command()} --report {file_stem(self._name)}.html"
        )

    # -- its end ---------------------------------------------------------------------------

    def stop(self) -> None:
        """Cancel what is being computed; what was found stays."""
        self._errands.stop()
        self._idle()
        if self._found is not None:
            self._without_likelihood("it was cancelled")
        elif self._content:
            self._page.say("Cancelled. Nothing was changed.")

    def close(self) -> None:
        """Let go of the log, and show nothing of it."""
        self.drop()
        self._idle()
        self._forget_found()
        self.view.visible = False

    def drop(self) -> None:
        """Let go of the log, touching no widget: their document may be gone."""
        self._errands.stop()
        self._name, self._content, self._report = "", b"", b""
        self._asked = self._found = None

    def _forget_found(self) -> None:
        self._found, self._report = None, b""
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
