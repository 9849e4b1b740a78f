"""Stability chart: a margin per law and dwell time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import as_floats, reporter
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.margins.stability import Loop, StabilityMargin, stability_margin


@dataclass(frozen=True, eq=False)
class StabilityChart(Frozen):
    """Margins over the dwell time, for several laws (immutable).

    Attributes
    ----------
    bounds : (float, float)
        The values that were searched between.
    dwell_times : (times,) array
        Rising, seconds.
    margins : mapping
        From a law's name to its margins, one per dwell time: None where the loop could not be
        certified even at the low bound.
    reasons : mapping
        From (law, dwell time) to the reason, where a margin is None.
    """

    bounds: tuple[float, float]
    dwell_times: Float[np.ndarray, " times"]
    margins: Mapping[str, tuple[StabilityMargin | None, ...]]
    reasons: Mapping[tuple[str, float], str]

    def certified(self, law: str) -> Float[np.ndarray, " times"]:
        """The largest certified value per dwell time; NaN where nothing is certified."""
        margins = self.margins[law]
        return np.array([np.nan if margin is None else margin.certified for margin in margins])

    def refuted(self, law: str) -> Float[np.ndarray, " times"]:
        """The smallest refuted value per dwell time; NaN where nothing is refuted."""
        values = [None if margin is None else margin.refuted for margin in self.margins[law]]
        return np.array([np.nan if value is None else value for value in values])


def stability_chart(
    laws: Mapping[str, Callable[[float, float], Loop]],
    bounds: Sequence[float],
    dwell_times: Sequence[float],
    step: float = 0.01,
    ratio: float = 1.02,
    progress: Callable[[str], None] | None = None,
) -> StabilityChart:
    """A stability margin for each law at each dwell time, which `plot_chart` draws.

    Parameters
    ----------
    laws : mapping
        From a name to a function of (value, dwell time) that returns (plant, law); laws that
        know nothing of the dwell time ignore the second.
    bounds, step, ratio
        As `stability_margin` takes them.
    dwell_times : sequence of float
        Seconds, in any order.
    progress : callable, optional
        Called with a few words before each margin, len(laws)·len(dwell_times) times.

    Raises
    ------
    ArgumentError
        If there is no law or no dwell time.
    """
    progress = reporter("progress", progress)
    times = np.unique(as_floats("dwell_times", dwell_times, "(T,) seconds"))
    if not laws or not times.size:
        raise ArgumentError("laws and dwell_times must hold at least one entry each.")
    margins: dict[str, tuple[StabilityMargin | None, ...]] = {}
    reasons: dict[tuple[str, float], str] = {}
    for name, loop in laws.items():
        row: list[StabilityMargin | None] = []
        for time in times.tolist():
            progress(f"{name}, dwell time {time:g} s")
            try:
                problem = _at(loop, time)
                row.append(stability_margin(problem, bounds, time, step, ratio))
            except ArgumentError as error:
                row.append(None)
                reasons[name, time] = str(error)
        margins[name] = tuple(row)
    times.flags.writeable = False
    return StabilityChart((bounds[0], bounds[1]), times, margins, reasons)


def _at(loop: Callable[[float, float], Loop], time: float) -> Callable[[float], Loop]:
    return lambda value: loop(value, time)
