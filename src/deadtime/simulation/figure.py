"""The figure of a run: states, inputs and mode over time, as a matplotlib `Figure`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deadtime.base.figure_style import COLOURS, STYLE, WIDTH, plain
from deadtime.base.wording import input_names, subscript
from deadtime.plant import SwitchedSystem
from deadtime.switching import SwitchingSignal


class Run(Protocol):
    """What the figure reads of a `Trajectory`."""

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


def mode_strip(axes: Axes, time: np.ndarray, mode: np.ndarray, names: Sequence[str]) -> None:
    """σ as steps, with the modes' names on the axis."""
    axes.step(time, mode, where="post", color=COLOURS[6], linewidth=1.0)
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(-0.35, len(names) - 0.65)
    axes.grid(False)


def belief_strip(axes: Axes, time: np.ndarray, belief: np.ndarray, names: Sequence[str]) -> None:
    """How likely each mode is from sample to sample, the darker the likelier."""
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
    run: Run,
    title: str | None = None,
    states: Sequence[str] | None = None,
    modes: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
) -> Figure:
    """States, inputs and mode of a run over time, and what it believed of the modes."""
    n, m = run.states.shape[0], run.inputs.shape[0]
    states = [f"x{subscript(i + 1)}" for i in range(n)] if states is None else states
    count = run.plant.modes
    modes = [f"mode {i}" for i in range(count)] if modes is None else modes
    inputs = input_names(m) if inputs is None else inputs
    states, modes, inputs = (list(map(plain, names)) for names in (states, modes, inputs))
    with rc_context(STYLE):
        strip, belief = 0.5 + 0.25 * count, run.belief if run.time.size > 1 else None
        heights = (3.0, 2.2, *([strip] if belief is None else [strip, strip]))
        figure = Figure(figsize=(WIDTH, 4.0 if belief is None else 4.0 + 0.7 * strip))
        upper, middle, *strips = figure.subplots(
            len(heights), 1, sharex=True, height_ratios=heights
        )
        lower = strips[-1]
        for i, name in enumerate(states):
            upper.plot(run.time, run.states[i], color=COLOURS[i % 7], label=name)
        for i, name in enumerate(inputs):
            style = "steps-post" if run.record.held else "default"
            colour = COLOURS[(i + 4) % 7]
            middle.plot(run.time, run.inputs[i], drawstyle=style, color=colour, label=name)
        labels = [*states, *inputs, *_draw_references(upper, run, states)]
        upper.set_ylabel("state")
        middle.set_ylabel("input")
        # A run that ended at once still needs an axis.
        end = float(run.time[-1]) if run.time[-1] > run.time[0] else float(run.time[0]) + 1.0
        if belief is not None:
            belief_strip(strips[0], run.time, belief, modes)
        mode_strip(lower, *signal_steps(run.signal, end), modes)
        lower.set_xlabel("time (s)")
        lower.set_xlim(run.time[0], end)
        figure.align_ylabels()
        figure.legend(loc="outside lower center", ncols=_columns(len(labels), labels))
        if title:
            upper.set_title(plain(title))
    return figure


def _draw_references(axes: Axes, run: Run, states: Sequence[str]) -> list[str]:
    """References as dashes: of a state in its colour, of another output beside that output."""
    labels: list[str] = []
    if run.reference is None or run.tracked is None:
        return labels
    for i, (y, r) in enumerate(zip(run.tracked, run.reference, strict=True)):
        same = [j for j, x in enumerate(run.states) if np.array_equal(x, y)]
        colour, name = COLOURS[(len(states) + i) % 7], f"output {i}"
        if same:
            colour, name = COLOURS[same[0] % 7], states[same[0]]
        else:
            axes.plot(run.time, y, color=colour, label=name)
            labels.append(name)
        labels.append(f"{name}, reference")
        dashes = {"drawstyle": "steps-post", "linestyle": "--", "linewidth": 1.0}
        axes.plot(run.time, r, color=colour, label=labels[-1], **dashes)
    return labels


def _columns(count: int, labels: Sequence[str]) -> int:
    """How many legend columns fit the width."""
    return max(1, min(count, 62 // (max(map(len, labels)) + 6)))
