"""Several laws in one figure: states, inputs, the switching signal and the mismatch over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deadtime.base.figure_files import Width, legend_columns, new_figure, style_of
from deadtime.base.figure_style import LINES, WIDTH, plain
from deadtime.base.wording import input_names, subscript
from deadtime.reports.figures.colours import Look, looks_of
from deadtime.simulation import Trajectory
from deadtime.simulation.figure import mode_strip, signal_steps

_FAR = 5.0  # a run that goes so many times as far as the others leaves the frame


def plot_laws(
    runs: Mapping[str, Trajectory],
    states: Sequence[str] | None = None,
    modes: Sequence[str] | None = None,
    title: str | None = None,
    laws: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    width: Width | None = None,
) -> Figure:
    """States, inputs, modes and mismatch of runs of one problem; a colour for each law.

    Parameters
    ----------
    runs : mapping
        Runs by the names of their laws, of one plant; at least one.
    states, modes, inputs : sequences of str
        Names for the axes; numbered by default.
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
    first = next(iter(runs.values()))
    n, m = first.states.shape[0], first.inputs.shape[0]
    states = [f"x{subscript(i + 1)}" for i in range(n)] if states is None else states
    inputs = input_names(m) if inputs is None else inputs
    count = first.plant.modes
    modes = [f"mode {i}" for i in range(count)] if modes is None else modes
    rows = [1.0] * (n + m) + [0.35 + 0.15 * count, 1.0]
    looks = looks_of([*(laws or ()), *runs])
    with rc_context(style_of(width)):
        figure = new_figure(1.3 * WIDTH, 0.7 + 1.15 * sum(rows), width)
        panels = figure.subplots(len(rows), 1, sharex=True, height_ratios=rows)
        for i, name in enumerate(states):
            rows_of = {law: (run, run.states[i]) for law, run in runs.items()}
            _panel(panels[i], name, rows_of, looks)
        for i, name in enumerate(inputs):
            rows_of = {law: (run, run.inputs[i]) for law, run in runs.items()}
            _panel(panels[n + i], name, rows_of, looks, held=True)
        end = max(float(run.time[-1]) for run in runs.values()) or 1.0
        longest = max(runs.values(), key=lambda run: run.time[-1])
        mode_strip(panels[-2], *signal_steps(longest.signal, end), list(map(plain, modes)))
        wrong = {
            law: (run, np.linalg.norm(run.mismatch, axis=0))
            for law, run in runs.items()
            if run.mismatch is not None
        }
        floor = mismatch_floor(list(runs.values()))
        _panel(panels[-1], "|mismatch|", wrong, looks, floor=floor)
        panels[-1].set_xlabel("time (s)")
        panels[0].set_xlim(0.0, end)
        figure.align_ylabels()
        handles = panels[0].get_lines()
        columns = legend_columns(figure, runs, 3)
        figure.legend(
            handles=handles,
            loc="outside lower center",
            ncols=min(columns, len(runs)),
            handlelength=2.6,
        )
        if title:
            panels[0].set_title(plain(title))
    return figure


def _panel(
    panel: Axes,
    label: str,
    rows: Mapping[str, tuple[Trajectory, np.ndarray]],
    looks: Mapping[str, Look],
    held: bool = False,
    floor: float = 0.0,
) -> None:
    """One signal of every run."""
    for i, (law, (run, values)) in enumerate(rows.items()):
        style = "steps-post" if held and run.record.held else "default"
        panel.plot(
            run.time,
            values,
            linestyle=LINES[i % len(LINES)],
            drawstyle=style,
            color=looks[law].colour,
            label=plain(law),
        )
    panel.set_ylabel(plain(label))
    if rows:
        panel.set_ylim(*frame([values for _, values in rows.values()], floor))


def mismatch_floor(runs: Sequence[Trajectory]) -> float:
    """A mismatch that is nothing beside the inputs: it is drawn as nothing."""
    return 0.02 * frame([np.abs(run.inputs).max(axis=0) for run in runs])[1]


def frame(rows: Sequence[np.ndarray], floor: float = 0.0) -> tuple[float, float]:
    """Limits that show every row, but for rows that go far beyond all others.

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
    low = min((float(np.fmin.reduce(row, initial=0.0)) for row in shown), default=0.0)
    high = max((float(np.fmax.reduce(row, initial=0.0)) for row in shown), default=1.0)
    low, high = min(low, -0.05 * floor), max(high, floor)
    margin = 0.06 * (high - low) or 1.0
    return low - margin, high + margin


def _size(row: np.ndarray) -> float:
    """The largest of the values, 0 of none."""
    return float(np.fmax.reduce(np.abs(row), initial=0.0))
