"""The prediction in C against `Controller.prediction`, hostile calls included."""

import ctypes
import subprocess

import numpy as np
import pytest

import belief_laws
import c_code
import deadtime as dt
import plants
from deadtime.controller import Status
from predictions import GENERIC, OWN, SEMI, STEP, K
from shares import mostly_long

pytestmark = c_code.needs_compiler


def observed():
    plant = plants.paper(0.25)
    law = dt.ExpectedPredictor(plant, plants.gains(plant), dt.Markov([[0.0, 2.0], [1.0, 0.0]]))
    return dt.OutputFeedback(law, dt.luenberger(plant, [[1.0, 0.0]], [-4.0, -5.0], step=STEP))


CASES = {
    "factorised": lambda: (dt.AveragedPredictor(GENERIC, K), 0.234 / 40),
    "by mode and age": lambda: (dt.ExpectedPredictor(GENERIC, K, SEMI), STEP),
    "delays of their own": lambda: (dt.AveragedPredictor(OWN, K), STEP),
    "an observer": lambda: (observed(), STEP),
    "a belief": lambda: (belief_laws.LAWS["mode"](), belief_laws.STEP),
    "a bank": lambda: (belief_laws.from_outputs(), belief_laws.STEP),
}


def exported(folder, name, **options):
    law, step = CASES[name]()
    controller = dt.Controller(law, step, limits=(-4.0, 4.0))
    written = controller.export_c(folder, prediction=True, **options)
    assert written.check.passed
    return controller, c_code.Library(folder, controller.inner.plant), written


def asked(library, law, x):
    """Status and answer of `controller_predict`."""
    size = library.n * library.m
    ahead = (ctypes.c_double * size)(*[7.0] * size)
    own = [] if isinstance(law, dt.OutputFeedback) or law.outputs is not None else [x]
    given = [(ctypes.c_double * len(one))(*one) for one in own]
    status = library.call("predict", *given, ahead)
    return status, np.array(ahead).reshape(library.m, library.n)


def compare(controller, library, calls):
    """The worst relative difference along a run; where Python has no answer, the C says why."""
    rng, law, worst, refused = np.random.default_rng(3), controller.law, 0.0, 0
    # A bank that is told what no mode explains makes large exponents, and round-off, of it.
    size = 0.02 if law.outputs is not None else 1.0
    library.reset()
    for k in range(calls):
        x, mode = size * rng.normal(size=controller.measured), int(k // 5 % law.plant.modes)
        if k % 17 == 3:
            x[k % x.size] = (np.nan, np.inf)[k % 2]
        if k % 23 == 1:
            mode = -1
        applied = size * rng.normal(size=law.plant.inputs) if k % 3 else None
        controller.update(x, mode, applied)
        library.run(x[None], [mode], [applied])
        status, ahead = asked(library, law, x)
        try:
            found = controller.prediction.states
        except dt.ArgumentError:
            assert status in (Status.BAD_STATE, Status.BAD_MODE)
            assert not ahead.any()
            refused += 1
            continue
        assert status == Status.OK
        worst = max(worst, np.abs(ahead - found).max() / (1.0 + np.abs(found).max()))
    return worst, refused


@pytest.mark.parametrize("name", mostly_long(CASES, "factorised", "delays of their own"))
def test_the_c_predicts_what_the_controller_does(name, tmp_path):
    controller, library, _ = exported(tmp_path, name)
    worst, refused = compare(controller, library, 150)
    assert worst < (1e-9 if name == "a bank" else 1e-12)
    assert (refused > 0) == (name not in ("an observer", "a bank"))


def test_without_it_the_c_has_nothing_of_it_and_with_it_the_same_state():
    from deadtime.controller.export import Names
    from deadtime.controller.export.c_code import c_sources

    controller = dt.Controller(dt.AveragedPredictor(GENERIC, K), STEP)
    given = controller, "double", None, None, "controller", Names()
    plain, more = (c_sources(*given, prediction)[0] for prediction in (False, True))
    assert "FORECAST_X" not in "".join(plain.values())
    assert "controller_predict" not in "".join(plain.values())
    struct = plain["controller.h"].split("typedef struct")[1].split("_controller;")[0]
    assert struct in more["controller.h"]


def test_the_prediction_counts_in_the_room(tmp_path):
    controller, _, written = exported(tmp_path / "a", "by mode and age")
    plain = controller.export_c(tmp_path / "b")
    rows, n, past = len(controller.table.state_gain), 3, 3 * 2
    assert written.rom - plain.rom == rows * n * (n + past) * 8 + 2 * 4
    assert written.ram == plain.ram
    with pytest.raises(dt.ArgumentError, match="of them the prediction"):
        controller.export_c(tmp_path / "c", prediction=True, rom_budget=plain.rom)


def test_a_law_that_predicts_nothing_has_no_prediction_in_c(tmp_path):
    law = dt.DelayedStateFeedback(GENERIC, K)
    with pytest.raises(dt.ArgumentError, match="has no forecast of its own"):
        dt.Controller(law, STEP).export_c(tmp_path, prediction=True)
    assert not list(tmp_path.iterdir())


@pytest.mark.long
@c_code.needs_frama_c
def test_no_alarm_from_any_state(tmp_path):
    plant = plants.scalar([0.5, 0.2], delay=0.25)
    law = dt.ExpectedPredictor(plant, [[[-1.0]], [[-1.0]]], dt.Markov([[0.0, 1.0], [1.0, 0.0]]))
    dt.Controller(law, STEP, limits=(-2.0, 2.0)).export_c(tmp_path, prediction=True)
    told = subprocess.run(
        ["make", "-C", str(tmp_path), "eva"], capture_output=True, text=True, check=False
    )
    assert told.returncode == 0, told.stdout[-2000:]
    assert told.stdout.count("0 alarms generated by the analysis") == 2, told.stdout[-2000:]
