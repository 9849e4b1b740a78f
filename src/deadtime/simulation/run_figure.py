"""The figure of a run: states, inputs and mode over time, as a matplotlib `Figure`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deadtime.base.figure_files import Width, new_figure, style_of
from deadtime.base.figure_style import COLOURS, WIDTH, plain
from deadtime.base.wording import input_names, subscript
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal

_ONE_COLUMN = 6  # panels in one column, at most
_PANEL, _STRIP, _SMALL = 1.0, 0.25, 8.5  # inches of height; points
REFERENCE: dict[str, Any] = {
    "color": COLOURS[6], "drawstyle": "steps-post", "linestyle": "--", "linewidth": 1.0
}  # fmt: skip


class PlottedRun(Protocol):
    """The attributes of a `Trajectory` that the figure reads.

    Not `Trajectory` itself, whose `plot` imports this file.
    """

    @property
    def time(self) -> np.ndarray: ...
    @property
    def states(self) -> np.ndarray: ...
    @property
    def inputs(self) -> np.ndarray: ...
    @property
    def signal(self) -> SwitchingSignal: ...
    @property
    def plant(self) -> SwitchedSystem: ...
    @property
    def record(self) -> Any: ...
    @property
    def belief(self) -> np.ndarray | None: ...
    @property
    def reference(self) -> np.ndarray | None: ...
    @property
    def tracked(self) -> np.ndarray | None: ...
    @property
    def followed(self) -> Any: ...


def mode_strip(axes: Axes, time: np.ndarray, mode: np.ndarray, names: Sequence[str]) -> None:
    """σ as steps, with the modes' names on the axis."""
    axes.step(time, mode, where="post", color=COLOURS[6], linewidth=1.0)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(-0.35, len(names) - 0.65)
    axes.grid(False)


def belief_strip(axes: Axes, time: np.ndarray, belief: np.ndarray, names: Sequence[str]) -> None:
    """The probability of each mode over time, in shades of grey."""
    edges = np.arange(len(names) + 1) - 0.5
    grey = {"cmap": "Greys", "vmin": 0.0, "vmax": 1.0, "rasterized": True}
    axes.pcolormesh(time, edges, belief[:, : time.size - 1], **grey)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylabel("belief")
    axes.grid(False)


def signal_steps(signal: SwitchingSignal, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the signal on [0, end] for a step plot."""
    inside = signal.times < end
    times, modes = signal.times[inside], signal.modes[inside]
    return np.append(times, end), np.append(modes, modes[-1])


def plot_run(
    run: PlottedRun,
    title: str | None = None,
    states: Sequence[str] | None = None,
    modes: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    width: Width | None = None,
) -> Figure:
    """A panel for each state and input of a run over time, strips of its mode and mode belief.

    Names, with their units, head the panels; more than six panels form two columns. The width is
    "column", "page" or inches; by default as the panels need.
    """
    n, m, count = run.states.shape[0], run.inputs.shape[0], run.plant.modes
    states = [f"x{subscript(i + 1)}" for i in range(n)] if states is None else states
    modes = [f"mode {i}" for i in range(count)] if modes is None else modes
    inputs = input_names(m) if inputs is None else inputs
    states, modes, inputs = (list(map(plain, names)) for names in (states, modes, inputs))
    # A run that ended at once still needs an axis.
    end = float(run.time[-1]) if run.time[-1] > run.time[0] else float(run.time[0]) + 1.0
    with rc_context(style_of(width)):
        belief = run.belief if run.time.size > 1 else None
        beside, others = references(run)
        figure, panels, strips = _panels(
            n + m + len(others), count, 1 if belief is None else 2, width
        )
        held: Any = {"drawstyle": "steps-post" if run.record.held else "default"}
        curves = [(name, x, COLOURS[0], {}) for name, x in zip(states, run.states, strict=True)]
        curves += [(f"output {i}", y, COLOURS[0], {}) for i, y, _ in others]
        curves += [(name, u, COLOURS[1], held) for name, u in zip(inputs, run.inputs, strict=True)]
        beside |= {n + i: reference for i, (_, _, reference) in enumerate(others)}
        for i, (panel, (name, values, colour, look)) in enumerate(zip(panels, curves, strict=True)):
            panel.plot(run.time, values, color=colour, label=name, **look)
            if i in beside:
                panel.plot(run.time, beside[i], label=f"{name}, reference", **REFERENCE)
                name += "; dashed its reference"
            panel.set_title(name, fontsize=_SMALL)
        if belief is not None:
            belief_strip(strips[0], run.time, belief, modes)
        mode_strip(strips[-1], *signal_steps(run.signal, end), modes)
        strips[-1].set_xlabel("time (s)")
        strips[-1].set_xlim(run.time[0], end)
        if title:
            figure.suptitle(plain(title), fontsize=9.5, x=0.02, ha="left")
    return figure


def references(
    run: PlottedRun,
) -> tuple[dict[int, np.ndarray], list[tuple[int, np.ndarray, np.ndarray]]]:
    """References by the state that follows them; and (number, output, reference) of other outputs.

    A state carries one reference: further outputs that equal it have panels of their own.
    """
    beside, others = {}, []
    if run.followed is None or run.reference is None or run.tracked is None:
        return beside, others
    of = run.followed.states
    for i, (state, y, r) in enumerate(zip(of, run.tracked, run.reference, strict=True)):
        if state is None or state in beside:
            others.append((i, y, r))
        else:
            beside[state] = r
    return beside, others


def _panels(
    curves: int, modes: int, strips: int, width: Width | None
) -> tuple[Figure, list[Axes], list[Axes]]:
    """A panel for each curve, in two columns if there are many, above strips of the full width."""
    columns = 1 if curves <= _ONE_COLUMN else 2
    rows, strip = -(-curves // columns), _STRIP + 0.17 * modes
    cells = [[min(columns * i + j, curves - 1) for j in range(columns)] for i in range(rows)]
    layout: Any = [*cells, *([f"strip {i}"] * columns for i in range(strips))]
    heights = [_PANEL] * rows + [strip] * strips
    figure = new_figure(WIDTH * (1.0 if columns == 1 else 1.4), 0.5 + sum(heights), width)
    found: Any = figure.subplot_mosaic(layout, sharex=True, height_ratios=heights)
    return figure, [found[i] for i in range(curves)], [found[f"strip {i}"] for i in range(strips)]
