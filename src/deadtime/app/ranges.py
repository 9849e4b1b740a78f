"""What can be moved on a page, and how far: the parameters, their ranges and where they start."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from deadtime.app.assumed_switching import dwell_time_of
from deadtime.app.delays import delay_error, longest_delay, moved_delays
from deadtime.app.documents import Document
from deadtime.app.page_run import MOST_SAMPLES, MOST_TAPS
from deadtime.base.wording import subscript
from deadtime.problems.imperfection_registry import SWEPT, Slider

FROM_FILE = "as in the file"
IDEAL = "ideal"
_STEPS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)


@dataclass(frozen=True)
class Range:
    """A number that can be moved (immutable).

    Attributes
    ----------
    name : str
        In `Settings.values`.
    label : str
        With its unit.
    group : str
        The heading that it stands under.
    value, low, high, step : float
        Where it starts, and between what it moves.
    scale : float
        What a number on the page is multiplied with to be a value: 0.01 for per cent.
    """

    name: str
    label: str
    group: str
    value: float
    low: float
    high: float
    step: float
    scale: float = 1.0


def ranges_of(document: Document) -> list[Range]:
    """The numbers of a problem that can be moved, in the order of the page."""
    draft = document.draft
    run = draft["run"]
    many = len(draft["plant"]["A"]) > 1
    dwell_time = dwell_time_of(draft)
    horizon = float(run["horizon"])
    ranges = [_wide(name, label, "Plant", value) for name, label, value in moved_delays(draft)]
    if many:
        ranges.append(Range("distance", "Mode distance α", "Plant", 1.0, 0.0, 2.0, 0.01))
        ranges.append(_wide("dwell_time", "Dwell time τ_d (s)", "Switching", dwell_time, 5.0))
    names = draft["plant"].get("states") or []
    for i, x in enumerate(run["x0"]):
        most = _nice(5.0 * max(abs(float(v)) for v in run["x0"]) or 5.0)
        name = names[i] if names else f"x{subscript(i + 1)}"
        label = f"{name} at t = 0"
        ranges.append(Range(f"run.x0.{i}", label, "Run", float(x), -most, most, most / 100.0))
    size = max(abs(float(x)) for x in run["x0"]) or 1.0
    group = "Imperfections"
    return [
        *ranges,
        _wide("horizon", "Horizon T (s)", "Run", horizon),
        Range(
            "delay_error",
            "True delay off by (%)",
            group,
            100.0 * delay_error(draft),
            -20.0,
            20.0,
            0.1,
            0.01,
        ),
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
    """From none of an imperfection to twice the file's, or what is much for a state."""
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
