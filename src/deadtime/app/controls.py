"""The widgets of a page, and what they say as `Settings`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import panel_material_ui as pmui

from deadtime.app.documents import Document
from deadtime.app.offered_laws import Section
from deadtime.app.ranges import FROM_FILE, IDEAL, Range, ranges_of, steps_of
from deadtime.app.settings import DrawnSignal, GivenSignal, Settings
from deadtime.problems.file.schema import RULES
from deadtime.scenarios.sweeps.axes import FAMILIES

WIDE: dict[str, Any] = {"sizing_mode": "stretch_width", "margin": (2, 10)}


class Controls:
    """The widgets for one document.

    Parameters
    ----------
    document : Document
    offer : dict
        The laws on offer, by name.
    chosen : tuple of str
        The laws of the file.
    changed : callable
        Called after a person changed anything.
    """

    def __init__(
        self,
        document: Document,
        offer: dict[str, Section],
        chosen: tuple[str, ...],
        changed: Callable[[], None],
    ) -> None:
        self._chosen, self._changed, self._quiet = chosen, changed, False
        self.signal: DrawnSignal | GivenSignal | None = None
        self._ruled = document.draft["signal"]["kind"] in RULES
        self.ranges = {one.name: one for one in ranges_of(document)}
        self.sliders = {name: _slider(one) for name, one in self.ranges.items()}
        own = document.draft["run"].get("step", 0.01)
        self._step = own if own == IDEAL else float(own)
        self.step = pmui.Select(
            label="Sampling period h (s)", options=steps_of(document), value=self._step, **WIDE
        )
        self.laws = pmui.CheckBoxGroup(
            label="Laws", options=list(offer), value=list(chosen), **WIDE
        )
        self.sojourn = pmui.Select(
            label="Sojourns", options=[FROM_FILE, *FAMILIES], value=FROM_FILE, **WIDE
        )
        self.seed = pmui.IntInput(label="Seed of the signal", value=0, start=0, step=1, **WIDE)
        self.redraw = pmui.Button(label="Another signal", variant="outlined", **WIDE)
        self.original = pmui.Button(label="The file's signal", variant="outlined", **WIDE)
        for widget in [*self.sliders.values(), self.step, self.laws]:
            widget.param.watch(self._on_moved, "value")
        drawing = [self.sojourn, self.seed]
        drawing += [self.sliders["dwell_time"]] if "dwell_time" in self.sliders else []
        for widget in drawing:
            widget.param.watch(self._on_drawn, "value")
        self.redraw.on_click(self._next)
        self.original.on_click(lambda _: self.choose(None))

    def settings(self) -> Settings:
        """What was moved, what was chosen."""
        values: dict[str, Any] = {}
        for name, slider in self.sliders.items():
            one = self.ranges[name]
            if slider.value is not None and slider.value != one.value:
                values[name] = float(slider.value) * one.scale
        if self.step.value != self._step:
            values["step"] = self.step.value
        if self.sojourn.value != FROM_FILE:
            values["sojourn"] = self.sojourn.value
        laws = None if tuple(self.laws.value) == self._chosen else tuple(self.laws.value)
        return Settings(values, laws, self.signal)

    def value(self, name: str) -> float:
        """Where a parameter stands."""
        return float(self.sliders[name].value) * self.ranges[name].scale

    def choose(self, signal: DrawnSignal | GivenSignal | None) -> None:
        """Take another signal."""
        self.signal = signal
        self._changed()

    def widgets(self, group: str) -> list[Any]:
        """The widgets under a heading."""
        if group == "Switching" and self._ruled:
            return [pmui.Typography("The state decides the mode, by the rule of the file.")]
        found = [self.sliders[name] for name, one in self.ranges.items() if one.group == group]
        if group == "Switching":
            row = pmui.Row(self.redraw, self.original, sizing_mode="stretch_width", margin=0)
            return [*found, self.sojourn, self.seed, row]
        return [*found, self.step] if group == "Run" else found

    def _on_moved(self, _: Any) -> None:
        if not self._quiet:
            self._changed()

    def _on_drawn(self, _: Any) -> None:
        """What the switching is drawn from was moved: the signal is drawn again."""
        if not self._quiet:
            self.choose(DrawnSignal(int(self.seed.value or 0)))

    def _next(self, _: Any) -> None:
        if isinstance(self.signal, DrawnSignal):
            self.seed.value = int(self.seed.value or 0) + 1
        else:
            self.choose(DrawnSignal(int(self.seed.value or 0)))


def _slider(one: Range) -> pmui.EditableFloatSlider:
    """A slider with a number to type beside it, which may go beyond its ends."""
    positive = one.low > 0.0
    return pmui.EditableFloatSlider(
        label=one.label,
        start=one.low,
        end=max(one.high, one.value),
        value=one.value,
        step=one.step,
        fixed_start=one.low if positive or one.low == 0.0 else None,
        **WIDE,
    )
