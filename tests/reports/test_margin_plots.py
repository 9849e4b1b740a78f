"""Figures of certificates, and how far the theorem reaches: what is drawn is what was found."""

from dataclasses import replace

import numpy as np
import pytest

import deadtime as dt
from deadtime.certificates import theorem_bound
from deadtime.certificates.theorem.constants import distance
from deadtime.margins import StabilityChart, StabilityMargin
from deadtime.reports.figures.certificates import plot_chart
from deadtime.reports.tightness import Reach, Tightness, move_modes, plot_tightness, reach_of


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


@pytest.mark.parametrize("count", [2, 5])
def test_reaches_are_drawn_where_they_are_with_what_each_gains(tmp_path, count):
    reaches = (
        Reach("theorem as printed", -400.0, 0.0),
        Reach("corrected", -14.0, 1e-14),
        Reach("sharp", -3.0, 1e-3),
        Reach("lifted loop, proved", -0.3, 0.63),
        Reach("a signal that grows", -0.299, 0.64, stable=False),
    )[5 - count :]
    figure = plot_tightness(Tightness(reaches, 0.79, None, ""), "A title")
    (axes,) = figure.axes
    ends = [line.get_xdata()[0] for line in axes.lines if line.get_marker() in ("o", "X")]
    assert ends == [reach.log10_distance for reach in reaches]
    gains = [text.get_text() for text in axes.texts if text.get_text().startswith("×")]
    assert gains == ["× 10^386", "× 1.0 × 10¹¹", "× 501"][: 3 if count == 5 else 0]
    figure.savefig(tmp_path / "reach.png")
    assert (tmp_path / "reach.png").stat().st_size > 10_000


def test_a_plant_nearer_than_all_that_is_drawn_is_on_the_axis(tmp_path):
    """As where the theorem has no answer: no label runs out of the figure, which warns of that."""
    reaches = (
        Reach("lifted loop, proved", 0.559, 3.62),
        Reach("a signal that grows", 0.560, 3.63, stable=False),
    )
    figure = plot_tightness(Tightness(reaches, 1.33, None, ""))
    figure.savefig(tmp_path / "reach.png")
    (axes,) = figure.axes
    (label,) = [text for text in axes.texts if "this plant" in text.get_text()]
    box, room = label.get_window_extent(), axes.get_window_extent()
    assert room.x0 <= box.x0 < box.x1 <= room.x1


def test_a_distance_of_one_is_ten_to_the_zero_without_a_sign():
    reaches = (Reach("lifted loop, proved", 0.576, 3.765),)
    (axes,) = plot_tightness(Tightness(reaches, 0.3, None, "")).axes
    assert "$10^{0}$" in [tick.get_text() for tick in axes.get_xticklabels()]


@pytest.mark.few(2)
@pytest.mark.parametrize("form", ["printed", "sharp"])
@pytest.mark.parametrize("name", ["paper", "three-mode", "follower"])
def test_the_theorem_reaches_where_the_distance_meets_what_it_allows(name, form):
    problem = dt.problems.NAMED[name]()
    reach = reach_of(problem, problem.signal.dwell_time, form)
    for factor, holds in ((0.99, True), (1.01, False)):
        plant, gains = move_modes(problem, factor * max(reach.alpha, 1e-6))
        bound = theorem_bound(plant, gains, problem.signal.dwell_time, form=form)
        if reach.alpha > 1e-6:
            assert bound.holds is holds
    scaled = distance(plant, gains) * reach.alpha / (1.01 * max(reach.alpha, 1e-6))
    assert np.log10(scaled) == pytest.approx(reach.log10_distance, abs=1e-2)


def test_moved_gains_place_the_same_poles_or_move_along_their_own_difference():
    problem = dt.problems.three_mode()
    for alpha in (0.0, 0.3, 1.0):
        plant, gains = move_modes(problem, alpha)
        for A, B, K in zip(plant.A, plant.B, gains, strict=True):
            assert np.sort(np.linalg.eigvals(A + B @ K)) == pytest.approx([-3.0, -2.0])
    assert gains == pytest.approx(problem.gains)
    other = dt.lqr(problem.plant, np.eye(2), np.eye(1))
    changed = replace(problem, gains=other)
    assert move_modes(changed, 0.0)[1] == pytest.approx(np.stack([other[0]] * 3))
    assert move_modes(changed, 0.5)[1][2] == pytest.approx((other[0] + other[2]) / 2)
