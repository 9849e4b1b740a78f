"""The widgets of a page: the numbers that can be moved, their ranges, and their `Settings`."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import panel_material_ui as pmui

from deadtime.app.documents import Document
from deadtime.app.draft_facts import delay_error, dwell_time_of, longest_delay, moved_delays
from deadtime.app.page_outcome import MOST_SAMPLES, MOST_TAPS
from deadtime.app.settings import DrawnSignal, GivenSignal, Section, Settings
from deadtime.base.wording import subscript
from deadtime.problems.file.schema import RULES
from deadtime.problems.imperfection_registry import SWEPT, Slider
from deadtime.scenarios.sweeps.axes import FAMILIES

FROM_FILE = "as in the file"
IDEAL = "ideal"
_STEPS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)


@dataclass(frozen=True)
class Range:
    """A number that can be moved (immutable): its start value, its ends and its step."""

    name: str  # in `Settings.values`
    label: str  # with its unit
    group: str  # the heading above it
    value: float
    low: float
    high: float
    step: float
    scale: float = 1.0  # value per number on the page: 0.01 for per cent


def ranges_of(document: Document) -> list[Range]:
    """The numbers of a problem that can be moved, in the order of the page."""
    draft = document.draft
    run = draft["run"]
    ranges = [_wide(name, label, "Plant", value) for name, label, value in moved_delays(draft)]
    if len(draft["plant"]["A"]) > 1:
        ranges.append(Range("distance", "Mode distance α", "Plant", 1.0, 0.0, 2.0, 0.01))
        ranges.append(
            _wide("dwell_time", "Dwell time τ_d (s)", "Switching", dwell_time_of(draft), 5.0)
        )
    names = draft["plant"].get("states") or [f"x{subscript(i + 1)}" for i in range(len(run["x0"]))]
    size = max(abs(float(x)) for x in run["x0"]) or 1.0
    most = _nice(5.0 * size)
    for i, x in enumerate(run["x0"]):
        label = f"{names[i]} at t = 0"
        ranges.append(Range(f"run.x0.{i}", label, "Run", float(x), -most, most, most / 100.0))
    group, off = "Imperfections", 100.0 * delay_error(draft)
    return [
        *ranges,
        _wide("horizon", "Horizon T (s)", "Run", float(run["horizon"])),
        Range("delay_error", "True delay off by (%)", group, off, -20.0, 20.0, 0.1, 0.01),
        *(
            _imperfect(name, group, slider, _imperfection(draft, kind, slider.key), size)
            for name, (kind, _, slider) in SWEPT.items()
            if slider is not None
        ),
    ]


def steps_of(document: Document) -> list[float | str]:
    """Sampling periods that a page offers: those that it can keep up with, and the file's."""
    run, delay = document.draft["run"], longest_delay(document.draft)
    own = run.get("step", 0.01)
    usual: list[float] = [
        step
        for step in _STEPS
        if run["horizon"] / step <= MOST_SAMPLES and delay / step <= MOST_TAPS
    ]
    if own != IDEAL:
        usual.append(float(own))
    return [*sorted(set(usual)), IDEAL]


def _imperfection(draft: Mapping[str, Any], kind: str, key: str) -> float:
    """A number of an imperfection of the file; 0 where it has none, or one per signal."""
    for one in draft.get("imperfection", []):
        if one["kind"] == kind and isinstance(one.get(key), (int, float)):
            return float(one[key])
    return 0.0


def _imperfect(name: str, group: str, slider: Slider, value: float, size: float) -> Range:
    """From 0 to twice the value of the file, or to a large value relative to the state."""
    most = _nice(max(slider.reach * size, 2.0 * value))
    return Range(name, slider.label, group, value, 0.0, most, most / slider.steps)


def _wide(name: str, label: str, group: str, value: float, factor: float = 3.0) -> Range:
    """A positive number between a twentieth and some times of where it starts."""
    step = 10.0 ** math.floor(math.log10(value) - 1.0)
    low, high = max(step, math.floor(value / 20.0 / step) * step), _nice(factor * value)
    return Range(name, label, group, value, low, high, step)


def _nice(value: float) -> float:
    """The next of 1, 2, 3, 5, 10, … above a positive number.

    Examples
    --------
    >>> _nice(0.27), _nice(42.0), _nice(3.0)
    (0.3, 50.0, 3.0)
    """
    power = 10.0 ** math.floor(math.log10(value))
    digit = next(d for d in (1.0, 2.0, 3.0, 5.0, 10.0) if d * power >= value * (1.0 - 1e-12))
    return float(f"{digit * power:.12g}")


WIDE: dict[str, Any] = {"sizing_mode": "stretch_width", "margin": (2, 10)}


class Controls:
    """The widgets for one document; `changed` is called after a person changed anything.

    `offer` are the laws on offer by name, `chosen` those of the file.
    """

    def __init__(
        self,
        document: Document,
        offer: dict[str, Section],
        chosen: tuple[str, ...],
        changed: Callable[[], None],
    ) -> None:
        self._chosen, self._changed = chosen, changed
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
            widget.param.watch(lambda _: self._changed(), "value")
        drawing = [self.sojourn, self.seed]
        drawing += [self.sliders["dwell_time"]] if "dwell_time" in self.sliders else []
        for widget in drawing:
            widget.param.watch(lambda _: self._draw(), "value")
        self.redraw.on_click(self._next)
        self.original.on_click(lambda _: self.choose(None))

    def settings(self) -> Settings:
        """The values that were moved and the choices."""
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
        """The value of a parameter."""
        return float(self.sliders[name].value) * self.ranges[name].scale

    def choose(self, signal: DrawnSignal | GivenSignal | None) -> None:
        """Take another signal."""
        self.signal = signal
        self._changed()

    def widgets(self, group: str) -> list[Any]:
        """The widgets under a heading."""
        if group == "Switching" and self._ruled:
            return [pmui.Typography("The state decides the mode, by the rule of the file.")]
        sliders = [self.sliders[name] for name, one in self.ranges.items() if one.group == group]
        if group == "Switching":
            row = pmui.Row(self.redraw, self.original, sizing_mode="stretch_width", margin=0)
            return [*sliders, self.sojourn, self.seed, row]
        return [*sliders, self.step] if group == "Run" else sliders

    def _draw(self) -> None:
        self.choose(DrawnSignal(int(self.seed.value or 0)))

    def _next(self, _: Any) -> None:
        if isinstance(self.signal, DrawnSignal):
            self.seed.value = int(self.seed.value or 0) + 1
        else:
            self._draw()


def download_button(
    label: str, filename: str, make: Callable[[], bytes], **look: Any
) -> pmui.FileDownload:
    """A button that downloads the bytes from `make`."""
    button = pmui.FileDownload(
        label=label, filename=filename, callback=lambda: io.BytesIO(make()), margin=4, **look
    )
    button.variant = "outlined"  # as an argument Panel warns of it
    return button


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
