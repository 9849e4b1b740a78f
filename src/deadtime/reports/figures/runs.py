"""Several laws in one figure: curves, norms and outputs over time, and the switching signal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from deadtime.base.errors import ArgumentError
from deadtime.base.figure_files import Width, legend_columns, new_figure, style_of
from deadtime.base.figure_style import COLOURS, LINES, WIDTH, plain, visible
from deadtime.base.wording import as_rate, input_names, numbered, subscript
from deadtime.problems import Problem
from deadtime.problems.comparison import Comparison
from deadtime.reports.figures.colours import Look, looks_of
from deadtime.simulation import Trajectory
from deadtime.simulation.run_figure import REFERENCE, mode_strip, references, signal_steps
from deadtime.switching import SwitchingSignal

_FAR = 5.0  # a run that goes so many times as far as the others leaves the frame


def plot_laws(
    runs: Mapping[str, Trajectory],
    states: Sequence[str] | None = None,
    modes: Sequence[str] | None = None,
    title: str | None = None,
    laws: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    width: Width | None = None,
    tracked: Sequence[str] | None = None,
) -> Figure:
    """States, inputs, modes and mismatch of runs of one problem; a colour for each law.

    A reference is drawn beside the state that follows it, or beside an output of its own. Where no
    run has a mismatch, there is no panel of it.

    Parameters
    ----------
    runs : mapping
        Runs by the names of their laws, of one plant; at least one.
    states, modes, inputs, tracked : sequences of str
        Names for the axes, the last of what follows a reference; numbered by default.
    title : str
        Heads the figure.
    width : "column", "page" or float, optional
        Of the figure: 3.5 in, 7.16 in, or inches.
    laws : sequence of str
        All laws among which the colours are shared out, where other figures show more of them;
        those of the runs by default.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> runs = {name: problem.simulate(name) for name in ("averaged", "mean", "oracle")}
    >>> len(plot_laws(runs).axes)       # two states, an input, the modes, the mismatch
    5
    """
    longest = max(runs.values(), key=lambda run: run.time[-1])
    n, m, count = longest.states.shape[0], longest.inputs.shape[0], longest.plant.modes
    states = [f"x{subscript(i + 1)}" for i in range(n)] if states is None else states
    inputs = input_names(m) if inputs is None else inputs
    modes = [f"mode {i}" for i in range(count)] if modes is None else modes
    beside, others = references(longest)
    tracked = numbered("y", len(beside) + len(others)) if tracked is None else tracked
    curves = [
        _Curves(name, {law: run.states[i] for law, run in runs.items()}, beside.get(i))
        for i, name in enumerate(states)
    ]
    following = {law: y for law, run in runs.items() if (y := run.tracked) is not None}
    curves += [
        _Curves(tracked[i], {law: y[i] for law, y in following.items()}, reference)
        for i, _, reference in others
    ]
    curves += [
        _Curves(name, {law: run.inputs[i] for law, run in runs.items()}, held=True)
        for i, name in enumerate(inputs)
    ]
    wrong = {law: norm for law, run in runs.items() if (norm := mismatch_norm(run)) is not None}
    floor = mismatch_floor(list(runs.values()))
    below = [_Curves("|mismatch|", wrong, floor=floor)] if wrong else []
    heights = [1.0] * len(curves) + [0.35 + 0.15 * count] + [1.0] * len(below)
    looks = looks_of([*(laws or ()), *runs])
    columns = min(3 if max(map(len, runs)) < 18 else 2, len(runs))
    entries = len(runs) + bool(beside or others)
    with rc_context(style_of(width)):
        height = 0.5 + 0.2 * -(-entries // columns) + 1.15 * sum(heights)
        figure = new_figure(1.3 * WIDTH, height, width)
        panels: list[Axes] = [*figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)]
        strip = panels.pop(len(curves))
        for panel, one in zip(panels, [*curves, *below], strict=True):
            _panel(panel, one, runs, looks)
            if one.reference is not None:
                panel.plot(longest.time, one.reference, **REFERENCE)
        end = float(longest.time[-1]) or 1.0
        mode_strip(strip, *signal_steps(longest.signal, end), list(map(plain, modes)))
        (panels[-1] if below else strip).set_xlabel("time (s)")
        panels[0].set_xlim(0.0, end)
        figure.align_ylabels()
        handles = list(panels[0].get_lines()[: len(runs)])
        handles += [Line2D([], [], label="reference", **REFERENCE)] * bool(beside or others)
        columns = legend_columns(figure, runs, 3)
        figure.legend(handles=handles, loc="outside lower center", ncols=columns, handlelength=2.6)
        if title:
            panels[0].set_title(plain(title))
    return figure


class _Curves(NamedTuple):
    """The curves of a panel: a row of every law's run, and its reference."""

    label: str
    rows: Mapping[str, np.ndarray]
    reference: np.ndarray | None = None
    held: bool = False
    floor: float = 0.0


def _panel(
    panel: Axes, curves: _Curves, runs: Mapping[str, Trajectory], looks: Mapping[str, Look]
) -> None:
    for i, (law, values) in enumerate(curves.rows.items()):
        style = "steps-post" if curves.held and runs[law].record.held else "default"
        panel.plot(
            runs[law].time,
            values,
            linestyle=LINES[i % len(LINES)],
            drawstyle=style,
            color=looks[law].colour,
            label=plain(law),
        )
    panel.set_ylabel(plain(curves.label))
    panel.set_ylim(*frame(list(curves.rows.values()), curves.floor, curves.reference))


def mismatch_norm(run: Trajectory) -> np.ndarray | None:
    """|w| over a run; None where it is not defined."""
    return None if run.mismatch is None else np.linalg.norm(run.mismatch, axis=0)


def mismatch_floor(runs: Sequence[Trajectory]) -> float:
    """A mismatch that is nothing beside the inputs: it is drawn as nothing."""
    return 0.02 * frame([np.abs(run.inputs).max(axis=0) for run in runs])[1]


def frame(
    rows: Sequence[np.ndarray], floor: float = 0.0, reference: np.ndarray | None = None
) -> tuple[float, float]:
    """Limits that show every row, but for rows that go far beyond all others, and the reference.

    What is smaller than the floor counts as that large; values that are NaN are not drawn.

    Examples
    --------
    >>> low, high = frame([np.array([0.0, 1.0]), np.array([0.0, 2.0]), np.array([0.0, 1e9])])
    >>> 2.0 <= high < 11.0
    True
    """
    sizes = sorted(map(_size, rows))
    finite = [size for size in sizes if np.isfinite(size)]
    seen = [size for size in finite if size >= floor] or [floor or 1.0]
    most = seen[0]
    for size in seen[1:]:
        if size > _FAR * most > 0.0:
            break
        most = size
    shown = [row for row in rows if _size(row) <= most]
    shown += [] if reference is None else [reference]
    low = min((float(np.fmin.reduce(row, initial=0.0)) for row in shown), default=0.0)
    high = max((float(np.fmax.reduce(row, initial=0.0)) for row in shown), default=1.0)
    low, high = min(low, -0.05 * floor), max(high, floor)
    margin = 0.06 * (high - low) or 1.0
    return low - margin, high + margin


def _size(row: np.ndarray) -> float:
    return float(np.fmax.reduce(np.abs(row), initial=0.0))


def plot_signal(
    signal: SwitchingSignal, end: float, modes: Sequence[str], width: Width | None = None
) -> Figure:
    """The switching signal on [0, end]: the active mode in blue, switching instants in black."""
    times, visited = signal_steps(signal, end)
    with rc_context(style_of(width)):
        figure = new_figure(WIDTH, 1.0 + 0.3 * len(modes), width)
        axes = figure.subplots()
        axes.hlines(visited[:-1], times[:-1], times[1:], color=COLOURS[0], linewidth=2.5)
        axes.vlines(times[1:-1], -0.3, len(modes) - 0.7, color="black", linewidth=0.5)
        axes.set_yticks(range(len(modes)), list(map(plain, modes)))
        axes.set_ylim(-0.35, len(modes) - 0.65)
        axes.set_xlim(0.0, end)
        axes.set_xlabel("time (s)")
        axes.grid(False)
    return figure


def plot_window(
    signal: SwitchingSignal,
    delay: float,
    end: float,
    modes: Sequence[str],
    width: Width | None = None,
) -> Figure:
    """Switching instants and modes in [t, t + D], for the t in [0, end] that sees most switches."""
    switches = signal.times[1:][signal.times[1:] <= end]
    t = 0.0
    if switches.size:
        after = np.searchsorted(switches, switches + 0.9 * delay)
        first = int(np.argmax(after - np.arange(switches.size)))
        middle = (switches[first] + switches[after[first] - 1]) / 2.0
        t = max(0.0, float(middle) - delay / 2.0)
    cuts = np.array([t, *switches[(switches > t) & (switches < t + delay)], t + delay])
    with rc_context(style_of(width)):
        figure = new_figure(WIDTH, 1.3 + 0.3 * len(modes), width)
        axes = figure.subplots()
        times, visited = signal_steps(signal, t + 1.15 * delay)
        axes.step(times, visited, where="post", color=COLOURS[0], linewidth=1.8)
        axes.axvspan(t, t + delay, color=COLOURS[0], alpha=0.08, linewidth=0)
        axes.vlines(cuts, -0.6, len(modes) - 0.5, color="black", linewidth=0.6, linestyle="--")
        for i, cut in enumerate(cuts):
            name = "$t$" if i == 0 else "$t+D$" if i == cuts.size - 1 else f"$t+s_{i}$"
            side = {0: "right", cuts.size - 1: "left"}.get(i, "center")
            axes.text(cut, len(modes) - 0.42, name, ha=side, va="bottom", fontsize=8)
        for i, middle in enumerate((cuts[:-1] + cuts[1:]) / 2.0):
            axes.text(middle, -0.58, f"$m_{i + 1}$", ha="center", va="bottom", fontsize=8)
        axes.set_yticks(range(len(modes)), list(map(plain, modes)))
        axes.set_ylim(-0.65, len(modes) - 0.1)
        axes.set_xlim(max(0.0, t - 0.15 * delay), t + 1.2 * delay)
        axes.set_xlabel("time (s)")
        axes.grid(False)
    return figure


def plot_norms(
    runs: Mapping[str, Trajectory], title: str | None = None, width: Width | None = None
) -> Figure:
    """Norms of the state of several runs; a run far above the others leaves the frame.

    More than five are shared out among panels with the same axes.
    """
    norms = {name: np.linalg.norm(run.states, axis=0) for name, run in runs.items()}
    tops = sorted(float(norm.max()) for norm in norms.values())
    bottom = min(float(norm[norm > 0.0].min(initial=1.0)) for norm in norms.values())
    top = tops[-1] if len(tops) < 2 or tops[-1] < 1e3 * tops[-2] else 30.0 * tops[-2]
    ends = max(bottom / 2.0, 1e-9 * top), 2.0 * max(top, bottom)
    rows = {name: visible(norm) for name, norm in norms.items()}
    with rc_context(style_of(width)):
        return _draw_groups(runs, [_Curves("|x|", rows)], [ends], "log", title, width)


def _draw_groups(
    runs: Mapping[str, Trajectory],
    curves: Sequence[_Curves],
    ends: Sequence[tuple[float, float]],
    scale: str,
    title: str | None,
    width: Width | None,
) -> Figure:
    """Curves of all laws, at most five to a panel with a legend above it."""
    longest = max(runs.values(), key=lambda run: run.time[-1])
    looks, groups = looks_of(list(runs)), _shared_out(list(runs))
    rows = [(*one, group) for one in zip(curves, ends, strict=True) for group in groups]
    height = 0.9 + (2.4 if len(rows) == 1 else 1.8) * len(rows)
    figure = new_figure(WIDTH, height, width)
    columns = legend_columns(figure, runs, 3, beside=0.65)
    panels = figure.subplots(len(rows), sharex=True, squeeze=False)[:, 0]
    for panel, (one, limits, group) in zip(panels, rows, strict=True):
        panel.set_yscale(scale)
        if one.reference is not None:
            look: Any = {"color": COLOURS[6], "drawstyle": "steps-post", "linewidth": 1.0}
            panel.plot(longest.time, one.reference, linestyle=":", label="reference", **look)
        for line, name in zip(LINES, group, strict=False):
            look = {"linestyle": line, "color": looks[name].colour, "label": plain(name)}
            panel.plot(runs[name].time, one.rows[name], **look)
        panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, handlelength=2.6)
        panel.set_ylim(*limits)
        panel.set_ylabel(plain(one.label))
    panels[0].set_xlim(0.0, longest.time[-1])
    panels[-1].set_xlabel("time (s)")
    if title:
        figure.suptitle(plain(title), fontsize=9.5, x=0.02, ha="left")
    return figure


def plot_tracking(
    runs: Mapping[str, Trajectory],
    outputs: Sequence[str] = (),
    title: str | None = None,
    width: Width | None = None,
) -> Figure:
    """Outputs that follow a reference under several laws, beside the reference: a panel for each.

    More than five laws are shared out among panels; a run far above the others leaves the frame.

    Parameters
    ----------
    runs : mapping
        Runs that follow references, by the names of their laws.
    outputs : sequence of str, optional
        Names of what follows, with units; numbered by default.
    """
    tracked = {name: y for name, run in runs.items() if (y := run.tracked) is not None}
    count = min(map(len, tracked.values())) if len(tracked) == len(runs) else 0
    if count == 0:
        raise ArgumentError("runs must all follow a reference: draw others by their norms.")
    longest = max(runs.values(), key=lambda run: run.time[-1])
    assert longest.reference is not None
    curves = [
        _Curves(name, {law: y[i] for law, y in tracked.items()}, longest.reference[i])
        for i, name in enumerate((outputs or numbered("y", count))[:count])
    ]
    ends = [_tracking_frame(runs, i) for i in range(count)]
    with rc_context(style_of(width)):
        return _draw_groups(runs, curves, ends, "linear", title, width)


def _tracking_frame(runs: Mapping[str, Trajectory], output: int) -> tuple[float, float]:
    """Ends of the axis of an output: all of it, but for what is far from its reference."""
    low, high = np.inf, -np.inf
    for run in runs.values():
        assert run.tracked is not None
        assert run.reference is not None
        y, r = run.tracked[output], run.reference[output]
        far = 3.0 * max(float(np.ptp(r)), float(np.abs(r).max()), float(abs(r[0] - y[0]))) or np.inf
        low = min(low, float(r.min()), max(float(y.min()), float(r.min()) - far))
        high = max(high, float(r.max()), min(float(y.max()), float(r.max()) + far))
    air = 0.06 * (high - low) or 1.0
    return low - air, high + air


def _shared_out(names: Sequence[str]) -> list[Sequence[str]]:
    """Groups of at most five, as even as can be.

    Examples
    --------
    >>> _shared_out("abcdef")
    ['abc', 'def']
    """
    count = -(-len(names) // len(LINES))
    size = -(-len(names) // count)
    return [names[i : i + size] for i in range(0, len(names), size)]


def all_laws(result: Comparison, width: Width | None = None) -> tuple[str, Figure]:
    """Every law in one figure, and its caption: |x|, or what follows beside its reference."""
    if result.measure == "iae":
        caption = "What follows the reference, under every law; a law far off leaves the frame."
        return caption, plot_tracking(result.runs, result.problem.tracked, width=width)
    caption = "Every law on one axis; a law far above the others leaves the frame."
    about = None if result.problem.operating_point is None else "x: deviation from rest"
    return caption, plot_norms(result.runs, about, width)


def plot_verdict(result: Comparison, width: Width | None = None) -> Figure:
    """The picture of the verdict: one law, with and without switching."""
    problem: Problem = result.problem
    run = result.runs[result.lead]
    end = problem.horizon * (2.0 if max(result.growth) > 0.0 else 1.0)
    with rc_context(style_of(width)):
        figure = new_figure(WIDTH, 3.0, width)
        axes = figure.subplots()
        for i, (held, rate) in enumerate(zip(result.held, result.growth, strict=True)):
            shown = held.time <= end
            norm = np.linalg.norm(held.states[:, shown], axis=0)
            label = f"stays in {plain(problem.modes[i])}: {as_rate(rate)} /s"
            line = LINES[(1 + i) % len(LINES)]
            look: Any = {"color": COLOURS[1 + i % 5], "linestyle": line, "label": label}
            axes.semilogy(held.time[shown], visible(norm), **look)
        norm = np.linalg.norm(run.states, axis=0)
        switching = run.signal.times[1:].size and run.signal.times[1] < run.end
        label = "switches" if switching else "as given"
        norm = visible(norm)
        axes.semilogy(run.time, norm, color=COLOURS[0], linewidth=2.0, label=label)
        axes.set_xlabel("time (s)")
        axes.set_ylabel("|x|")
        axes.set_xlim(0.0, end)
        top = max(float(line.get_ydata().max()) for line in axes.lines)  # pyright: ignore
        axes.set_ylim(max(float(norm.min()) / 3.0, 1e-9 * top), 3.0 * top)
        axes.set_title(plain(f"Law: {result.lead}"))
        labels = [str(line.get_label()) for line in axes.lines]
        columns = legend_columns(figure, labels, 2)
        figure.legend(loc="outside lower center", ncols=columns, handlelength=2.6)
    return figure
