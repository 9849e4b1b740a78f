"""The ideal loop under a rule where every input has a delay of its own.

The second method integrates the loop by SciPy's DOP853 with event detection, A + Σ b_j K_j over the
inputs that have arrived, from one change of what is read to the next; it shares no code.
"""

import itertools

import numpy as np
import pytest

import deadtime as dt
import plants
import rule_reference as second
from deadtime.simulation.ideal.ideal_run import IdealRecord
from deadtime.switching import FunctionRule, HalfSpace
from sectors import EDGES, PLANE, SECTORS, sector
from swinging import BOUNDARIES, RULES, X0, soft, swinging, wedge

RULE_OF = {"wedge": wedge, "wedge as a function": wedge, "ball": RULES["ball"]}
DELAYS = [0.3, 0.12]
HISTORIES = {
    "constant": [0.3, -0.2],
    "held": np.array([[0.5, -0.6, 0.9, 0.2], [-0.7, 0.4, 1.0, -0.3]]),
}


def plant_with(delays):
    one = swinging()
    return dt.SwitchedSystem(one.A, one.B, delays)


def ideal(plant, name, u0=None, horizon=3.0, **options):
    law = dt.StateDependentPredictor(plant, soft(plant), RULES[name])
    return dt.simulate(plant, law, RULES[name], X0, horizon, step=None, u0=u0, **options)


def mismatch(one):
    assert one.mismatch is not None
    return one.mismatch


def integrated(plant, gains, name, history, end):
    """Edges between which what is read stays the same, x there, and the switches."""
    delays, longest = plant.delays[0], plant.delays.max()
    held = np.reshape(history, (2, -1))
    count = held.shape[1]
    changes = np.add.outer(delays, np.linspace(-longest, 0.0, count + 1)).ravel()
    edges = np.unique(np.concatenate((changes, np.linspace(0.0, end, 61), delays)).round(12))
    edges = edges[(edges >= 0.0) & (edges <= end)]
    x, states, switches, mode = X0, [X0], [], RULE_OF[name](X0)
    for a, b in itertools.pairwise(edges.tolist()):
        middle, u, A = 0.5 * (a + b), np.zeros(2), plant.A.copy()
        for j in range(2):
            if middle < delays[j]:
                u[j] = held[j, int((middle - delays[j] + longest) / longest * count)]
            else:
                A += plant.B[:, :, j : j + 1] @ gains[:, j : j + 1]
        free = second.Plant(A, plant.B, longest, RULE_OF[name], BOUNDARIES[name])
        x, met = free.flow(x, u, b - a, mode)
        for t, i in met:
            switches += [a + t] if i != mode else []
            mode = i
        mode = free.last
        states.append(x)
    return edges, np.array(states).T, switches


@pytest.mark.few(3)
@pytest.mark.parametrize("history", HISTORIES)
@pytest.mark.parametrize("delays", [DELAYS, DELAYS[::-1]])
@pytest.mark.parametrize("name", RULES)
def test_a_run_is_that_of_an_event_driven_integration(name, delays, history):
    plant, u0 = plant_with(delays), HISTORIES[history]
    times, states, switches = integrated(plant, soft(plant), name, u0, 3.0)
    one = ideal(plant, name, u0, times=times)
    plants.close(one.states, states, 1e-10)
    found = [t for t in one.signal.times[1:] if t < 3.0]
    assert len(found) >= 2
    assert found == pytest.approx(switches, abs=1e-9)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", RULES)
def test_every_input_is_the_feedback_of_the_state_that_it_meets(name):
    plant = plant_with(DELAYS)
    gains = soft(plant)
    times, states, _ = integrated(plant, gains, name, HISTORIES["constant"], 3.0)
    for j, delay in enumerate(DELAYS):
        after = times >= delay
        one = ideal(plant, name, HISTORIES["constant"], times=times[after] - delay)
        met = [gains[RULE_OF[name](x), j] @ x for x in states.T[after]]
        plants.close(one.inputs[j], np.array(met), 1e-9)
        assert np.abs(mismatch(one)).max() <= 1e-12


# Both closed loops point at x₁ = 0; the second input reads the line for longer than the first.
FACING = dt.SwitchedSystem(
    [[[0, 0, 1], [0, 0, 0], [0, 0, 0]], [[0, -1, 0], [0, 0, 0], [0, 0, 0]]],
    [[[0, 0], [1, 1], [0, 0]]] * 2,
    [0.5, 0.8],
)
ACROSS = HalfSpace([1.0, 0.0, 0.0])


def test_a_run_that_slides_before_all_inputs_have_arrived_has_a_closed_form():
    gains = np.array([[[0.0, -1.0, 0.0], [0.0, -0.5, 0.0]], [[0.0, -2.0, 0.0], [0.0, -1.0, 0.0]]])
    law = dt.StateDependentPredictor(FACING, gains, ACROSS, allow_unstable=True)
    times = np.linspace(0.0, 2.0, 41)
    one = dt.simulate(FACING, law, ACROSS, [-0.5, 3.0, 1.0], 2.0, None, times=times)
    # x₁' = 1 in mode 0 and −x₂ in mode 1, so that on x₁ = 0 their weights are x₂ and 1 over 1 + x₂,
    # and x₂' = −s x₂ and −2 s x₂, s = 1 and from 0.8 on 1.5, are x₂' = −s (2 x₂ + x₂²)/(1 + x₂) in
    # the mean: q = x₂ (x₂ + 2) has q' = −2 s q.
    past = np.maximum(times - 0.5, 0.0) + 0.5 * np.maximum(times - 0.8, 0.0)
    q = 15.0 * np.exp(-2.0 * past)
    np.testing.assert_allclose(one.states[1], np.sqrt(1.0 + q) - 1.0, rtol=1e-12)
    assert np.abs(one.states[0, times >= 0.5]).max() <= 1e-14
    assert one.message.endswith("once, for 1.5 s in all, first at t = 0.5 s.")
    # It came from mode 0, and so is the gain.
    for j, delay in enumerate(FACING.delays[0]):
        past = times + delay - 0.5 + 0.5 * np.maximum(times + delay - 0.8, 0.0)
        x2 = np.sqrt(1.0 + 15.0 * np.exp(-2.0 * past)) - 1.0
        np.testing.assert_allclose(one.inputs[j], gains[0, j, 1] * x2, rtol=1e-11)


def test_inputs_that_share_their_delays_in_pairs_give_the_run_of_their_sums():
    plant = plant_with(DELAYS)
    gains, order = soft(plant), [0, 1, 0]
    B = plant.B[:, :, order] * np.array([0.25, 1.0, 0.75])
    split = dt.SwitchedSystem(plant.A, B, np.array(DELAYS)[order])
    law = dt.StateDependentPredictor(split, gains[:, order], RULES["wedge"])
    held = HISTORIES["held"]
    one, times = ideal(plant, "wedge", held), np.linspace(0.0, 3.0, 1001)
    other = dt.simulate(split, law, RULES["wedge"], X0, 3.0, None, u0=held[order], times=times)
    plants.close(other.states, one.states, 1e-12)
    plants.close(other.inputs, one.inputs[order], 1e-12)


def test_energy_is_the_integral_of_the_inputs_on_segments_of_their_own():
    one = ideal(plant_with(DELAYS), "wedge", HISTORIES["held"])
    assert isinstance(one.record, IdealRecord)
    edges = one.record.inputs.edges
    edges = np.unique(np.append(edges[(edges >= 0.0) & (edges <= 3.0)], [0.0, 3.0]))
    points, weights = np.polynomial.legendre.leggauss(14)
    middles, halves = (edges[1:] + edges[:-1]) / 2.0, np.diff(edges) / 2.0
    u = one.record.inputs_at((middles[:, None] + halves[:, None] * points).ravel())
    energy = np.sum((halves[:, None] * weights).ravel() * (u**2).sum(axis=1))
    assert one.metrics()["energy"] == pytest.approx(energy, rel=1e-11)


def test_a_run_that_cannot_go_on_ends_the_longest_delay_earlier():
    # x₁' = ±x₂ with x₂ = 1: from x₁ < 0 and x₁ > 0 to 0, which is at t = 2.
    up = np.array([[0.0, 1.0], [0.0, 0.0]])
    plant = dt.SwitchedSystem([up, -up], np.ones((2, 2, 2)), [0.2, 0.5])
    rule = FunctionRule(lambda x: int(x[0] >= 0.0))
    law = dt.StateDependentPredictor(plant, np.zeros((2, 2, 2)), rule, allow_unstable=True)
    one = dt.simulate(plant, law, rule, [-2.0, 1.0], 3.0, None)
    assert one.end == pytest.approx(1.5, abs=1e-12)
    assert "chattering at t = 2 s" in one.message
    assert np.abs(mismatch(one)).max() == 0.0
    message = "x0 leads to no ideal loop, chattering at t = 0.3 s: both vector fields point at the"
    with pytest.raises(dt.ArgumentError, match=message) as refused:
        dt.simulate(plant, law, rule, [-0.3, 1.0], 3.0, None)
    assert "before all inputs of the law have arrived, at 0.5 s: give a step" in str(refused.value)


@pytest.mark.parametrize(("seed", "since"), [(3, 0.317), (9, 1.021)])
def test_a_plane_of_three_modes_slides_as_an_integration_does_also_past_an_arrival(seed, since):
    delays, history, rng = np.array([0.37, 0.2]), [0.7, -0.4], np.random.default_rng(seed)
    B = np.concatenate((PLANE.B, rng.normal(size=(3, 2, 1))), axis=2)
    plant = dt.SwitchedSystem(PLANE.A, B, delays)
    gains, x = 0.8 * rng.normal(size=(3, 2, 2)), rng.normal(size=2)
    law = dt.StateDependentPredictor(plant, gains, SECTORS, allow_unstable=True)
    times = np.array([0.0, 0.1, 0.2, 0.3, 0.37, 0.5, 0.8, 1.2, 1.6, 2.0])
    one = dt.simulate(plant, law, SECTORS, x, 2.0, None, u0=history, times=times)
    assert f"first at t = {since}" in one.message
    boundaries = [lambda x, row=row: float(row @ x) for row in EDGES]
    states, mode = [x], None
    for a, b in itertools.pairwise(times.tolist()):
        arrived = delays <= a
        A = plant.A + plant.B @ (gains * arrived[:, None])
        free = second.Plant(A, plant.B, 0.37, sector, boundaries)
        x, _ = free.flow(x, np.where(arrived, 0.0, history), b - a, mode)
        mode = free.last
        states.append(x)
    plants.close(one.states, np.array(states).T, 1e-10)
    assert np.abs(mismatch(one)).max() <= 1e-12
