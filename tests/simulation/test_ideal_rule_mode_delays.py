"""The ideal loop under a rule where modes differ in the delay of an input.

Runs are held against an event-driven integration of the delay equation by SciPy's DOP853
(`rule_reading_reference`); along a boundary the equation of the sliding motion is integrated.
"""

import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import deadtime as dt
import plants
from deadtime.simulation.ideal import rule_march
from deadtime.simulation.ideal.rule_parts import Sent
from rule_reading_reference import Loop
from shares import mostly_long
from swinging import (
    BOUNDARIES as swinging_boundaries,
    RULES as swinging_rules,
    WEDGE,
    X0,
    ball,
    soft,
    swinging,
    wedge,
)

FORMS = np.array([np.diag(row) for row in ([1.0, -1.0, 0.3], [-1.0, 1.0, -0.3], [0.0, 0.2, 0.4])])


def largest_form(x):
    return int(np.argmax([x @ S @ x for S in FORMS]))


RULES = swinging_rules | {"forms": dt.QuadraticRegions(FORMS)}
BOUNDARIES = swinging_boundaries | {
    "forms": [lambda x, S=FORMS[i] - FORMS[k]: x @ S @ x for i, k in ((0, 1), (0, 2), (1, 2))]
}
FUNCTION_OF = {
    "wedge": wedge,
    "wedge as a function": wedge,
    "ball": ball,
    "forms": largest_form,
}
DELAYS = [
    [[0.3, 0.12], [0.2, 0.12], [0.25, 0.21]],
    [[0.1, 0.3], [0.25, 0.07], [0.18, 0.4]],
    [[0.5], [0.2], [0.35]],
]
HISTORIES = {
    "constant": np.array([[0.3], [-0.2]]),
    "held": np.array([[0.5, -0.6, 0.9, 0.2], [-0.7, 0.4, 1.0, -0.3]]),
}
TIMES = np.linspace(0.0, 3.0, 61)


def plant_with(delays):
    one = swinging()
    return dt.SwitchedSystem(one.A, one.B, delays)


def ideal(plant, name, u0, times=TIMES, horizon=3.0):
    law = dt.StateDependentPredictor(plant, soft(plant), RULES[name])
    return dt.simulate(plant, law, RULES[name], X0, horizon, step=None, u0=u0, times=times)


CASES = [(k, name, held) for k in range(3) for name in RULES for held in HISTORIES]


@pytest.mark.parametrize(
    ("number", "name", "history"),
    mostly_long(CASES, (0, "wedge", "held"), (1, "wedge as a function", "constant")),
)
def test_a_run_is_that_of_the_delay_equation(number, name, history):
    plant, held = plant_with(DELAYS[number]), HISTORIES[history]
    longest, count = plant.longest_delay, held.shape[1]

    def before(t):
        return held[:, min(max(int((t + longest) / longest * count), 0), count - 1)]

    jumps = np.linspace(-longest, 0.0, count + 1)[:-1]
    gains = soft(plant)
    second = Loop(plant, gains, FUNCTION_OF[name], BOUNDARIES[name], X0, before, jumps)
    states = np.array([second.march(t) for t in TIMES]).T
    one = ideal(plant, name, held)
    plants.close(one.states, states, 1e-10)
    found = [t for t in one.signal.times[1:] if t < 3.0]
    assert len(found) >= 3
    assert found == pytest.approx(second.switches, abs=1e-9)
    assert one.mismatch is not None
    assert np.nanmax(np.abs(one.mismatch)) <= 1e-12
    sent = np.arange(0.05, 2.4, 0.1)
    inputs = [[second.was_sent(j, t, t + 1e-9) for t in sent] for j in range(2)]
    plants.close(one.record.inputs_at(sent).T, np.array(inputs), 1e-10)


# Both modes point at x₁ = 0; x₂ falls as inputs say, x₁' = 1 in mode 0 and −x₂ in mode 1.
FACING = np.array([[[0, 0, 1], [0, 0, 0], [0, 0, 0]], [[0, -1, 0], [0, 0, 0], [0, 0, 0]]])
PUSHED = np.array([[[0.0, 0], [1, 1], [0, 0]]] * 2)
ACROSS = dt.HalfSpace([1.0, 0.0, 0.0])
FALL = np.array([[[0.0, -1, 0], [0, -0.5, 0]], [[0, -2, 0], [0, -1, 0]]])


@pytest.mark.parametrize("later", [0.8, 0.3])
def test_along_a_boundary_both_modes_read_by_their_own_delays(later):
    plant = dt.SwitchedSystem(FACING, PUSHED, [[0.5, 0.8], [later, 0.8]])
    law = dt.StateDependentPredictor(plant, FALL, ACROSS, allow_unstable=True)
    times = np.linspace(0.0, 1.6, 33)
    one = dt.simulate(plant, law, ACROSS, [-0.6, 3.0, 1.0], 1.6, None, times=times)
    assert one.message.endswith("once, for 1 s in all, first at t = 0.6 s.")
    begin = 3.0 * np.exp(-0.1)  # from 0.5 on mode 0 reads −x₂, from 0.6 on x slides

    def x2_before(t, solutions):
        if t <= 0.6:
            return 3.0 * np.exp(-max(t - 0.5, 0.0))
        return next(s for end, s in solutions if t <= end + 1e-12)(t)[0]

    def sent(t, solutions):
        """What the first input was sent at t, by who read it first."""
        if t < 0.0:
            return 0.0
        if later == 0.8:
            return -x2_before(t + 0.5, solutions)
        if t < 0.1:
            return -x2_before(t + 0.5, solutions)
        return -2.0 * (begin if t < 0.3 else x2_before(t + 0.3, solutions))

    solutions, x2, now = [], begin, 0.6
    marks = np.unique(np.round([*np.arange(0.6, 2.45, 0.1), 0.85, 0.65], 12))
    for end in marks[1:]:
        middle = 0.5 * (now + end)

        def slope(t, x, middle=middle):
            own = np.array([-x[0], -2.0 * x[0]])
            if later == 0.8:
                own[1] = sent(t - 0.8, solutions) if middle > 0.8 else 0.0
            else:
                own[0] = sent(t - 0.5, solutions)
            second = np.array([-0.5, -1.0]) * x[0] if middle > 0.8 else np.zeros(2)
            share = np.array([x[0], 1.0]) / (1.0 + x[0])
            return [share @ (own + second)]

        done = solve_ivp(
            slope, (now, end), [x2], "DOP853", rtol=1e-13, atol=1e-14, dense_output=True
        )
        solutions.append((end, done.sol))
        x2, now = done.y[0, -1], end
    exact = [x2_before(t, solutions) for t in times]
    plants.close(one.states[1], np.array(exact), 1e-10)
    early = np.arange(0.02, 1.3, 0.1)
    plants.close(
        one.record.inputs_at(early)[:, 0], np.array([sent(t, solutions) for t in early]), 1e-10
    )


def test_a_mode_that_is_never_entered_changes_nothing_by_its_delay():
    plant = plant_with([0.3, 0.12])
    own = plant.delays.copy()
    own[2] = 0.2, 0.4
    one, other = (
        dt.simulate(
            each,
            dt.StateDependentPredictor(each, soft(each), WEDGE),
            WEDGE,
            X0,
            1.0,
            None,
            u0=[0.3, -0.2],
        )
        for each in (plant, plant_with(own))
    )
    assert sorted(set(one.signal.modes.tolist())) == [0, 1]
    plants.close(other.states, one.states, 1e-12)
    plants.close(other.inputs, one.inputs, 1e-12)


@pytest.mark.long
def test_the_digital_loop_tends_to_it_with_order_one():
    plant = plant_with(DELAYS[0])
    law = dt.StateDependentPredictor(plant, soft(plant), WEDGE)
    one = ideal(plant, "wedge", HISTORIES["constant"])
    errors = []
    for h in (0.01, 0.005, 0.0025):
        digital = dt.simulate(plant, law, WEDGE, X0, 3.0, h, u0=[0.3, -0.2], times=TIMES)
        errors.append(np.abs(digital.states - one.states).max())
    slopes = np.diff(np.log(errors)) / np.log(0.5)
    assert slopes == pytest.approx(np.ones(2), abs=0.2)
    assert errors[0] < 0.01


def test_a_run_that_cannot_go_on_ends_when_the_last_input_is_not_known():
    up = np.array([[0.0, 1.0], [0.0, 0.0]])
    plant = dt.SwitchedSystem([up, -up], np.ones((2, 2, 2)), [[0.2, 0.5], [0.3, 0.5]])
    rule = dt.switching.FunctionRule(lambda x: int(x[0] >= 0.0))
    law = dt.StateDependentPredictor(plant, np.zeros((2, 2, 2)), rule, allow_unstable=True)
    one = dt.simulate(plant, law, rule, [-2.0, 1.0], 3.0, None)
    assert one.end == pytest.approx(1.5, abs=1e-12)
    assert "chattering at t = 2 s" in one.message
    with pytest.raises(dt.ArgumentError, match=r"x0 leads to no .* chattering at t = 0\.3"):
        dt.simulate(plant, law, rule, [-0.3, 1.0], 3.0, None)


def test_a_loop_that_diverges_ends_and_says_so():
    plant = dt.SwitchedSystem([[[9.0]], [[9.0]]], [[[1.0]], [[1.0]]], [[0.5], [0.4]])
    law = dt.StateDependentPredictor(
        plant, [[[0.0]], [[0.0]]], dt.HalfSpace([1.0]), allow_unstable=True
    )
    one = dt.simulate(plant, law, dt.HalfSpace([1.0]), [1.0], 40.0, None)
    assert one.diverged
    assert one.end < 40.0


@pytest.mark.parametrize("number", [0, 1])
def test_nothing_is_read_before_it_is_known(number, monkeypatch):
    """Nor by modes not in force, whose reading says on which side of a boundary they lead."""
    asked, at = [], Sent.at

    def watched(self, times):
        asked.append(times.max() - self.newest)
        return at(self, times)

    monkeypatch.setattr(Sent, "at", watched)
    one = ideal(plant_with(DELAYS[number]), "wedge", HISTORIES["constant"], TIMES[:21], 1.0)
    assert one.signal.switches >= 1
    assert max(asked) <= 1e-12


def test_delays_that_hardly_differ_are_as_good_as_alike():
    delays = np.tile([0.3, 0.12], (3, 1))
    delays[1, 0] += 1e-6
    one, other = (
        ideal(plant_with(each), "wedge", HISTORIES["constant"], TIMES[:21], 1.0)
        for each in (delays, delays[0])
    )
    plants.close(one.states, other.states, 1e-5)


def test_a_run_of_too_many_pieces_is_refused_by_name(monkeypatch):
    monkeypatch.setattr(rule_march, "MOST_PIECES", 40)
    message = (
        "step must be given: the ideal loop under this rule takes more than 40 pieces: shorten "
        "the horizon, make delays that hardly differ equal, or give a step."
    )
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        ideal(plant_with(DELAYS[0]), "wedge", HISTORIES["constant"])
    with pytest.raises(
        dt.ArgumentError, match=r"more than 4e\+01 pieces of .*: shorten it, or give"
    ):
        ideal(plant_with(DELAYS[0]), "wedge", HISTORIES["constant"], horizon=30.0)
