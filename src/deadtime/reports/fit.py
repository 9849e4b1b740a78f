"""A fitted model of the switching: how long modes lasted, as a figure, a table and JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from deadtime.base.errors import ArgumentError
from deadtime.base.figure_files import new_figure
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH, plain
from deadtime.base.json_records import plain as json_values, record
from deadtime.base.wording import amount
from deadtime.switching.models.fit import Signals, distance, kaplan_meier, sojourns_of
from deadtime.switching.models.semi_markov import SemiMarkov
from deadtime.switching.models.sojourn_families import Goodness, Observed
from deadtime.switching.models.sojourns import Distribution, describe, log_survival

HEADINGS = ("mode", "sojourns", "censored", "mean, s", "family", "KS distance", "p-value")
DOUBTFUL = 0.05


def fit_rows(model: SemiMarkov, names: Sequence[str]) -> list[tuple[str, ...]]:
    """One row per mode, under `HEADINGS`."""
    return [
        (
            name,
            str(good.complete),
            str(good.censored),
            amount(float(mean)),
            good.family,
            f"{good.distance:.3f}",
            f"{good.p_value:.2g}",
        )
        for name, good, mean in zip(names, _goodness(model), model.mean, strict=True)
    ]


def fit_sentence(model: SemiMarkov, names: Sequence[str]) -> str:
    """Whether the families describe the logs.

    Examples
    --------
    >>> import deadtime as dt
    >>> model = dt.SemiMarkov.fit(dt.SwitchingSignal.random(2, 200.0, dwell_time=0.2, seed=1))
    >>> fit_sentence(model, ["throttle", "brake"])
    'The families describe the logged sojourns: no distance is larger than chance makes it.'
    """
    doubtful = [
        name for name, good in zip(names, _goodness(model), strict=True) if good.p_value < DOUBTFUL
    ]
    if not doubtful:
        return (
            "The families describe the logged sojourns: no distance is larger than chance makes it."
        )
    return (
        f"Doubtful for {', '.join(doubtful)}: sojourns differ from the family more than chance "
        f"explains (p < {DOUBTFUL:g}). Look at the figure, and try another family."
    )


def fit_record(model: SemiMarkov, names: Sequence[str]) -> dict[str, Any]:
    """The fit for JSON."""
    modes = {
        name: {
            **record(good, "family", "parameters"),
            "mean": mean,
            **record(good, "complete", "censored"),
            "ks_distance": good.distance,
            **record(good, "p_value", "aic"),
        }
        for name, good, mean in zip(names, _goodness(model), model.mean, strict=True)
    }
    return json_values({"modes": modes, "transition": model.transition})


def _goodness(model: SemiMarkov) -> tuple[Goodness, ...]:
    assert model.goodness is not None
    return model.goodness


def plot_fit(
    model: SemiMarkov, signals: Signals, modes: Sequence[str] | None = None, *, first: str = "whole"
) -> Figure:
    """Survival of the sojourns in each mode: Kaplan and Meier's estimate, and the model's.

    Parameters
    ----------
    model : SemiMarkov
        Fitted to these signals, or any other to compare with them.
    signals : SwitchingSignal, or list of them
        The logs.
    modes : sequence of str, optional
        Names of the modes.
    first : {"whole", "drop"}
        As in `SemiMarkov.fit`.

    Raises
    ------
    ArgumentError
        If the signals hold no complete sojourn of a mode, or `modes` has the wrong length.
    """
    observed = sojourns_of(signals, first, model.modes)
    names = [f"mode {i}" for i in range(model.modes)] if modes is None else list(modes)
    if len(names) != model.modes:
        raise ArgumentError(f"modes must name {model.modes} modes, got {len(names)} names.")
    for mode, seen in enumerate(observed):
        if not seen.complete.size:
            raise ArgumentError(f"signals hold no complete sojourn of mode {mode}: log longer.")
    rows, columns = (model.modes, 1) if model.modes <= 3 else (-(-model.modes // 2), 2)
    with rc_context(STYLE):
        figure = new_figure(WIDTH * (1.0 if columns == 1 else 1.5), 0.7 + 1.75 * rows)
        panels = figure.subplots(rows, columns, squeeze=False)
        for panel in panels.flat[model.modes :]:
            panel.remove()
        for mode, panel in enumerate(panels.flat[: model.modes]):
            _survival(panel, model.sojourn[mode], observed[mode])
            family = model.goodness[mode].family if model.goodness else ""
            gap = distance(model.sojourn[mode], observed[mode])
            text = f"{names[mode]}: {family or describe(model.sojourn[mode])}"
            stop = ", " if len(text) * columns <= 44 else "\n"
            panel.set_title(plain(f"{text}{stop}KS distance {gap:.2f}"))
        for row in panels:
            row[0].set_ylabel("still in the mode (%)")
        for panel in panels.flat[max(0, model.modes - columns) : model.modes]:
            panel.set_xlabel("time since the mode began (s)")
        drawn = {str(line.get_label()): line for panel in figure.axes for line in panel.lines}
        figure.legend(drawn.values(), drawn, loc="outside lower center", ncols=3)
    return figure


def _survival(axes: Axes, dist: Distribution, observed: Observed) -> None:
    """One mode: estimate in steps with its censored sojourns marked, model as a curve."""
    times, survival = kaplan_meier(observed)
    end = 1.06 * times[-1]
    corners, levels = np.append(0.0, times), 100.0 * np.append(1.0, survival)
    grid = np.linspace(0.0, end, 1001)
    model = 100.0 * np.exp(log_survival(dist, grid))
    axes.step(corners, levels, where="post", color=COLOURS[0], label="logs (Kaplan–Meier)")
    if observed.censored.size:
        level = levels[np.searchsorted(corners, observed.censored, side="right") - 1]
        look: dict[str, Any] = {"color": COLOURS[0], "markersize": 5.0}
        axes.plot(observed.censored, level, "|", label="cut off by the log's end", **look)
    axes.plot(grid, model, "--", color=COLOURS[1], label="model")
    axes.set_xlim(0.0, end)
    axes.set_ylim(-3.0, 103.0)
    axes.set_yticks([0, 50, 100])
