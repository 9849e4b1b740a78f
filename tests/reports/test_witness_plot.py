"""The figure of a witness: the growth that is drawn is the growth that was found."""

import numpy as np
import pytest

import deadtime as dt
from deadtime.certificates import falsify
from deadtime.reports.figures.certificates import plot_witness


def worst_of(alpha, law=dt.AveragedPredictor, dwell_time=0.2):
    plant = dt.problems.paper().plant.apart(alpha)
    return falsify(plant, law(plant, dt.place(plant, [-1.0, -2.0])), dwell_time, step=0.1)


def drawn(figure):
    """The slope of what is drawn over its second half, and the strip's corners."""
    upper, lower = figure.axes
    time, norm = upper.lines[0].get_data()
    late = time >= time[-1] / 2.0
    return np.polyfit(time[late], np.log(norm[late]), 1)[0], lower.lines[0].get_data()


def test_a_constant_signal_is_drawn_with_its_growth(tmp_path):
    worst = worst_of(1.0)
    figure = plot_witness(worst, "$Law_", ["go", "stop"])
    slope, (_, modes) = drawn(figure)
    assert slope == pytest.approx(worst.growth_rate, rel=0.2)
    assert set(modes) == {1}
    assert [text.get_text() for text in figure.axes[1].get_yticklabels()] == ["go", "stop"]
    assert figure.axes[1].get_xlabel() == "the signal, time (s)"
    figure.savefig(tmp_path / "witness.png")
    assert (tmp_path / "witness.png").stat().st_size > 10_000


def test_where_x_waves_too_often_its_peaks_are_drawn():
    worst = worst_of(0.66)
    figure = plot_witness(worst)
    slope, _ = drawn(figure)
    assert worst.growth_rate < 0.01
    assert slope == pytest.approx(worst.growth_rate, rel=0.01)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["peaks of |x|", f"growth +{worst.growth_rate:.3g} /s"]


def test_a_switching_signal_shows_three_of_its_cycles():
    problem = dt.problems.three_mode()
    law = dt.DelayedStateFeedback(problem.plant, problem.gains)
    worst = falsify(problem.plant, law, dwell_time=0.9, step=0.1)
    assert len(worst.modes) > 1
    slope, (times, modes) = drawn(plot_witness(worst))
    assert slope == pytest.approx(worst.growth_rate, rel=0.1)
    assert times[-1] == pytest.approx(3 * worst.length)
    assert set(modes) == set(worst.modes)


def test_a_loop_that_decays_is_drawn_too():
    worst = worst_of(0.2)
    assert worst.growth_rate < 0.0
    assert drawn(plot_witness(worst))[0] < 0.0
