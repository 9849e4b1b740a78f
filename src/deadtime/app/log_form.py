"""The form in which a person says what the columns of a log are, and what is looked for."""

from __future__ import annotations

from typing import Any

import panel_material_ui as pmui

from deadtime.app.page_run import MOST_MODES
from deadtime.app.uploaded_log import Columns, LogRequest
from deadtime.base.errors import ArgumentError

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
        """Offer the columns of a log, and choose those that names tell."""
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

    def asked(self) -> LogRequest:
        """What the form asks.

        Raises
        ------
        ArgumentError
            If something was not said, or cannot be.
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
        """What is asked of modes depends on whether there are several, and who knows of them."""
        logged, hidden = bool(self._of(MODE)), self._hidden()
        self.modes.visible = not logged
        self.least.visible = self.most.visible = hidden
        self.samples.visible = self.apart.visible = logged or hidden
