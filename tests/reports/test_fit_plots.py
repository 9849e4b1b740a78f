"""The figure of a fit: what is drawn is what was computed."""

import re

import numpy as np
import pytest
from scipy import stats

from deadtime import ArgumentError, SemiMarkov, SwitchingSignal
from deadtime.reports.fit import plot_fit
from deadtime.switching.models.fit import kaplan_meier, sojourns_of

LOGS = [SemiMarkov(stats.gamma(3.0, scale=0.25)).sample(1.2, seed=i) for i in range(60)]


def test_the_figure_shows_the_estimate_and_the_model_of_every_mode():
    model = SemiMarkov.fit(LOGS, family=["gamma", "lognormal"])
    figure = plot_fit(model, LOGS, ["go", "stop"])
    for mode, (axes, seen) in enumerate(zip(figure.axes, sojourns_of(LOGS), strict=True)):
        fit = model.goodness[mode]
        expected = f"{['go', 'stop'][mode]}: {fit.family}, KS distance {fit.distance:.2f}"
        assert axes.get_title(loc="left") == expected
        steps, marks, curve = axes.lines
        times, survival = kaplan_meier(seen)
        assert np.array_equal(steps.get_xydata()[1:], np.stack((times, 100.0 * survival), axis=1))
        assert np.array_equal(marks.get_xdata(), seen.censored)
        at, shown = curve.get_data()
        assert shown == pytest.approx(100.0 * model.sojourn[mode].sf(at), rel=1e-12)


def test_a_figure_of_many_modes_and_of_a_model_that_was_not_fitted_is_drawn():
    model = SemiMarkov([stats.gamma(2.0), 0.4, 1.0, stats.expon(loc=0.5), stats.lognorm(0.5)])
    figure = plot_fit(model, model.sample(200.0, seed=1))
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles[1] == "mode 1: 0.4, KS distance 0.00"
    assert len(titles) == 5


def test_the_legend_lies_below_the_panels():
    figure = plot_fit(SemiMarkov(0.5), LOGS)
    figure.canvas.draw()
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["logs (Kaplan–Meier)", "cut off by the log's end", "model"]
    assert all(legend.get_window_extent().y1 < axes.bbox.y0 for axes in figure.axes)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: plot_fit(SemiMarkov(1.0), LOGS, ["a"]), "modes must name 2 modes, got 1 names."),
        (
            lambda: plot_fit(SemiMarkov(1.0), SwitchingSignal([0.0, 1.0], [0, 1])),
            "signals hold no complete sojourn of mode 1: log longer.",
        ),
        (lambda: plot_fit(SemiMarkov(1.0), []), "signals must be a SwitchingSignal or a list"),
    ],
)
def test_a_figure_without_data_is_refused_by_name(call, message):
    with pytest.raises(ArgumentError, match=re.escape(message)):
        call()
