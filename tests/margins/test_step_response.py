"""Step responses: beside closed forms, python-control's figures, and what a servo is for."""

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.margins import StepResponse, loop_view, step_response
from deadtime.reports import plot_loop
from observed_laws import PLANT, STEP, servo

control = pytest.importorskip("control")
POINT, D = plants.scalar([1.0], 2.0, delay=0.2), 0.2
LAW = dt.SingleModePredictor(POINT, dt.place(POINT, [-1.0]), 0)


def test_a_push_at_the_input_begins_as_the_plant_alone_and_ends_where_the_law_balances_it():
    """dx/dt = x + 2 (1 + u): 2 (e^t − 1) until the first answer acts; x at rest in closed form."""
    found = step_response(POINT, LAW, 0, 0.05)
    alone = 2.0 * np.expm1(found.time)
    plants.close(found.response[:5], alone[:5], 1e-13)
    K = LAW.gains[0, 0, 0]
    # u = K (e^D x + 2 (e^D − 1) u) and 0 = x + 2 (1 + u).
    ratio = K * np.exp(D) / (1.0 - 2.0 * K * np.expm1(D))
    rest = -2.0 / (1.0 + 2.0 * ratio)
    assert found.info["SteadyStateValue"] == pytest.approx(rest, rel=1e-3)
    assert not found.tracks


@pytest.mark.parametrize("channel", [0, 1])
def test_its_figures_are_those_of_python_control(channel):
    law = servo(reference=0.0)
    for mode in range(3):
        found = step_response(PLANT, law, mode, STEP, channel=channel)
        expected = control.step_info(found.response, found.time)
        assert found.info.keys() == expected.keys()
        for name, value in found.info.items():
            assert value == pytest.approx(expected[name], rel=1e-12, abs=1e-12), name
        assert found.tracks
        assert found.info["SteadyStateValue"] == pytest.approx(1.0, abs=1e-3)


def test_a_response_that_comes_back_to_zero_has_no_rise_and_one_that_grows_no_figures():
    time = np.linspace(0.0, 10.0, 101)
    back = StepResponse(0, time, time * np.exp(-2.0 * time), False, -2.0)
    peak = 0.5 * np.exp(-1.0)
    after = time[np.flatnonzero(back.response > 0.02 * peak)[-1] + 1]
    assert back.info == {
        "SettlingTime": after,
        "Peak": pytest.approx(peak),
        "PeakTime": 0.5,
        "SteadyStateValue": 0.0,
    }
    paper = plants.paper()
    grows = step_response(paper, plants.LAWS["averaged"](paper), 1, 0.05)
    assert grows.growth > 0.0
    assert grows.info is None


def test_a_response_that_has_not_settled_by_the_end_has_no_figures():
    """After two time constants the last value is no steady state."""
    time = np.linspace(0.0, 4.0, 101)
    answers = [
        StepResponse(0, time, 1.0 - np.exp(-rate * time), True, -rate) for rate in (0.5, 2.0)
    ]
    assert answers[0].info is None
    assert answers[1].info["SteadyStateValue"] == pytest.approx(1.0, abs=1e-3)


def test_a_law_on_an_observer_begins_with_nothing_estimated():
    plant = plants.near()
    observer = dt.luenberger(plant, plants.OUTPUTS, [-3, -4, -5], STEP)
    law = plants.LAWS["averaged"](plant)
    cold, warm = (dt.OutputFeedback(law, observer, estimate=x) for x in (None, [1.0, 2.0, 3.0]))
    args = {"channel": 1, "output": 1, "horizon": 5.0}
    found = [step_response(plant, each, 0, STEP, **args) for each in (cold, warm)]
    assert (found[0].response == found[1].response).all()
    for name, most in (("mode", 2), ("channel", 1), ("output", 1)):
        with pytest.raises(dt.ArgumentError, match=rf"{name} must be in 0\.\.{most}, got 7"):
            step_response(plant, cold, **{"mode": 0, "step": STEP, name: 7})


def test_the_figure_has_a_panel_of_what_settles():
    view = loop_view(POINT, LAW, 0.05, frequencies=np.geomspace(0.1, 60.0, 50))
    steps = [step_response(POINT, LAW, 0, 0.05)]
    figure = plot_loop(view, None, None, steps, "speed")
    assert len(figure.axes) == len(plot_loop(view).axes) + 1
    panel = figure.axes[-1]
    assert panel.get_title(loc="left") == "speed after a load step of 1 at the input"
    np.testing.assert_array_equal(panel.get_lines()[0].get_ydata(), steps[0].response)
    still = StepResponse(0, steps[0].time, np.zeros(steps[0].time.size), False, -1.0)
    panel = plot_loop(view, None, None, [still], "speed", "input u₂").axes[-1]
    assert panel.get_title(loc="left") == "speed after a load step of 1 at input u₂"
    assert panel.get_xlim() == (0.0, 1.0)
