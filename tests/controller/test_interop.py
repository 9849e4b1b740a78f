"""Laws in python-control: its simulator gives the loop that ours gives."""

import itertools
import sys

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.controller import law_to_control, loop_to_control, plant_to_control
from observed_laws import LAWS as OBSERVED

control = pytest.importorskip("control")

GENERIC = plants.generic()
STEP = 0.05
TIMES = STEP * np.arange(61)


@pytest.mark.parametrize("name", [name for name in plants.LAWS if name != "exact"])
def test_python_control_closes_the_loop_as_simulate_does(name):
    """A plant that is not the model, its delay no multiple of the period."""
    plant = dt.SwitchedSystem(1.03 * GENERIC.A, 0.98 * GENERIC.B, 0.251)
    law = plants.LAWS[name](GENERIC)
    signal = dt.SwitchingSignal([0.0, 0.45, 0.6, 1.1, 1.9], [0, 2, 1, 0, 2])
    loop, initial = loop_to_control(plant, law, STEP)
    initial[:3] = 1.0, -1.0, 0.5
    modes = np.array([signal(t + 1e-9) for t in TIMES], float)
    found = control.input_output_response(loop, TIMES, modes, initial)
    run = dt.simulate(plant, law, signal, initial[:3], TIMES[-1], STEP)
    plants.close(found.outputs[:3], run.states, 1e-12)
    plants.close(found.outputs[3:, :-1], run.inputs[:, :-1], 1e-12)


OWN = np.array([[0.312, 0.07], [0.2, 0.161], [0.05, 0.243]])


def of_definition(plant, table, signal, x0, periods):
    """States and inputs at the samples: what arrives when by the delays alone, SciPy's exponential.

    Switches lie on the grid. Before 0 all inputs are 0.
    """
    from scipy.linalg import expm

    n, m = plant.states, plant.inputs
    u, x, states = [], np.array(x0, float), []
    modes = np.array([signal(k * STEP + 1e-9) for k in range(periods)])
    rows = table.rows(modes)
    for k in range(periods):
        states.append(x)
        past = [u[k - j] if k >= j else np.zeros(m) for j in range(1, table.taps + 1)]
        given = sum(G @ one for G, one in zip(table.input_gain[rows[k]], past, strict=True))
        u.append(table.state_gain[rows[k]] @ x + given)
        A, B, delays = plant.A[modes[k]], plant.B[modes[k]], plant.delays[modes[k]]
        cuts = sorted({0.0, STEP, *(delays % STEP).tolist()})
        for a, b in itertools.pairwise(cuts):
            sent = np.floor(k + (0.5 * (a + b) - delays) / STEP).astype(int)
            acting = [u[i][j] if i >= 0 else 0.0 for j, i in enumerate(sent)]
            Z = np.zeros((n + m, n + m))
            Z[:n] = np.hstack((A, B))
            x = (expm(Z * (b - a)) @ np.concatenate((x, acting)))[:n]
    return np.array(states).T, np.array(u).T


@pytest.mark.parametrize("name", ["averaged", "averaged, dwell-aware", "expected", "delayed"])
def test_with_several_delays_the_loop_is_that_of_their_definition(name):
    """Another plant than the model's, its own delays per mode and input."""
    model = dt.SwitchedSystem(GENERIC.A, GENERIC.B, OWN)
    plant = dt.SwitchedSystem(1.03 * GENERIC.A, 0.98 * GENERIC.B, OWN + 0.021)
    law = plants.LAWS[name](model)
    signal = dt.SwitchingSignal([0.0, 0.45, 0.6, 1.1, 1.9], [0, 2, 1, 0, 2])
    loop, initial = loop_to_control(plant, law, STEP)
    initial[:3] = 1.0, -1.0, 0.5
    modes = np.array([signal(t + 1e-9) for t in TIMES], float)
    found = control.input_output_response(loop, TIMES, modes, initial)
    states, inputs = of_definition(plant, law.digital(STEP), signal, initial[:3], TIMES.size)
    plants.close(found.outputs[:3], states, 1e-12)
    plants.close(found.outputs[3:], inputs, 1e-12)


def test_the_loop_of_several_delays_grows_as_it_is_said_to():
    """With a mode held the loop is linear: the spectral radius of its matrix is e^(rate h)."""
    plant = dt.SwitchedSystem(GENERIC.A, GENERIC.B, OWN)
    law = plants.LAWS["averaged"](plant)
    loop, initial = loop_to_control(plant, law, STEP)
    for mode in range(3):
        starts = np.eye(initial.size)[:-2] + initial
        matrix = [loop.dynamics(0.0, start, [float(mode)])[:-2] for start in starts]
        rate = np.log(np.abs(np.linalg.eigvals(matrix)).max()) / STEP
        assert rate == pytest.approx(dt.growth_rate(plant, law, mode, STEP), abs=1e-8)


def test_the_age_of_the_first_mode_is_the_one_given():
    law = plants.LAWS["mean, dwell-aware"](GENERIC)
    signal = dt.SwitchingSignal([0.0], [1], initial_age=0.2)
    loop, initial = loop_to_control(GENERIC, law, STEP, mode_age=4)
    initial[:3] = 1.0, -1.0, 0.5
    found = control.input_output_response(loop, TIMES, np.ones(TIMES.size), initial)
    run = dt.simulate(GENERIC, law, signal, initial[:3], TIMES[-1], STEP)
    plants.close(found.outputs[:3], run.states, 1e-12)


def test_without_an_input_the_plant_is_its_exponential():
    from scipy.linalg import expm

    system = plant_to_control(GENERIC, 0.1)
    given = np.vstack((np.zeros((2, 11)), np.full((1, 11), 1.0)))
    initial = np.concatenate(([1.0, -1.0, 0.5], np.zeros(6)))
    found = control.input_output_response(system, 0.1 * np.arange(11), given, initial)
    plants.close(found.outputs[:, -1], expm(GENERIC.A[1]) @ initial[:3], 1e-13)


def test_what_is_no_table_and_what_is_no_mode_are_refused_by_name():
    rule = dt.StateDependentPredictor(GENERIC, plants.gains(GENERIC), lambda x: int(x[0] > 0.0))
    for law, why in ((plants.LAWS["exact"](GENERIC), "needs a preview"), (rule, "is no table")):
        with pytest.raises(dt.ArgumentError, match=why):
            law_to_control(law, STEP)
    system = plant_to_control(GENERIC, STEP)
    with pytest.raises(dt.ArgumentError, match=r"mode must be in 0\.\.2 at every sample, got 7"):
        system.dynamics(0.0, np.zeros(system.nstates), np.array([0.0, 0.0, 7.0]))


def test_a_law_of_another_plant_is_refused_before_anything_runs():
    law = plants.LAWS["averaged"](GENERIC)
    with pytest.raises(dt.ArgumentError, match="law"):
        loop_to_control(plants.scalar([0.3, 0.2, 0.1]), law, STEP)


def test_where_python_control_is_missing_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    plant = dt.problems.paper().plant
    with pytest.raises(dt.ArgumentError, match=r'pip install "\.\[control\]"'):
        plant_to_control(plant, 0.3)


@pytest.mark.parametrize("name", ["servo", "dwell-aware", "observed", "rows by mode", "one mode"])
def test_with_an_observer_the_loop_is_that_of_simulate(name):
    """A plant that is not the model, first estimates that are not 0, references that move."""
    law = OBSERVED[name]()
    step, modes, n = law.observer.step, law.plant.modes, law.plant.states
    plant = law.plant.like(1.01 * law.plant.A, 0.99 * law.plant.B)
    times, x0 = step * np.arange(121), np.linspace(1.0, -1.0, n)
    signal = dt.SwitchingSignal.constant(0)
    if modes > 1:
        signal = dt.SwitchingSignal(step * np.array([0.0, 20.0, 50.0, 77.0]), [0, 2, 1, 0])
    loop, initial = loop_to_control(plant, law, step)
    initial[:n] = x0
    given = np.array([[signal(t + 1e-9) for t in times]], float)
    if law.reference is not None:
        given = np.vstack((given, law.reference.along(times).T))
    assert loop.input_labels == ["mode", *(f"r[{i}]" for i in range(len(given) - 1))]
    found = control.input_output_response(loop, times, given, initial)
    run = dt.simulate(plant, law, signal, x0, times[-1], step)
    plants.close(found.outputs[:n], run.states, 1e-12)
    plants.close(found.outputs[n:, :-1], run.inputs[:, :-1], 1e-12)


def test_the_loop_of_an_observer_grows_as_it_is_said_to():
    """With a mode held, once begun, it is linear: its spectral radius is e^(rate h)."""
    law = OBSERVED["observed"]()
    step = law.observer.step
    loop, initial = loop_to_control(law.plant, law, step)
    for mode in range(3):
        begun = np.zeros(initial.size)
        begun[-2:] = mode, 0.0
        starts = np.eye(initial.size)[:-2] + begun
        matrix = [loop.dynamics(0.0, start, [float(mode)])[:-2] for start in starts]
        rate = np.log(np.abs(np.linalg.eigvals(matrix)).max()) / step
        assert rate == pytest.approx(dt.growth_rate(law.plant, law, mode, step), abs=1e-7)
