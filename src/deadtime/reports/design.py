"""A design for margin as a chart of what a wider margin costs, tables, JSON and sections."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from deadtime.base.figure_files import new_figure
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH, plain
from deadtime.base.json_records import plain as json_values, record
from deadtime.base.wording import as_rate, compact
from deadtime.plant import SwitchedSystem
from deadtime.plant.weight import PLAIN, record_of, text_of
from deadtime.reports.figures.sweeps.panels import round_ticks
from deadtime.synthesis import Design, TradeOff
from deadtime.synthesis.design_result import DECAY, LIMIT, percent

STEP = "step, s"
HEADINGS = (
    "design", "delay margin", "cost", "decay, 1/s", "peak |u|", "filter, s", STEP, "unmet"
)  # fmt: skip
LIMIT_HEADINGS = ("mode", "attainable margin", "upper bound", "unstable poles, 1/s")
_OF_SOURCE = ("size", "probability"), ("process", "measurement", "probability")
_FIGURES = ("margin", "cost", "decay_rate", "input_peak")


def design_rows(design: Design) -> list[tuple[str, ...]]:
    """The plain design, the trade-off, and the one chosen; what each misses of the request."""
    others = [point for point in design.points if point.law is not design.plain.law]
    rows = []
    for point in (design.plain, *others):
        names = ["plain"] if point is design.plain else []
        names += ["chosen"] if point.law is design.law and design.points else []
        missed = ["|u|" if name == LIMIT else name for name in design.missed(point)]
        rows.append(_row(", ".join(names), point, ", ".join(missed) or "–"))
    return rows


def _row(name: str, point: TradeOff, missed: str) -> tuple[str, ...]:
    T = point.time_constant
    slowest = "–" if T is None else f"{np.abs(np.linalg.eigvals(T)).max():.3g}"
    decay = f"{point.decay_rate:.3g}" if point.decay_rate > 0.0 else "–"
    step = f"{point.step:g}"
    known = [] if point.input_peak is None else point.input_peak.tolist()
    peaks = ", ".join("–" if math.isinf(peak) else compact(peak) for peak in known)
    return name, percent(point.margin), compact(point.cost), decay, peaks, slowest, step, missed


def limit_rows(design: Design, modes: Sequence[str]) -> list[tuple[str, ...]]:
    """Delay margins that any linear controller can have, mode by mode."""
    return [
        (
            name,
            percent(limit.reached),
            percent(limit.most, up=True),
            ", ".join(_pole(pole) for pole in limit.poles) or "none",
        )
        for name, limit in zip(modes, design.limits, strict=True)
    ]


def _pole(pole: complex) -> str:
    text = as_rate(pole.real)
    return text if pole.imag == 0.0 else f"{text}{as_rate(pole.imag)}j"


def problem_sections(
    design: Design, kind: str, plant: SwitchedSystem, gains: np.ndarray, mode: int | None = None
) -> str:
    """The design as sections [gains], [[law]] and a step, for the problem file of a plant.

    With a mode the design is that mode's alone: the other modes keep their gains.
    """
    lines = [f"# {sentence}." for sentence in design.message.rstrip(".").split(". ")]
    lines.append("# Put these in place of [gains] and of the [[law]] sections of the problem file.")
    K = np.array(gains)
    K[slice(None) if mode is None else [mode]] = design.gains
    lines += ["", "[gains]", f"K = {K.tolist()}"]
    if np.linalg.eigvals(plant.A + plant.B @ K).real.max() >= 0.0:
        lines.append("allow_unstable = true    # the filter is part of what stabilises")
    lines += ["", "[[law]]", f'kind = "{kind}"' if mode is None else 'kind = "single"']
    lines += [] if mode is None else [f"mode = {mode}"]
    T = design.time_constant
    if T is not None:
        lines.append(f"low_pass = {T.item() if T.size == 1 else T.tolist()}")
    return "\n".join([*lines, "", f"# In [run]: step = {design.step!r}", ""])


def design_record(design: Design) -> dict[str, Any]:
    """The design for JSON; None for what is infinite."""
    points = [
        record(point, *_FIGURES, "step")
        | {"chosen": point.law is design.law, "missed": design.missed(point)}
        for point in design.points
    ]
    return json_values({
        **record(design, "asked", "decay_asked", "input_limit", "reached"),
        "initial": record(design.initial, "kind", *_OF_SOURCE[design.initial.kind == "noise"]),
        "delay_margin": record(design.margin, "relative", "lower", "upper"),
        "growth_at_both_ends": design.growth,
        **record(design, "gains", "time_constant", "step", "cost"),
        **record_of(design.weight),
        **record(design, "decay_rate", "input_peak"),
        "plain": record(design.plain, *_FIGURES),
        "limits": [record(limit, "reached", "most") for limit in design.limits],
        "points": points,
        **record(design, "evaluated", "message"),
    })  # fmt: skip


REACHED, BEYOND = "#e4f2e4", "#f3c3a3"
_RING: dict[str, Any] = {
    "ls": "", "marker": "o", "mfc": "none", "mec": COLOURS[3], "mew": 1.4, "markersize": 10.0
}  # fmt: skip


def plot_designs(designs: Mapping[str, Design], columns: int = 2) -> Figure:
    """Cost over delay margin, a panel per design: the trade-off, the answer, and the limits.

    The cost is relative to the cheapest design that was found, on a logarithmic axis; below it is
    the largest :math:`|u|` of every design, and its limit dashed where one is asked for; with
    limits of several inputs, the largest of them beside its limit. The chosen design is ringed;
    hollow marks decay slower, or need larger inputs, than was asked. Green is what some linear
    controller of each mode alone reaches; what none reaches is shaded red. The legend lists what is
    drawn.

    Parameters
    ----------
    designs : mapping
        From a panel's title to a `Design`.
    columns : int
        Panels beside each other.
    """
    columns = min(columns, len(designs))
    rows = -(-len(designs) // columns)
    weights = dict.fromkeys(text_of(one.weight) for one in designs.values())
    with rc_context(STYLE):
        figure = new_figure(1.5 * WIDTH if columns > 1 else WIDTH, 0.8 + 3.4 * rows)
        heights = [2.1, 1.0] * rows
        panels = figure.subplots(2 * rows, columns, squeeze=False, height_ratios=heights)
        costs, inputs = panels[::2], panels[1::2]
        for panel, below, (title, design) in zip(
            costs.flat, inputs.flat, designs.items(), strict=False
        ):
            _panel(panel, design)
            _inputs_panel(below, design)
            panel.set_title(plain(title))
        for spare in (*costs.flat[len(designs) :], *inputs.flat[len(designs) :]):
            spare.set_axis_off()
        for panel in costs[:, 0]:
            panel.set_ylabel("cost / cheapest found")
        figure.legend(
            handles=_keys(designs),
            loc="outside lower center",
            ncols=3 if columns > 1 else 2,
            handlelength=1.6,
            title=None if [*weights] == [PLAIN] else plain(f"cost: {'; '.join(weights)}"),
        )
    return figure


def _keys(designs: Mapping[str, Design]) -> list[Line2D | Patch]:
    """The legend: every kind of mark that some panel has."""
    drawn = [(one, point) for one in designs.values() for point in _points_to_draw(one)]
    points = [point for one, point in drawn if point.law is not one.plain.law]
    ones, dot = designs.values(), {"ls": "", "markersize": 5.0}
    blue, green = {"color": COLOURS[0]}, {"color": COLOURS[2]}

    def key(there: bool, label: str, **look: Any) -> list[Line2D]:
        return [Line2D([], [], label=label, **look)] * there

    alone = any(point.time_constant is None for point in points)
    filtered = any(point.time_constant is not None for point in points)
    usual = any(math.isfinite(one.plain.cost) for one in ones)
    short = any(_falls_short(one, point) for one, point in drawn)
    endless = any(math.isinf(point.margin) for _, point in drawn)
    limited, slow = any(one.input_limit is not None for one in ones), "slower than asked"
    if limited:
        slow = "slow, or |u| too large" if any(one.decay_asked for one in ones) else "|u| too large"
    hollow = f"hollow: {slow}"
    wishes = ["margin"] * any(one.asked for one in ones) + ["limit"] * limited
    beyond = any(100.0 * min(each.most for each in one.limits) < _right(one) for one in ones)
    return [
        *key(any(len(_front(one)) > 1 for one in ones), "least cost for a margin", lw=1.0, **blue),
        *key(alone, "gains alone", marker="o", **blue, **dot),
        *key(filtered, "gains and a filter", marker="s", **green, **dot),
        *key(usual, "plain design", color=COLOURS[6], marker="X", **dot),
        *key(any(point.law is one.law for one, point in drawn), "chosen", **_RING),
        *key(short, hollow, color="grey", mfc="none", marker="o", **dot),
        *key(endless, "stable whatever the delay", color="grey", marker=">", **dot),
        *key(bool(wishes), f"{' and '.join(wishes)} asked for", color=COLOURS[1], ls="--", lw=1.0),
        Patch(facecolor=REACHED, label="within reach, by mode"),
        *[Patch(facecolor=BEYOND, label="beyond reach in some mode")] * beyond,
    ]


def _panel(panel: Axes, design: Design) -> None:
    drawn = _points_to_draw(design)
    cheapest = min((point.cost for point in drawn), default=math.nan)
    reached = min(limit.reached for limit in design.limits)
    most, right = min(limit.most for limit in design.limits), _right(design)
    panel.axvspan(0.0, min(100.0 * reached, right), color=REACHED, linewidth=0.0, zorder=0)
    if 100.0 * most < right:
        panel.axvspan(100.0 * most, right, color=BEYOND, linewidth=0.0, zorder=0)
    if design.asked:
        panel.axvline(100.0 * design.asked, color=COLOURS[1], linestyle="--", linewidth=1.0)
    front = [point for point in _front(design) if math.isfinite(point.margin)]
    x, y = _coordinates(front, cheapest, right)
    panel.plot(x, y, color=COLOURS[0], linewidth=1.0)
    for point in drawn:
        _mark(panel, design, point, *_coordinates([point], cheapest, right))
    panel.set_yscale("log")
    top = max([2.0, *_coordinates(drawn, cheapest, right)[1].tolist()])
    panel.set_ylim(0.85, 1.4 * top)
    panel.set_xlim(0.0, right)
    panel.tick_params(labelbottom=False)
    ticks = [tick for tick in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0) if tick <= 1.4 * top]
    panel.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    panel.minorticks_off()


def _inputs_panel(panel: Axes, design: Design) -> None:
    """The largest |u| over the delay margin, of the same designs."""
    right, limit = _right(design), design.input_limit
    relative = limit is not None and limit.size > 1
    panel.set_ylabel("peak |u| / limit" if relative else "peak |u|")
    found = [
        (point, _largest(point, limit if relative else None)) for point in _points_to_draw(design)
    ]
    found = [(point, peak) for point, peak in found if math.isfinite(peak)]
    for point, peak in found:
        _mark(panel, design, point, _coordinates([point], 1.0, right)[0], np.array([peak]))
    levels = [peak for _, peak in found if peak > 0.0]
    if limit is not None:
        levels.append(1.0 if relative else limit.item())
        panel.axhline(levels[-1], color=COLOURS[1], linestyle="--", linewidth=1.0)
    if levels:
        panel.set_yscale("log")
        low, high = min(levels) / 1.25, 1.25 * max(levels)
        panel.set_ylim(low, high)
        round_ticks(panel.yaxis, low, high)
    panel.set_xlim(0.0, right)
    shortest = "D" if design.law.plant.has_one_delay else "the shortest delay"
    panel.set_xlabel(f"delay margin (% of {shortest})")


def _largest(point: TradeOff, limit: np.ndarray | None) -> float:
    """Of its inputs, or of what each is beside its limit; ∞ where a mode is unstable."""
    if point.input_peak is None:
        return math.inf
    return float((point.input_peak / (1.0 if limit is None else limit)).max())


def _mark(panel: Axes, design: Design, point: TradeOff, x: np.ndarray, y: np.ndarray) -> None:
    """One design: what it is by its shape, hollow where it is too slow, ringed where chosen."""
    if point.law is design.plain.law:
        shape, colour, size = "X", COLOURS[6], 6.0
    elif point.time_constant is None:
        shape, colour, size = "o", COLOURS[0], 4.0
    else:
        shape, colour, size = "s", COLOURS[2], 4.0
    inside = "none" if _falls_short(design, point) else colour
    panel.plot(x, y, shape, color=colour, mfc=inside, markersize=size, clip_on=False, zorder=3)
    if point.law is design.law:
        panel.plot(x, y, clip_on=False, zorder=4, **_RING)
    if math.isinf(point.margin):
        edge = panel.get_yaxis_transform()
        panel.plot([1.03], y, ">", color="grey", markersize=5.0, clip_on=False, transform=edge)


def _falls_short(design: Design, point: TradeOff) -> bool:
    """Of what the axes do not show."""
    return bool({DECAY, LIMIT} & set(design.missed(point)))


def _points_to_draw(design: Design) -> list[TradeOff]:
    """The plain design, where it is stable, and the others; the plain one once."""
    plain = [design.plain] if math.isfinite(design.plain.cost) else []
    return [*plain, *(point for point in design.points if point.law is not design.plain.law)]


def _front(design: Design) -> list[TradeOff]:
    """The points of which no other is both wider and cheaper, by growing margin."""
    points = design.points
    return [
        one
        for one in points
        if not any(
            other.margin >= one.margin and other.cost < one.cost and other is not one
            for other in points
        )
    ]


def _right(design: Design) -> float:
    """Where the axis of margins ends, percent."""
    margins = [point.margin for point in _points_to_draw(design) if math.isfinite(point.margin)]
    # Where nothing is asked and nothing limits it: in the order of a delay.
    widest = max([design.asked, *margins]) or 1.0
    most = min(limit.most for limit in design.limits)
    return 100.0 * (1.08 * most if widest < most < 3.0 * widest else 1.15 * widest)


def _coordinates(
    points: list[TradeOff], cheapest: float, right: float
) -> tuple[np.ndarray, np.ndarray]:
    """Margins in percent, at the edge where they have no end, and relative costs."""
    margins = np.array([min(100.0 * point.margin, right) for point in points])
    return margins, np.array([point.cost / cheapest for point in points])
