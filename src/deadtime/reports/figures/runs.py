"""Several laws in one figure: states, inputs, the switching signal and the mismatch over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from deadtime.base.figure_files import Width, legend_columns, new_figure, style_of
from deadtime.base.figure_style import LINES, WIDTH, plain
from deadtime.base.wording import input_names, numbered, subscript
from deadtime.reports.figures.colours import Look, looks_of
from deadtime.simulation import Trajectory
from deadtime.simulation.run_figure import REFERENCE, mode_strip, references, signal_steps

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
        figure.legend(
            handles=handles,
            loc="outside lower center",
            ncols=columns,
            handlelength=2.6,
        )
        if title:
            panels[0].set_title(plain(title))
    return figure


class _Curves(NamedTuple):
    """What a panel shows: a row of every law's run, and what it is to follow."""

    label: str
    rows: Mapping[str, np.ndarray]
    reference: np.ndarray | None = None
    held: bool = False
    floor: float = 0.0


def _panel(
    panel: Axes, curves: _Curves, runs: Mapping[str, Trajectory], looks: Mapping[str, Look]
) -> None:
    """One signal of every run."""
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
    """The largest of the values, 0 of none."""
    return float(np.fmax.reduce(np.abs(row), initial=0.0))
