"""How far something is that takes long: what is being done, and for how long."""

from __future__ import annotations

import time
from html import escape
from typing import Any

import panel as pn
import panel_material_ui as pmui

_TICK = 1000  # milliseconds between looks at the clock


class ProgressBar:
    """A bar, and a line on what is being done.

    Parameters
    ----------
    limit : float
        Seconds after which it is given up.
    """

    def __init__(self, limit: float) -> None:
        self._limit, self._stage, self._began = limit, "", 0.0
        self._clock: Any = None
        self._bar = pmui.LinearProgress(sizing_mode="stretch_width", margin=(4, 10), visible=False)
        self.text = pn.pane.HTML("", sizing_mode="stretch_width", margin=(0, 10), visible=False)
        self.view = [self._bar, self.text]

    def show(self, stage: str) -> None:
        """Say what is being done; the clock begins with the first."""
        self._stage, begins = stage, not self.text.visible
        if begins:
            self._began = time.monotonic()
            self._bar.visible = self.text.visible = True
            if pn.state.curdoc is not None:
                browser = pn.state.curdoc
                self._clock = browser, browser.add_periodic_callback(self._tick, _TICK)
        self._tick()

    def hide(self) -> None:
        """There is nothing more to wait for."""
        self._bar.visible = self.text.visible = False
        if self._clock is not None:
            browser, tick = self._clock
            browser.remove_periodic_callback(tick)
            self._clock = None

    def _tick(self) -> None:
        seconds = time.monotonic() - self._began
        said = f"{escape(self._stage)} … {seconds:.0f} s of at most {self._limit:.0f} s"
        self.text.object = f"<div class='progress'>{said}</div>"
