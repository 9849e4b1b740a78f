"""Figures of runs: a panel a curve, references beside what follows them, at most five laws each."""

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.base.figure_style import LINES
from deadtime.reports import plot_norms
from deadtime.simulation.run_figure import plot_run


def test_every_state_and_input_has_a_panel_headed_by_its_name_and_unit():
    problem = dt.problems.follower()
    run = problem.simulate("averaged")
    figure = plot_run(run, "a title", problem.states, problem.modes, problem.inputs)
    heads = [panel.get_title(loc="left") for panel in figure.axes]
    assert heads == [*problem.states, *problem.inputs, ""]
    assert "spacing error (m)" in heads
    for panel, values in zip(figure.axes, [*run.states, *run.inputs], strict=False):
        (line,) = panel.get_lines()
        assert np.array_equal(line.get_ydata(), values)
    assert not figure.legends


@pytest.mark.parametrize(("states", "columns"), [(3, 1), (8, 2)])
def test_many_states_stand_in_two_columns(states, columns):
    plant = dt.SwitchedSystem(-np.eye(states)[None], np.ones((1, states, 1)), 0.1)
    law = dt.DelayedStateFeedback(plant, np.zeros((1, 1, states)))
    run = dt.simulate(plant, law, dt.SwitchingSignal.constant(0), np.ones(states), 0.5, 0.1)
    figure = plot_run(run)
    lefts = {round(panel.get_subplotspec().colspan.start) for panel in figure.axes}
    assert len(lefts) == columns
    assert len(figure.axes) == states + 2


@pytest.mark.parametrize(("at", "panels"), [(0, 4), (None, 5)])
def test_a_reference_is_dashed_beside_the_output_that_follows_it(at, panels):
    plant = dt.SwitchedSystem([[[0.0, 1.0], [0.0, -0.5]]], [[[0.0], [1.0]]], 0.2)
    C = [[1.0, 0.0]] if at == 0 else [[1.0, 0.5]]
    servo = dt.Servo(plant, C=C)
    gains = servo.lqr(np.diag([1.0, 1.0, 0.5]), [[1.0]], step=0.05)
    law = dt.AveragedPredictor(servo.plant, gains, allow_unstable=True)
    observer = dt.luenberger(servo.model, servo.C, poles=[-3, -4], step=0.05)
    loop = dt.OutputFeedback(law, observer, servo=servo, reference=2.0)
    run = dt.simulate(plant, loop, dt.SwitchingSignal.constant(0), [0.0, 0.0], 2.0, 0.05)
    figure = plot_run(run)
    assert len(figure.axes) == panels
    (panel,) = [one for one in figure.axes if len(one.get_lines()) == 2]
    assert panel is figure.axes[2 if at is None else at]
    curve, reference = panel.get_lines()
    assert np.allclose(curve.get_ydata(), np.array(C[0]) @ run.states)
    assert reference.get_linestyle() == "--"
    assert set(reference.get_ydata()) == {2.0}


@pytest.mark.parametrize(("count", "sizes"), [(5, [5]), (6, [3, 3]), (11, [4, 4, 3])])
def test_at_most_five_laws_share_a_panel_each_with_dashes_of_its_own(count, sizes):
    plant = plants.scalar([-1.0], 1.0, 0.1)
    law = dt.DelayedStateFeedback(plant, [[[0.0]]])
    run = dt.simulate(plant, law, dt.SwitchingSignal.constant(0), [1.0], 0.5, 0.1)
    figure = plot_norms({f"law {i}": run for i in range(count)})
    lines = [panel.get_lines() for panel in figure.axes]
    assert [len(of_panel) for of_panel in lines] == sizes
    assert len(LINES) == 5
    for of_panel in lines:
        patterns = {str(line._unscaled_dash_pattern) for line in of_panel}
        assert len(patterns) == len(of_panel)
        assert len({line.get_color() for line in of_panel}) == len(of_panel)
