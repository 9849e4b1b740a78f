"""Figures of an identification: likelihood of the delays, predictions of the log, residuals.

The likelihood of a delay is its profile, maximised over all other unknowns; predictions are one
sample ahead, and simulated from the first row.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from deadtime.base.figure_files import new_figure
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH, plain
from deadtime.identification.likelihoods.noisy_log import following
from deadtime.identification.log.recording import Part
from deadtime.identification.predictor import Predictor
from deadtime.identification.residuals import LAGS, autocorrelation, input_correlations
from deadtime.identification.sentences import delay_names
from deadtime.identification.validation_figure import draw_validation, plot_validation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from deadtime.identification.identified_plant import Findings


_SHOWN = 400  # samples of the log, at most
_POINTS = 13  # of a likelihood, where each takes a filter over the log
_MANY = 41  # of a likelihood without a filter
_FAR = 3.0  # of a log's range: a free run that leaves it is cut there


def plot_identification(fit: Findings) -> Figure:
    """Likelihood over each delay, predictions and free run over the log, residuals, modes."""
    import matplotlib as mpl

    part = shown(fit)
    n, several = fit.plant.states, fit.plant.modes > 1
    courses = () if fit.validation is None else fit.validation.courses
    tested = len(fit._recording.outputs) if courses else 0
    rows = n + 2 + several + 2 * tested
    with mpl.rc_context(STYLE):
        figure = new_figure(1.5 * WIDTH, 1.2 * rows + 0.8)
        grid = figure.add_gridspec(rows, 1)
        draw_likelihood(figure.add_subplot(grid[0]), fit)
        axes = [figure.add_subplot(grid[1 + i]) for i in range(n)]
        draw_log(axes, fit, part)
        if several:
            axes.append(figure.add_subplot(grid[n + 1], sharex=axes[0]))
            draw_modes(axes[-1], fit, part)
        axes[-1].set_xlabel(f"time (s), {rows_shown(fit, part)}")
        draw_residuals(figure.add_subplot(grid[n + several + 1]), fit)
        for i, name in enumerate(fit._recording.outputs[:tested]):
            above, below = (figure.add_subplot(grid[rows - 2 * (tested - i) + k]) for k in (0, 1))
            draw_validation(above, below, i, f"{name}, test", courses)
            below.set_xlabel("time (s)")
    return figure


def shown(fit: Findings) -> Part:
    """The beginning of the log, which figures show."""
    return fit._recording.parts[0].rows(slice(_SHOWN))


def rows_shown(fit: Findings, part: Part) -> str:
    """The rows of the log that figures show, in words."""
    first = f"the first {part.time.size:,} of {fit.samples:,} rows"
    return first if part.time.size < fit.samples else "all rows"


def draw_modes(axes: Axes, fit: Findings, part: Part) -> None:
    mode = np.where(part.mode < 0, np.nan, part.mode)  # of lost rows
    axes.step(part.time, mode, where="post", color=COLOURS[0])
    axes.set_yticks(range(fit.plant.modes), [plain(name) for name in fit.modes])
    axes.set_ylabel("mode")


def draw_likelihood(axes: Axes, fit: Findings) -> None:
    """The profile likelihood of every delay near its estimate."""
    from scipy.interpolate import PchipInterpolator

    estimate = fit._estimate
    places, names = estimate.log.layout.delay_places, delay_names(fit._recording, estimate)
    for row, (place, name) in enumerate(zip(places.tolist(), names, strict=True)):
        D = float(estimate.best.theta[place])
        reach = 1.7 * np.abs(estimate.intervals[row] - D).max()
        points = _POINTS if fit.noise.any() else _MANY
        delays = np.clip(np.linspace(D - reach, D + reach, points), *estimate.window)
        falls = [estimate.profile(place, float(d)) for d in delays]
        if points < _MANY and (np.diff(delays) > 0.0).all():
            curve = PchipInterpolator(delays, falls)
            delays = np.linspace(delays[0], delays[-1], _MANY)
            falls = curve(delays)
        colour = COLOURS[row % len(COLOURS)]
        axes.plot(1e3 * (delays - D), falls, color=colour, label=plain(f"{name}: {D:.4g} s"))
        for end in estimate.intervals[row]:
            axes.axvline(1e3 * (end - D), color=colour, linewidth=0.8, linestyle=":")
    axes.set_xlabel("delay − estimate (ms); dotted: 95 %")
    axes.set_ylabel("log L")
    axes.legend(loc="lower center")


def draw_log(axes: list[Axes], fit: Findings, part: Part) -> None:
    """States as logged, predicted one sample ahead, and simulated from the first row on."""
    logged, ahead, free = _curves(fit, part)
    for i, own in enumerate(axes):
        x = logged[:, i]
        middle, span = np.nanmean(x), max(float(np.nanmax(x) - np.nanmin(x)), 1e-300)
        far = np.where(np.abs(free[:, i] - middle) < _FAR * span, free[:, i], np.nan)
        measured = fit._estimate.of_outputs is None or bool(fit.C[:, i].any())
        if measured:
            own.plot(part.time, x, ".", color="#999999", markersize=3.0, label="log")
        else:
            own.plot(part.time, x, color="#999999", linewidth=2.5, label="smoothed, not logged")
        own.plot(part.time, ahead[:, i], color=COLOURS[0], linewidth=0.9, label="a row ahead")
        own.plot(part.time, far, color=COLOURS[1], linestyle="--", label="free run")
        own.set_ylabel(plain(fit.states[i]))
    lines = {str(one.get_label()): one for own in axes for one in own.get_lines()}
    axes[0].legend(
        list(lines.values()),
        list(lines),
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=len(lines),
        borderaxespad=0.0,
    )


def _curves(fit: Findings, part: Part) -> tuple[np.ndarray, ...]:
    """States as logged, or smoothed; a row ahead; and simulated; all in the log's own units."""
    estimate, level, back = fit._estimate, fit._recording.level, np.linalg.pinv(fit.C)
    own = fit._recording._replace(parts=(part,))
    predictor = Predictor.of(estimate, fit.C, own)
    logged, ahead = part.output @ back.T, predictor.ahead(0)
    if (log := estimate.of_outputs) is not None:
        states = following(log, estimate.best.theta, part, estimate.window).states
        logged = np.where(fit.C.any(axis=0), part.output @ fit.C, states)
    at = 0.0 if level is None else back @ level.output
    return tuple(at + curve for curve in (logged, ahead, predictor.free_run(0).states))


def draw_residuals(axes: Axes, fit: Findings) -> None:
    """The residuals' correlation with themselves, and where it would be by chance."""
    r, count = autocorrelation(list(fit._estimate.white))
    names = fit._recording.outputs
    _draw_correlation(axes, np.arange(1, LAGS + 1), r, 0.15, names, 1.96, count, 4)
    axes.set_xlabel("samples between residuals; dotted: 95 % by chance")


def _draw_inputs(axes: Axes, fit: Findings) -> None:
    """The largest correlation of any residual with each input, over the time in between."""
    from scipy.stats import norm

    r, count = input_correlations(
        list(fit._estimate.white), fit._recording, float(fit.delays.max())
    )
    time = fit.step * np.arange(1, len(count) + 1)
    largest = np.take_along_axis(r, np.abs(r).argmax(axis=1)[:, None], axis=1)[:, 0]
    # The largest of n is outside more often than one: Bonferroni's level for a lag.
    reach = float(norm.isf(0.025 / r.shape[1]))
    _draw_correlation(axes, time, largest, 0.25 * fit.step, fit.inputs, reach, count, 3)
    axes.set_xlabel("time since the input (s); dotted: 95 % by chance")


def _draw_correlation(
    axes: Axes,
    at: np.ndarray,
    r: np.ndarray,
    gap: float,
    names: tuple[str, ...],
    reach: float,
    count: np.ndarray,
    columns: int,
) -> None:
    """Correlations r (lags, names), each of `count` pairs, side by side; and a band of chance."""
    for i, name in enumerate(names):
        shift, colour = gap * (i - 0.5 * (len(names) - 1)), COLOURS[i % len(COLOURS)]
        axes.vlines(at + shift, 0.0, r[:, i], color=colour, label=plain(name))
    for side in (-1.0, 1.0):
        axes.plot(at, side * reach / np.sqrt(np.maximum(count, 1.0)), color="#666666", ls=":")
    axes.set_ylabel("correlation")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.0)


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
    """(name, caption, figure) of all others: predictions and modes, residuals."""
    part, n, several = shown(fit), fit.plant.states, fit.plant.modes > 1
    with _figure(n + several, 1.1, 2.0) as (figure, axes):
        draw_log(axes[:n], fit, part)
        if several:
            draw_modes(axes[-1], fit, part)
        axes[-1].set_xlabel(f"time (s), {rows_shown(fit, part)}")
        figure.align_ylabels(axes)
    yield (
        "predictions",
        f"The log ({rows_shown(fit, part)}), the model a row ahead, and the model run from the "
        "first row on with the inputs alone: noise of the plant drives the log away from it.",
        figure,
    )
    if fit.validation is not None:
        caption = "The log that was not identified, the model run with its inputs alone, and a row "
        caption += f"ahead; below, the errors. {fit.validation.message}"
        yield "validation", caption, plot_validation(fit.validation.outputs, fit.validation.courses)
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
