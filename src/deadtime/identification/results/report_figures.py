"""What a report on an identification shows, figure by figure."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from deadtime.base.figure_files import new_figure
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH, plain
from deadtime.identification.residuals import with_inputs
from deadtime.identification.results.identification_figure import (
    draw_likelihood,
    draw_log,
    draw_modes,
    draw_residuals,
    rows_shown,
    shown,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from deadtime.identification.identified_plant import Findings


def figures_of(fit: Findings) -> Iterator[tuple[str, str, Figure]]:
    """(name, caption, figure), the likelihood first."""
    yield likelihood_figure(fit)
    yield from quick_figures(fit)


def likelihood_figure(fit: Findings) -> tuple[str, str, Figure]:
    """(name, caption, figure) of the likelihood over the delays.

    Of noisy measurements each of its points takes a search over all else: it may well take longer
    than the identification did.
    """
    with _figure(1, 2.6) as (figure, (axes,)):
        draw_likelihood(axes, fit)
    caption = "How likely every delay is, all else at its likeliest; dotted: the 95 % interval."
    return "likelihood", caption, figure


def quick_figures(fit: Findings) -> Iterator[tuple[str, str, Figure]]:
    """(name, caption, figure) of all others: predictions and modes, what is left."""
    part, n, several = shown(fit), fit.plant.states, fit.plant.modes > 1
    with _figure(n + several, 1.1, 2.0) as (figure, axes):
        draw_log(axes[:n], fit, part)
        if several:
            draw_modes(axes[-1], fit, part)
        axes[-1].set_xlabel(f"time (s), {rows_shown(fit, part)}")
        figure.align_ylabels(axes)
    yield (
        "predictions",
        f"The log ({rows_shown(fit, part)}), the model a sample ahead, and the model run from the "
        "first row on with the inputs alone: noise of the plant drives the log away from it.",
        figure,
    )
    with _figure(1, 2.2) as (figure, (axes,)):
        draw_residuals(axes, fit)
    yield (
        "whiteness",
        "Correlation of what is left with itself: of chance, all but one in twenty lie within the "
        "dotted lines.",
        figure,
    )
    with _figure(1, 2.2) as (figure, (axes,)):
        _draw_inputs(axes, fit)
    yield (
        "inputs",
        "Correlation of what is left with the inputs before: what sticks out is an effect of an "
        "input that the model lacks.",
        figure,
    )


@contextmanager
def _figure(rows: int, height: float, wide: float = 1.0) -> Iterator[tuple[Figure, list[Axes]]]:
    """A figure of rows of panels over one axis, inches each, in the style of all."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        figure = new_figure(wide * WIDTH, height * rows + 0.4)
        yield figure, list(figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])


def _draw_inputs(axes: Axes, fit: Findings) -> None:
    """Of each input the largest of all states, over the time in between."""
    r, count = with_inputs(list(fit._found.white), fit._recording, float(fit.delays.max()))
    time = fit.step * np.arange(1, len(count) + 1)
    largest = np.take_along_axis(r, np.abs(r).argmax(axis=1)[:, None], axis=1)[:, 0]
    wide = 0.25 * fit.step
    for j, name in enumerate(fit.inputs):
        shift = wide * (j - 0.5 * (len(fit.inputs) - 1))
        colour = COLOURS[j % len(COLOURS)]
        axes.vlines(time + shift, 0.0, largest[:, j], color=colour, label=plain(name))
    # The largest of n is outside more often than one: Bonferroni's level for a lag.
    from scipy.stats import norm

    reach = float(norm.isf(0.025 / r.shape[1]))
    for side in (-1.0, 1.0):
        axes.plot(time, side * reach / np.sqrt(np.maximum(count, 1.0)), color="#666666", ls=":")
    axes.set_xlabel("time since the input (s); dotted: 95 % by chance")
    axes.set_ylabel("correlation")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.0)
