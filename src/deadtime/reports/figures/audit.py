"""The figure of the audit: on how many signals each claim holds."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deadtime.base.figure_files import new_figure
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH
from deadtime.reports.audit import Claim
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
