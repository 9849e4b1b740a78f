"""Figures of the audit: how often each claim holds, and the two trends."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deadtime.base.errors import ArgumentError
from deadtime.base.figure_files import new_figure
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH
from deadtime.reports.audit import Claim, Sweep
from deadtime.scenarios.paired_statistics import Proportion

VERDICTS = {
    "holds": (COLOURS[2], "o"),
    "holds on most signals": (COLOURS[0], "s"),
    "not decided": (COLOURS[4], "D"),
    "does not hold on most signals": (COLOURS[1], "v"),
}


def plot_claims(claims: Sequence[Claim]) -> Figure:
    """On how many random signals each claim holds, and whether one run shows it.

    Claims about no signal are left out.
    """
    shown = [claim for claim in claims if claim.proportion is not None][::-1]
    with rc_context(STYLE):
        figure = new_figure(1.35 * WIDTH, 0.9 + 0.3 * len(shown))
        axes = figure.subplots()
        axes.axvline(50.0, color="#888888", linewidth=0.8)
        for row, claim in enumerate(shown):
            assert claim.proportion is not None
            _interval(axes, row, claim.proportion, *VERDICTS[claim.verdict])
            run = {True: "yes", False: "no", None: "–"}[claim.holds_in_run]
            axes.text(
                1.06, row, run, transform=axes.get_yaxis_transform(), ha="center", va="center"
            )
        axes.text(
            1.06, len(shown) - 0.2, "one run", transform=axes.get_yaxis_transform(), ha="center"
        )
        axes.set_yticks(range(len(shown)), [claim.title for claim in shown])
        axes.set_ylim(-0.6, len(shown) - 0.4)
        axes.set_xlim(-2.0, 102.0)
        axes.set_xlabel("random signals on which it holds (%), with 95 % interval")
        axes.grid(False, axis="y")
        for verdict, (colour, marker) in VERDICTS.items():
            axes.plot([], [], marker, color=colour, markersize=5.0, label=verdict)
        figure.legend(loc="outside lower center", ncols=2, handletextpad=0.2)
    return figure


def _interval(axes: Axes, row: float, proportion: Proportion, colour: str, marker: str) -> None:
    low, high = proportion.interval
    axes.plot([100 * low, 100 * high], [row, row], color=colour, linewidth=2.0)
    axes.plot([100 * proportion.fraction], [row], marker, color=colour, markersize=5.0)


def plot_dwell_times(claims: Sequence[Claim]) -> Figure:
    """Law (2) against (80) as the dwell time changes: how often, and by how much."""
    sweep = _sweep(claims, "shorter-dwell-gains")
    with rc_context(STYLE):
        figure = new_figure(WIDTH, 3.6)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.6, 1.0))
        (shares,) = sweep.shares.values()
        upper.axhline(50.0, color="#888888", linewidth=0.8)
        _line(upper, np.array(sweep.values), shares, COLOURS[0], "o", "")
        upper.set_ylim(0.0, 100.0)
        upper.set_ylabel("signals with smaller\n∫|x|² under (2), %")
        upper.set_title("The averaged law (2) against the mean law (80)")
        lower.axhline(1.0, color="#888888", linewidth=0.8)
        lower.plot(sweep.values, sweep.ratio, "s-", color=COLOURS[1], markersize=4.0)
        lower.set_ylabel("median ∫|x|²,\n(2) over (80)")
        lower.set_ylim(min(0.95, *sweep.ratio) - 0.03, max(1.05, *sweep.ratio) + 0.03)
        lower.set_xscale("log")
        lower.set_xticks(sweep.values, sweep.ticks)
        lower.minorticks_off()
        lower.set_xlabel(sweep.parameter)
        figure.align_ylabels()
    return figure


def plot_distances(claims: Sequence[Claim]) -> Figure:
    """How often laws (2) and (80) stabilise as the modes move apart."""
    sweep = _sweep(claims, "distance")
    values = np.array(sweep.values)
    with rc_context(STYLE):
        figure = new_figure(WIDTH, 3.1)
        axes = figure.subplots()
        for i, (name, shares) in enumerate(sweep.shares.items()):
            _line(axes, values + 0.012 * (2 * i - 1), shares, COLOURS[i], "os"[i % 2], name)
        axes.set_ylim(-3.0, 103.0)
        axes.set_ylabel("signals stabilised, %")
        axes.set_xticks(values, sweep.ticks)
        axes.set_xlabel(sweep.parameter)
        figure.legend(loc="outside lower center", ncols=2)
    return figure


def _line(
    axes: Axes, x: np.ndarray, shares: Sequence[Proportion], colour: str, marker: str, name: str
) -> None:
    """Percentages with their confidence intervals."""
    middle = np.array([100.0 * share.fraction for share in shares])
    low, high = 100.0 * np.array([share.interval for share in shares]).T
    errors = np.maximum([middle - low, high - middle], 0.0)
    axes.errorbar(
        x, middle, errors, fmt=f"{marker}-", color=colour, markersize=4.0, capsize=3.0, label=name
    )


def _sweep(claims: Sequence[Claim], key: str) -> Sweep:
    for claim in claims:
        if claim.key == key and claim.sweep is not None:
            return claim.sweep
    raise ArgumentError(
        f"claims must contain the claim {key!r}, as the list from deadtime.reports.audit does."
    )
