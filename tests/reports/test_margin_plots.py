"""Figures of certificates: what is drawn is what was found."""

import numpy as np

from deadtime.margins import StabilityChart, StabilityMargin
from deadtime.reports.figures.certificates import plot_chart


def chart():
    def margin(certified, refuted):
        return StabilityMargin(certified, refuted, None, True, None, None, "", ())

    margins = {
        "averaged": (None, margin(0.3, 0.35), margin(0.61, 0.62)),
        "mean": (margin(0.52, 0.6), margin(0.7, None), margin(0.8, 0.81)),
        "$odd_name$": (margin(0.2, 0.25),) * 3,
    }
    return StabilityChart((0.25, 0.9), np.array([0.1, 0.2, 0.4]), margins, {})


def test_a_chart_draws_every_bracket_from_its_ends(tmp_path):
    figure = plot_chart(chart(), "distance α")
    panel = figure.axes[0]
    bars = [(bar.get_y(), bar.get_y() + bar.get_height()) for bar in panel.patches]
    assert np.allclose(bars, [(0.25, 0.3), (0.35, 0.9), (0.25, 0.61), (0.62, 0.9)])
    texts = [text.get_text() for text in panel.texts]
    assert texts == ["no answer", "0.3", "0.61"]
    assert panel.get_ylim() == (0.25, 0.9)
    assert panel.get_ylabel() == "distance α"
    assert len(figure.axes[1].patches) == 5
    figure.savefig(tmp_path / "chart.png")
    assert (tmp_path / "chart.png").stat().st_size > 10_000


def test_the_legend_lies_below_the_panels():
    figure = plot_chart(chart(), "distance α")
    figure.draw_without_rendering()
    (legend,) = figure.legends
    bottom = min(axes.get_tightbbox().y0 for axes in figure.axes if axes.axison)
    assert legend.get_window_extent().y1 <= bottom
