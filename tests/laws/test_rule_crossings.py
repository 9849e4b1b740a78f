"""Where a state crosses a boundary agrees with closed forms and an integration with events."""

from itertools import pairwise

import numpy as np
import pytest

import deadtime as dt
import plants
import rule_reference as second
from deadtime.laws import StateDependentPredictor
from deadtime.switching import FunctionRule, HalfSpace, Polyhedra
from swinging import (
    BOUNDARIES,
    HISTORY,
    PLANT,
    RULES,
    X0,
    H,
    idle,
    predictor,
    rotating,
    run,
    soft,
    swinging,
    wedge,
)


def passing(a, b, start, target, u):
    """When x' = a x + b u reaches `target` from `start`."""
    rest = -b * u / a
    return np.log((target - rest) / (start - rest)) / a


# -- closed forms ------------------------------------------------------------------------------


def test_crossings_of_a_scalar_plant_are_at_their_closed_form_to_1e_12():
    a, b, u = np.array([0.7, -0.4, 0.3]), np.array([1.0, 2.0, 0.5]), 1.5
    plant = plants.scalar(a, b, delay=2.0)
    law = dt.DelayedStateFeedback(plant, np.zeros((3, 1, 1)), allow_unstable=True)
    first = passing(a[0], b[0], 0.1, 1.0, u)
    switches = [first, first + passing(a[1], b[1], 1.0, 2.0, u)]
    intervals = Polyhedra([([[1.0]], [1.0]), ([[-1.0], [1.0]], [-1.0, 2.0]), ([[-1.0]], [-2.0])])
    for rule in (intervals, lambda x: int(x[0] > 1.0) + int(x[0] > 2.0)):
        for step in (0.01, 0.37, 1.0):
            one = run(law, rule, plant, [0.1], 1.5, u, step)
            assert one.signal.modes.tolist() == [0, 1, 2]
            assert np.abs(one.signal.times[1:] - switches).max() <= 1e-12
            later = -b[2] * u / a[2] + (2.0 + b[2] * u / a[2]) * np.exp(a[2] * (1.5 - switches[1]))
            assert one.states[0, -1] == pytest.approx(later, rel=1e-12)


@pytest.mark.parametrize("step", [0.05, 0.3, 3.0])
def test_a_rotation_switches_speed_at_its_closed_form_for_many_turns(step):
    # Mode 1 where x₁ ≥ 0: half a turn takes π/w of the half's speed.
    plant = rotating([1.0, 1.7])
    one = run(idle(plant), HalfSpace([1.0, 0.0]), plant, [1.0, 0.0], 60.0, None, step)
    quarter, halves = 0.5 * np.pi / 1.7, np.array([np.pi / 1.0, np.pi / 1.7])
    count = one.signal.switches
    expected = quarter + np.concatenate(([0.0], np.cumsum(np.resize(halves, count - 1))))
    assert count > 20
    assert np.abs(one.signal.times[1:] - expected).max() <= 1e-12
    assert expected[-1] + halves[(count - 1) % 2] > 60.0


@pytest.mark.parametrize("width", [1e-2, 1e-4, 1e-6])
def test_a_slab_entered_and_left_within_one_step_is_found(width):
    # cos θ > cos(width) only for |θ| < width; the step is 0.4 and θ passes 0 in the middle of one.
    plant = rotating([1.0, 1.0])
    edge = np.cos(width)
    angle = -0.61
    x0 = [np.cos(angle), -np.sin(angle)]
    one = run(idle(plant), HalfSpace([1.0, 0.0], edge), plant, x0, 2.0, None, 0.4)
    # The edge itself is rounded: its angle is good to 1e-16/width.
    assert one.signal.modes.tolist() == [0, 1, 0]
    assert np.abs(one.signal.times[1:] - [0.61 - width, 0.61 + width]).max() <= 1e-15 / width
    missed = FunctionRule(lambda x: int(x[0] >= edge), samples=4)
    assert run(idle(plant), missed, plant, x0, 2.0, None, 0.4).signal.switches == 0


def test_more_samples_find_what_few_samples_of_a_function_miss():
    plant, edge = rotating([1.0, 1.0]), np.cos(0.01)
    x0 = [np.cos(-0.61), -np.sin(-0.61)]
    fine = FunctionRule(lambda x: int(x[0] >= edge), samples=50)
    assert run(idle(plant), fine, plant, x0, 2.0, None, 0.4).signal.switches == 2


# -- a second method ---------------------------------------------------------------------------


@pytest.mark.few(2)
@pytest.mark.parametrize("model_delay", [0.234, 0.31, 0.1])
@pytest.mark.parametrize("name", RULES)
def test_the_loop_equals_an_integration_with_event_detection(name, model_delay):
    truth, model = swinging(), swinging(model_delay, seed=4)
    gains = soft(model)
    law = StateDependentPredictor(model, gains, RULES[name])
    history = np.random.default_rng(8).normal(size=(2, 4 if model_delay == 0.31 else 3))
    one = run(law, RULES[name], truth, u0=history, horizon=2.5)

    rule = RULES[name] if callable(RULES[name]) else RULES[name].__call__
    pair = [second.Plant(p.A, p.B, p.delay, rule, BOUNDARIES[name]) for p in (truth, model)]
    control = second.predictor(pair[1], gains, H)
    states, inputs, switches = second.run(pair[0], control, X0, history.T, H, 26)
    plants.close(one.states.T, states, 1e-11)
    plants.close(one.inputs.T, inputs, 1e-11)
    found = one.signal.times[1:] <= 2.5
    assert len(switches) >= 1
    expected = np.array([time for time, _ in switches if time <= 2.5])
    assert np.abs(one.signal.times[1:][found] - expected).max() <= 1e-11


def test_a_law_with_a_rule_on_a_plant_along_a_signal_equals_that_integration():
    signal = plants.off_grid()
    law = predictor()
    one = run(law, signal, horizon=1.2)
    model = second.Plant(PLANT.A, PLANT.B, PLANT.delay, wedge, BOUNDARIES["wedge"])
    control = second.predictor(model, soft(PLANT), H)
    update = law.online(H)
    pipe = list(HISTORY.T)
    for k, x in enumerate(one.states.T):
        u = control(x, pipe)
        plants.close(one.inputs[:, k], u, 1e-9)
        plants.close(update(x, np.array(pipe), 0, 0), u, 1e-9)
        pipe.append(one.inputs[:, k])
    # The plant follows the signal: the same inputs under a law that is a table of nothing.
    times = np.linspace(0.0, 1.2, 37)
    fine = run(law, signal, horizon=1.2, times=times)
    for i in range(36):
        a, b = times[i], times[i + 1]
        cuts = np.concatenate((signal.times, np.arange(15) * H + PLANT.delay - 0.3))
        cuts = [a, *np.sort(cuts[(cuts > a + 1e-12) & (cuts < b - 1e-12)]), b]
        x = fine.states[:, i]
        for low, high in pairwise(cuts):
            middle = 0.5 * (low + high)
            mode, held = int(signal([middle])[0]), int(np.floor((middle - 0.234) / H)) + 3
            Phi, Gamma = plants.held(PLANT.A[mode], PLANT.B[mode], high - low)
            x = Phi @ x + Gamma @ pipe[held]
        plants.close(fine.states[:, i + 1], x, 1e-11)
