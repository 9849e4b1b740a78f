"""`Controller` of a law on a belief from outputs, and its C: the inputs of `simulate`."""

import ctypes
import math
import re
import subprocess

import numpy as np
import pytest

import deadtime as dt
import plants
from belief_laws import OUTPUTS, PLANT, SEMI, STEP, X0, from_outputs
from c_code import Library, needs_compiler, needs_frama_c
from deadtime.controller import Status
from deadtime.controller.export.compiler import self_check
from deadtime.imperfections import Dropout, Noise, WhiteDisturbance
from shares import mostly_long


def paper():
    plant, model = plants.paper(), dt.Markov([[0.0, 1.25], [1.25, 0.0]])
    options = {"covariance": 0.1, "disturbance": 1e-4, "noise": 0.01}
    filt = dt.OutputModeFilter(plant, model, 0.02, [[1.0, 0.0]], **options)
    return dt.BeliefPredictor(dt.ExpectedPredictor(plant, plants.gains(plant), model), filt)


LAWS = {
    "ages": lambda: from_outputs(SEMI),
    "mode": from_outputs,
    "at samples": lambda: from_outputs(switches="samples"),
    "observers": lambda: from_outputs(C=dt.luenberger(PLANT, OUTPUTS, [-3.0, -4.0, -5.0], STEP)),
    "paper": paper,
}
FEW = ("ages",)


def record(law, horizon=4.0, lost=0.1):
    """A run in noise of a plant that is not the model, and what it was told."""
    plant = dt.SwitchedSystem(1.03 * PLANT.A, 0.98 * PLANT.B, PLANT.delays)
    if law.plant.states == 2:
        plant = law.plant
    kinds = [WhiteDisturbance(0.02), Noise(0.01), Dropout(lost)]
    x0 = X0[: plant.states]
    signal = plants.off_grid() if plant.modes == 3 else dt.Markov([[0, 1.0], [1.0, 0]]).sample(9.0)
    args = plant, law, signal, x0, horizon, law.filter.step
    return dt.simulate(*args, imperfections=kinds, seed=3)


def applied(run):
    """What a controller is told of the inputs, call by call."""
    return [None, *run.inputs.T[:-1]]


@pytest.mark.parametrize("name", mostly_long([*LAWS], *FEW))
def test_in_the_loop_it_gives_the_inputs_and_the_belief_of_simulate(name):
    law = LAWS[name]()
    run, one = record(law), dt.Controller(law, law.filter.step)
    scale = np.abs(run.inputs).max() + np.abs(run.estimates).max()
    lost = 0
    for k, told in enumerate(applied(run)):
        y = run.measured[:, k]
        u = one.update(y, applied=told)
        assert (np.abs(u - run.inputs[:, k]) <= 1e-11 * scale).all()
        np.testing.assert_allclose(one.belief, run.belief[:, k], rtol=0.0, atol=1e-11)
        assert one.status == (Status.OK if np.isfinite(y).all() else Status.BAD_STATE)
        lost += not np.isfinite(y).all()
    assert lost > 3
    assert one.refused == lost


def test_a_warm_restart_changes_no_bit_and_a_covariance_that_is_none_is_refused():
    law = LAWS["ages"]()
    run, one, two = record(law, 2.0), dt.Controller(law, STEP), dt.Controller(law, STEP)
    for y in run.measured.T[:20]:
        one.update(y)
    two.restore(one.state)
    for y in run.measured.T[20:]:
        assert one.update(y).tolist() == two.update(y).tolist()
        assert (one.belief == two.belief).all()
    bad = -one.state["belief_covariances"]
    with pytest.raises(dt.ArgumentError, match=r"state\['belief_covariances'\] must be symmetric"):
        one.restore({**one.state, "belief_covariances": bad})
    with pytest.raises(dt.ArgumentError, match=r"y must have shape \(2,\), got \(3,\)"):
        one.update([1.0, 0.0, 0.0])


@pytest.mark.parametrize("name", ["ages", "observers"])
def test_every_state_that_is_left_can_be_taken_back_outputs_missing_or_not(name):
    law = LAWS[name]()
    one, two = dt.Controller(law, STEP), dt.Controller(law, STEP)
    y = np.random.default_rng(6).normal(size=(30, 2))
    y[[0, 7, 8, 20], [0, 1, 0, 1]] = y[12] = math.nan
    for k in range(30):
        u = one.update(y[k])
        if k:
            assert two.update(y[k]).tolist() == u.tolist()
            assert (one.belief == two.belief).all()
        two.restore(one.state)
        variance = np.diagonal(one.state["belief_covariances"], axis1=1, axis2=2)
        assert variance.min() > 0.0


BELIEF = """
double *NAME_belief(NAME_controller *c) { return &c->belief[0][0]; }
double *NAME_estimate(NAME_controller *c) { return &c->estimate[0][0]; }
"""
UNDEFINED = ("-O1", "-fsanitize=undefined", "-fno-sanitize-recover=all")


def compiled(folder, law, **arguments):
    controller = dt.Controller(law, law.filter.step, **arguments)
    exported = controller.export_c(folder)
    assert exported.check.passed, exported.check
    rows = len(law.law.digital(law.filter.step).state_gain)
    assert f", {rows} of {rows} rows, all" in exported.check.message
    library = Library(folder, law.plant, options=UNDEFINED, more=BELIEF)
    library.n = len(law.filter.noise)
    for name in ("belief", "estimate"):
        getattr(library.library, f"controller_{name}").restype = ctypes.POINTER(ctypes.c_double)
    library.reset()
    return controller, library


@needs_compiler
@pytest.mark.parametrize("name", mostly_long([*LAWS], *FEW))
def test_every_call_of_the_c_gets_the_answer_the_status_and_the_belief(tmp_path, name):
    """Periods without a call pass in the run, too: a jump is what round-off decides upon."""
    law = LAWS[name]()
    controller, library = compiled(tmp_path, law, limits=(-30.0, 20.0))
    run, rng, seen = record(law, 8.0), np.random.default_rng(1), set()
    step, every = law.filter.step, applied(run)
    clocks = np.cumsum([0, *[1] * 79, *rng.choice([0, 1, 1, 1, 1, 3], len(every))])
    for k, clock in enumerate(clocks[clocks < len(every)]):
        y, told = run.measured[:, clock].copy(), every[clock]
        if k % 13 == 6:
            y[-1] = (math.nan, math.inf, -math.inf)[k % 3]
        if k % 29 == 7:
            told = np.full(law.plant.inputs, math.nan)
        when = None if k < 80 else (clock + 0.4 * rng.uniform(-1.0, 1.0)) * step
        u = controller.update(y, 99, told, time=when)
        found, status = library.run([y], [-7], [told], [when])
        assert status[0] == controller.status
        np.testing.assert_allclose(found[0], u, rtol=1e-8, atol=1e-8)
        belief = controller.state["belief"]
        own = np.ctypeslib.as_array(library.call("belief"), belief.shape)
        np.testing.assert_allclose(own, belief, atol=1e-8)
        seen.add(int(status[0]))
    assert seen >= {0, 2, 4, 7, 8}


@needs_compiler
def test_any_bits_at_all_get_a_finite_input_a_status_and_probabilities(tmp_path):
    rng, count = np.random.default_rng(5), 3_000
    law = LAWS["ages"]()
    _, library = compiled(tmp_path, law)
    ages = law.filter.form(law.law.digital(STEP).ages).chain.start.shape[1]
    bits = rng.integers(0, 2**64, (count, 4), np.uint64, endpoint=False).view(np.float64)
    bits[::3] = rng.normal(size=bits[::3].shape) * 10.0 ** rng.uniform(-200, 120, (1000, 1))
    told = [one if k % 2 else None for k, one in enumerate(bits[:, 2:])]
    for k in range(0, count, 10):
        part = slice(k, k + 10)
        found, status = library.run(bits[part, :2], np.zeros(10, int), told[part])
        assert np.isfinite(found).all()
        assert ((status >= 0) & (status <= 5)).all()
        belief = np.ctypeslib.as_array(library.call("belief"), (3, ages))
        assert (belief >= 0.0).all()
        assert abs(belief.sum() - 1.0) < 1e-9
        assert np.isfinite(np.ctypeslib.as_array(library.call("estimate"), (3, 3))).all()


@needs_compiler
@pytest.mark.parametrize("table", mostly_long(["OUTPUT_X", "FIRST_P", "BEND_X"], "BEND_X"))
def test_a_number_of_the_filters_that_is_spoilt_is_found(tmp_path, table):
    dt.Controller(LAWS["mode"](), STEP).export_c(tmp_path)
    path = tmp_path / "controller_tables.h"
    text = path.read_text()
    whole = re.search(table + r"[\[\]\d]+ =\n([^;]*);", text)
    number = [n for n in re.finditer(r"-?\d[\d.e+-]*", whole.group(1)) if float(n.group())][-1]
    a, b = (whole.start(1) + place for place in number.span())
    path.write_text(text[:a] + repr(1.01 * float(number.group())) + text[b:])
    assert self_check(tmp_path, "controller").passed is False


@pytest.mark.long
@needs_frama_c
@pytest.mark.parametrize("case", ["anywhere", "samples"])
def test_frama_c_finds_no_alarm_from_any_state(tmp_path, case):
    plant, model = plants.scalar([0.5, -0.3]), dt.Markov([[0, 1.0], [1.0, 0]])
    options = {"covariance": 1.0, "noise": 0.1, "switches": case}
    filt = dt.OutputModeFilter(plant, model, 0.1, [[1.0]], **options)
    told = dt.ExpectedPredictor(plant, dt.place(plant, [-2.0]), model)
    law = dt.BeliefPredictor(told, filt)
    dt.Controller(law, 0.1, limits=(-9.0, 9.0)).export_c(tmp_path)
    run = subprocess.run(["make", "eva"], cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("0 alarms generated by the analysis") == 2, run.stdout
