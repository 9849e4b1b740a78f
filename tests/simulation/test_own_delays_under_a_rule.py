"""Plants that a rule switches, their inputs or modes with delays of their own.

The second method integrates the differential equation by SciPy's DOP853 with event detection, all
modes under what they would read, and restarts whenever any of them reads something new.
"""

import itertools

import numpy as np
import pytest

import deadtime as dt
import plants
import rule_reference as second
from deadtime.imperfections import StepDisturbance
from shares import mostly_long
from swinging import BOUNDARIES, RULES, X0, H, soft, swinging, wedge

DELAYS = {
    "per input": [0.3, 0.12],
    "per mode": [[0.3], [0.1], [0.157]],
    "per mode and input": [[0.3, 0.12], [0.234, 0.3], [0.05, 0.41]],
}
PAIRS = list(itertools.product(DELAYS, RULES))
CASES = mostly_long(PAIRS, ("per mode and input", "wedge"))
RULE_OF = {"wedge": wedge, "wedge as a function": wedge, "ball": RULES["ball"]}
FORCE, NONE = np.array([0.1, -0.2, 0.1]), np.zeros(3)


def plant_with(delays, scale=1.0):
    one = swinging()
    return dt.SwitchedSystem(scale * one.A, one.B, delays)


def predictor(plant, rule):
    return dt.StateDependentPredictor(plant, soft(plant), rule)


def ignoring(plant):
    return dt.DelayedStateFeedback(plant, 0.5 * soft(plant), allow_unstable=True)


def run(law, rule, plant, horizon=3.0, x0=X0, **options):
    return dt.simulate(plant, law, rule, x0, horizon, step=H, u0=[0.3, -0.2], **options)


def mismatch(one):
    assert one.mismatch is not None
    return one.mismatch


def read_by(plant, mode, t, inputs):
    """What a mode reads at a time, u held over periods and 0.3, −0.2 before."""
    samples = np.floor((t - plant.delays[mode]) / H + 1e-9).astype(int)
    history = 0.3, -0.2
    return [inputs[j, k] if k >= 0 else history[j] for j, k in enumerate(samples)]


def integrated(plant, name, inputs, end, force=NONE):
    """x at every arrival in any mode, and the switches, by the second method."""
    modes, n, m = plant.B.shape
    B = np.zeros((modes, n, modes * m + n))
    B[:, :, modes * m :] = np.eye(n)
    for i in range(modes):
        B[i, :, i * m : (i + 1) * m] = plant.B[i]
    free = second.Plant(plant.A, B, H, RULE_OF[name], BOUNDARIES[name])
    arrivals = np.add.outer(np.arange(-5, 60) * H, np.append(plant.delays.ravel(), 0.0))
    edges = np.unique(arrivals.round(12))
    edges = edges[(edges >= 0.0) & (edges <= end + 1e-9)]
    x, states, switches, mode = X0, [X0], [], RULE_OF[name](X0)
    for a, b in itertools.pairwise(edges.tolist()):
        read = [read_by(plant, i, 0.5 * (a + b), inputs) for i in range(modes)]
        u = np.concatenate((np.ravel(read), force))
        x, met = free.flow(x, u, b - a, mode)
        # It also meets boundaries that a mode has on both sides.
        for t, i in met:
            switches += [a + t] if i != mode else []
            mode = i
        mode = free.last
        states.append(x)
    return edges, np.array(states).T, switches


@pytest.mark.parametrize(("delays", "name"), CASES)
def test_a_run_is_that_of_an_event_driven_integration(delays, name):
    plant = plant_with(DELAYS[delays])
    for law in (predictor(plant, RULES[name]), ignoring(plant)):
        inputs = run(law, RULES[name], plant).inputs
        times, states, switches = integrated(plant, name, inputs, 2.0)
        one = run(law, RULES[name], plant, times=times)
        plants.close(one.states, states, 1e-9)
        found = [t for t in one.signal.times[1:] if t < 2.0]
        assert found
        assert found == pytest.approx(switches, abs=1e-8)


def test_a_force_is_felt_by_a_plant_that_its_state_switches():
    plant = plant_with(DELAYS["per mode and input"])
    law, force = ignoring(plant), [StepDisturbance(FORCE)]
    inputs = run(law, RULES["wedge"], plant, imperfections=force).inputs
    times, states, _ = integrated(plant, "wedge", inputs, 2.0, FORCE)
    one = run(law, RULES["wedge"], plant, imperfections=force, times=times)
    plants.close(one.states, states, 1e-9)


@pytest.mark.few(3)
@pytest.mark.parametrize(("delays", "name"), PAIRS)
def test_a_law_with_the_right_model_and_rule_leaves_no_mismatch(delays, name):
    plant = plant_with(DELAYS[delays])
    for x0 in (X0, -2.0 * X0, np.array([0.2, 0.9, -0.4])):
        one = run(predictor(plant, RULES[name]), RULES[name], plant, x0=x0)
        assert one.signal.switches >= 2
        # The last samples are read after the run knows x.
        known = mismatch(one)[:, : -int(np.ceil((plant.delays.max() - plant.delays.min()) / H)) - 1]
        assert np.abs(known).max() <= 1e-13 * np.abs(one.inputs).max()


@pytest.mark.few(1)
@pytest.mark.parametrize("name", RULES)
def test_every_input_is_exact_for_a_model_that_is_not_the_plant(name):
    plant = plant_with(DELAYS["per mode and input"])
    model = plant_with([[0.25, 0.2], [0.3, 0.1], [0.1, 0.34]], 0.95)
    law = predictor(model, RULES[name])
    one = run(law, RULES[name], plant, 2.0)
    past = np.hstack((np.tile([[0.3], [-0.2]], 5), one.inputs))
    for k in range(20):
        again = dt.simulate(
            model, law, RULES[name], one.states[:, k], 0.05, step=H, u0=past[:, k + 1 : k + 5]
        )
        assert np.abs(again.inputs[:, 0] - one.inputs[:, k]).max() <= 1e-12
        assert np.nanmax(np.abs(mismatch(again)[:, 0])) <= 1e-13 * np.abs(one.inputs).max()


@pytest.mark.parametrize(("delays", "name"), PAIRS)
def test_a_run_under_a_rule_is_the_run_along_the_signal_that_it_turned_out_to_be(delays, name):
    plant = plant_with(DELAYS[delays])
    law = dt.AveragedPredictor(plant, soft(plant), allow_unstable=True)
    times = np.linspace(0.0, 3.0, 173)
    one = run(law, RULES[name], plant, times=times)
    along = run(law, one.signal, plant, times=times)
    plants.close(one.states, along.states, 1e-12)
    plants.close(one.inputs, along.inputs, 1e-12)
    for key, value in along.metrics().items():
        assert one.metrics()[key] == pytest.approx(value, rel=1e-9), key


def test_modes_of_other_delays_slide_along_their_boundary():
    # The inputs push each mode at the other: x_0 stays 0, x_1 moves by the mean of the fields.
    A = np.zeros((2, 2, 2))
    B = np.array([[[1.0], [0.5]], [[-1.0], [0.5]]])
    plant = dt.SwitchedSystem(A, B, [[0.3], [0.15]])
    law = dt.DelayedStateFeedback(plant, np.zeros((2, 1, 2)), allow_unstable=True)
    rule = dt.HalfSpace([1.0, 0.0])
    history = np.array([[1.0, 2.0, 3.0]])  # mode 0 reads it from −0.3 on, mode 1 from −0.15
    one = dt.simulate(plant, law, rule, [-0.05, 0.0], 0.3, step=H, u0=history, times=[0.05, 0.1])
    assert "slid along the boundary" in one.message
    # Up to 0.05 mode 0 under u = 1; then f_0 = u_0, f_1 = −u_1: mean x_1' = u_0 u_1/(u_0 + u_1).
    assert one.states[:, 0] == pytest.approx([0.0, 0.025], abs=1e-12)
    assert one.states[:, 1] == pytest.approx([0.0, 0.025 + 0.05 * 3.0 / 4.0], abs=1e-12)


def test_a_law_whose_prediction_slides_leaves_no_mismatch():
    A = np.array([[[0.0, 1.0], [0.0, -0.5]], [[0.0, 1.0], [0.0, -0.5]]])
    B = np.array([[[1.0], [0.5]], [[-1.0], [0.5]]])
    plant = dt.SwitchedSystem(A, B, [[0.25], [0.1]])
    gains = np.array([[[0.3, 0.2]], [[0.4, -0.3]]])
    rule = dt.HalfSpace([1.0, 0.0])
    law = dt.StateDependentPredictor(plant, gains, rule, allow_unstable=True)
    one = dt.simulate(plant, law, rule, [-0.1, 0.05], 1.0, step=H, u0=np.array([[2.0, 2.0, 2.0]]))
    assert "slid along the boundary" in one.message
    assert np.nanmax(np.abs(mismatch(one))) <= 1e-14
