"""Scales: colours for figures of any size, and round numbers beside them."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LogNorm, Normalize

from deadtime.reports.figures.sweeps.maps import Scale

WIDE = 10.0  # largest over least figure from which colours follow the logarithm
_NARROW = 1.5  # the colours of positive figures span this factor at least
_FAR = 1e3  # figures so many times above or below the median share their colour


def scale_of(values: np.ndarray, label: str, colours: str) -> Scale:
    """Colours for any figures: along the logarithm where they are positive and differ widely."""
    finite = values[np.isfinite(values)]
    finite = finite if finite.size else np.array([1.0])
    low, high = float(finite.min()), float(finite.max())
    if low > 0.0 and high > WIDE * low:
        middle = float(np.exp(np.median(np.log(finite))))
        ends = max(low, middle / _FAR), min(high, middle * _FAR)
        norm: Normalize = LogNorm(*ends)
        ticks = log_ticks(*ends)
    else:
        # Figures that hardly differ should not look as if they did.
        ends = low, max(high, _NARROW * low if low > 0.0 else low + 1e-9)
        norm = Normalize(*ends)
        ticks = linear_ticks(*ends)
    below, above = bool((values < ends[0]).any()), bool((values > ends[1]).any())
    extend = {(True, True): "both", (True, False): "min", (False, True): "max"}
    return Scale(norm, colours, extend.get((below, above), "neither"), label, ticks)


def log_ticks(low: float, high: float) -> dict[float, str]:
    """At most 7 round numbers from low to high: 1, 2, 5 and so on where they fit."""
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    for steps in ((1.0, 2.0, 5.0), (1.0, 3.0), (1.0,)):
        ticks = [step * 10.0**power for power in powers for step in steps]
        ticks = [tick for tick in ticks if low <= tick <= high]
        if len(ticks) <= 7:
            break
    return {tick: f"{tick:g}" for tick in ticks[:: -(-len(ticks) // 7) or 1]}


def linear_ticks(low: float, high: float) -> dict[float, str]:
    """About 5 round numbers from low to high."""
    from matplotlib.ticker import MaxNLocator

    ticks = MaxNLocator(5).tick_values(low, high)
    return {float(tick): f"{tick:.6g}".replace("-", "−") for tick in ticks if low <= tick <= high}
