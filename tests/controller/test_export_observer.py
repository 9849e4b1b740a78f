"""The C of a law on outputs, and of a servo: the answers and the estimate of `Controller`."""

import ctypes
import itertools
import math
import re
import shutil
import subprocess

import numpy as np
import pytest

import deadtime as dt
from c_code import Library, needs_compiler, needs_frama_c
from deadtime.cli.application import main
from deadtime.controller import Status
from deadtime.controller.export import compiler as compiling
from deadtime.controller.export.compiler import self_check
from deadtime.controller.export.observer_code import ObserverForm
from deadtime.estimation.servo import Reference
from deadtime.imperfections import Dropout, Noise
from observed_laws import LAWS, PLANT, SCHEDULE, STEP, hostile, observed, servo
from shares import mostly_long

pytestmark = needs_compiler
UNDEFINED = ("-O1", "-fsanitize=undefined", "-fno-sanitize-recover=all")
LIMITS = -2.0, 2.5
Z = "\nNAME_real *NAME_z(NAME_controller *c) { return c->z; }\n"


def compiled(folder, law, options=("-O2",), **arguments):
    controller = dt.Controller(law, law.observer.step, **arguments)
    with pytest.MonkeyPatch.context() as without:  # it is driven, which checks more
        without.setattr(compiling, "compiler", lambda: None)
        controller.export_c(folder)
    library = Library(folder, law.plant, options=options, more=Z)
    library.library.controller_z.restype = ctypes.POINTER(ctypes.c_double)
    library.reset()
    return controller, library


def z_of(library, controller):
    """As it stands in the struct; a view."""
    return np.ctypeslib.as_array(library.call("z"), controller.state["observer_z"].shape)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The servo's folder, its controller, and its C; who takes it resets it first."""
    folder = tmp_path_factory.mktemp("servo")
    return folder, *compiled(folder, servo(), UNDEFINED, limits=LIMITS)


@pytest.mark.parametrize(
    ("name", "precision"),
    mostly_long(
        [
            ("one mode", "float"),
            ("servo", "float"),
            ("dwell-aware", "double"),
            ("without sums", "double"),
            ("rows by mode", "double"),
            ("factorised", "double"),
        ],
        ("one mode", "float"),
    ),
)
def test_the_check_passes_and_visits_every_row(tmp_path, name, precision):
    law = LAWS[name]()
    step = law.observer.step
    exported = dt.Controller(law, step, limits=(-9.0, 9.0)).export_c(tmp_path, precision=precision)
    assert exported.check.passed, exported.check
    rows = len(law.law.digital(step).state_gain)
    assert f", {rows} of {rows} rows, all" in exported.check.message
    assert exported.form.startswith("factorised") == (name == "factorised")


@pytest.mark.parametrize(
    "table",
    mostly_long(
        ["PREDICT_X", "PREDICT_U", "MEASURE", "CORRECT", "TRACK", "REFERENCE", "SUM_GAIN"],
        "SUM_GAIN",
    ),
)
def test_a_number_of_the_observer_that_is_spoilt_is_found(made, tmp_path, table):
    """The answer to the sum has a say by its sign alone: there the sign is spoilt."""
    shutil.copytree(made[0], tmp_path, dirs_exist_ok=True)
    path = tmp_path / "controller_tables.h"
    text = path.read_text()
    whole = re.search(table + r"[\[\]\d]+ =\n([^;]*);", text)
    spoil = -1.0 if table == "SUM_GAIN" else 1.01
    numbers = re.sub(
        r"-?\d[\d.e+-]*", lambda one: repr(spoil * float(one.group()) + 1e-3), whole.group(1)
    )
    path.write_text(text[: whole.start(1)] + numbers + text[whole.end(1) :])
    check = self_check(tmp_path, "controller")
    assert check.passed is False
    assert " 0 differ" not in check.message


@pytest.mark.parametrize(
    "name", mostly_long(["servo", "one mode", "dwell-aware", "observed"], "servo")
)
def test_every_call_gets_the_answer_the_status_and_the_estimate_of_the_controller(
    made, tmp_path, name
):
    law = LAWS[name]()
    controller, library = made[1:]
    if name != "servo":
        limits = LIMITS if law.servo else (-0.05, 0.05)
        controller, library = compiled(tmp_path, law, UNDEFINED, limits=limits)
    controller.reset()
    library.reset()
    calls = hostile(law, 1_000)
    expected, seen, size = [], [], np.zeros(law.plant.inputs)
    for y, mode, told, when, r in zip(*calls, strict=True):
        expected.append(controller.update(y, int(mode), told, reference=r, time=when))
        seen.append(controller.status)
        size = np.maximum(size, np.abs(expected[-1]))
    found, status = library.run(*calls)
    assert status.tolist() == seen
    assert (np.abs(found - expected) <= 1e-11 * size).all()
    z = controller.state["observer_z"]
    np.testing.assert_allclose(z_of(library, controller), z, rtol=1e-11, atol=1e-11)
    reads, tracks = law.plant.modes > 1, law.servo is not None
    wanted = {0, 1, 2, 4, 7, 8} | ({3} if reads else set()) | ({6} if tracks else set())
    assert set(seen) >= wanted


@pytest.mark.parametrize(
    "count", [10_000, pytest.param(1_000_000, marks=pytest.mark.long)], ids=["few", "million"]
)
def test_a_million_periods_in_the_loop_give_the_inputs_of_the_run(tmp_path, count):
    """Three modes, outputs that are lost, references that move; both on inputs of their own.

    Where a run loses a sample its mode goes with it, and the last one goes on.
    """
    rng, horizon = np.random.default_rng(4), count * STEP
    times = np.arange(0.0, horizon, 7.0)
    law = servo(reference=(times, rng.normal(size=(times.size, 2))))
    controller, library = compiled(tmp_path, law)
    signal = dt.SwitchingSignal.random(3, horizon + 1.0, dwell_time=0.8, seed=1)
    kinds, x0 = [Dropout(0.1), Noise(0.01)], [0.5, 0.0, -0.5]
    run = dt.simulate(PLANT, law, signal, x0, horizon, STEP, imperfections=kinds, seed=2)
    assert not run.diverged
    lost = np.isnan(run.measured).any(axis=0)
    assert abs(lost.mean() - 0.1) < 0.03
    last = np.maximum.accumulate(np.where(lost, 0, np.arange(count + 1)))
    found, status = library.run(run.measured.T, np.where(lost[last], 0, run.mode[last]))
    assert (status == np.where(lost, Status.BAD_STATE, Status.OK)).all()
    assert np.abs(found.T - run.inputs).max() <= 1e-11 * np.abs(run.inputs).max()
    np.testing.assert_allclose(z_of(library, controller), run.estimates[:, -1], rtol=0, atol=1e-11)


def test_any_bits_at_all_get_a_finite_input_and_a_status(made):
    (_, controller, library), rng, count = made, np.random.default_rng(5), 5_000
    library.reset()
    bits = rng.integers(0, 2**64, (count, 6), np.uint64, endpoint=False).view(np.float64)
    bits[::3] = rng.normal(size=(len(bits[::3]), 6)) * 10.0 ** rng.uniform(-200, 120, (1667, 1))
    told = [one if k % 2 else None for k, one in enumerate(bits[:, 2:4])]
    asked = [one if k % 3 else None for k, one in enumerate(bits[:, 4:])]
    found, status = library.run(bits[:, :2], rng.integers(-2, 5, count), told, None, asked)
    assert np.isfinite(found).all()
    assert (found >= LIMITS[0]).all()
    assert (found <= LIMITS[1]).all()
    assert set(status.tolist()) <= {0, 1, 2, 3, 4, 5, 6}
    assert (np.abs(z_of(library, controller)) <= 2.0**332).all()


@pytest.mark.long
def test_an_estimate_that_leaves_its_bound_comes_back_with_the_outputs(tmp_path):
    """Controller's is then no number for ever; the C begins anew, and says so."""
    law = observed(plant=dt.SwitchedSystem(PLANT.A + 3.0 * np.eye(3), PLANT.B, PLANT.delays))
    controller, library = compiled(tmp_path, law, limits=(-1.0, 1.0))
    library.run([[1e3, 1e3]], [0])
    nothing = np.full((2_000, 2), math.nan)
    _, status = library.run(nothing, np.zeros(2_000, int))
    assert set(status.tolist()) == {Status.BAD_STATE, Status.OVERFLOW}
    assert np.abs(z_of(library, controller)).max() < 1e90  # it has begun anew
    _, status = library.run(np.ones((2_000, 2)), np.zeros(2_000, int))
    assert status[-1] <= Status.SATURATED
    assert np.abs(z_of(library, controller)).max() < 1e3


def test_a_copy_of_the_state_is_a_warm_restart_and_damage_is_said(made):
    _, controller, library = made
    library.reset()
    calls = hostile(controller.law, 400, 3)
    first, rest = [one[:250] for one in calls], [one[250:] for one in calls]
    library.run(*first)
    kept = library.state.raw
    whole, _ = library.run(*rest)
    library.reset()
    assert library.call("restore", kept) == Status.OK
    again, _ = library.run(*rest)
    assert again.tolist() == whole.tolist()
    for bad in (math.nan, math.inf, -1e200):
        assert library.call("restore", kept) == Status.OK
        z_of(library, controller)[1] = bad
        spoilt = library.state.raw
        found, status = library.run(np.zeros((3, 2)), np.zeros(3, int))
        assert status[0] == 9
        assert np.isfinite(found).all()
        assert library.call("restore", spoilt) == 10


def test_reset_takes_the_inputs_before_the_first_call(made):
    _, controller, library = made
    past = np.random.default_rng(3).uniform(*LIMITS, size=(controller.table.taps, 2))
    controller.reset(past.T)
    library.reset(past)
    y = np.tile([0.3, -0.2], (20, 1))
    found, _ = library.run(y, np.zeros(20, int))
    expected = [controller.update(one, 0) for one in y]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_each_reference_holds_from_the_sample_on_at_which_the_law_takes_it():
    """Beside the schedule itself, at changes on samples, between them, before 0, and never."""
    rng = np.random.default_rng(6)
    for step, start in itertools.product((0.1, 0.05, 1.0 / 3.0, 0.007), (-3.0, 0.0)):
        times = start + np.cumsum(rng.choice([step, 0.5 * step, 3.0 * step, 0.7 * step], 40))
        law = servo(reference=(np.append(times, 1e300), np.arange(82.0).reshape(41, 2)), step=step)
        form = ObserverForm.of(dt.Controller(law, step).observing)
        expected = Reference.of(law.reference, 2).along(np.arange(200) * step)
        held = [np.flatnonzero(np.array(form.changes) <= k) for k in range(200)]
        found = [form.values[one[-1] if one.size else 0] for one in held]
        assert np.array(found).tolist() == expected.tolist()


def test_rom_and_ram_are_those_of_the_files(made):
    names = ("controller_tables.h", "controller.c", "controller.h")
    text, code, header = ((made[0] / name).read_text() for name in names)
    change = "static const uint64_t controller_CHANGE[CONTROLLER_CHANGES] = {"
    assert change + "\n    UINT64_C(0),\n    UINT64_C(60)," in code
    numbers = sum(
        math.prod(map(int, re.findall(r"\[(\d+)\]", one)))
        for one in re.findall(r"real controller_[A-Z_]+([\[\]\d]+) =", text)
    )
    integers = re.search(r"int32_t controller_LAG.* = \{(.*)\};", code).group(1).count(",") + 1
    rom = 8 * numbers + 4 * integers + 8 * len(SCHEDULE[0])
    assert f"Tables: {rom} bytes of constants." in header
    ram = re.search(r"controller_controller of (\d+) bytes", header)
    assert abs(int(ram.group(1)) - len(made[2].state)) <= 16
    includes = re.findall(r"#include .*", code)
    assert includes == ['#include "controller.h"', '#include "controller_tables.h"']


def test_a_law_on_the_state_has_no_word_of_it_and_one_without_a_servo_none_of_references(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(compiling, "compiler", lambda: None)
    for law, words in ((servo().law, "observ|reference|estimate"), (observed(), "reference")):
        dt.Controller(law, STEP).export_c(tmp_path)
        for file in tmp_path.glob("*.[ch]"):
            text = file.read_text()
            said = re.findall("#define CONTROLLER_READS_REFERENCE 0 .*", text)
            assert len(said) == (file.name == "controller.h")
            assert not re.search(words, text.replace("".join(said), ""), re.IGNORECASE), file


def test_what_cannot_be_is_refused_by_name(tmp_path):
    moving = dt.Controller(servo(reference=lambda t: [t, 0.0]), STEP)
    with pytest.raises(dt.ArgumentError, match="reference is a function of time, which has no C"):
        moving.export_c(tmp_path)
    far = dt.Controller(servo(reference=[1e150, 0.0]), STEP)
    with pytest.raises(dt.ArgumentError, match=r"reference must be within 9e\+99, the bound"):
        far.export_c(tmp_path)
    with pytest.raises(
        dt.ArgumentError, match=r"of them the observer\); .*precision=\"float\" \(\d+ bytes\)"
    ):
        dt.Controller(servo(), STEP).export_c(tmp_path, rom_budget=1_500)
    assert not list(tmp_path.iterdir())


FILE = """
[plant]
delay = 0.2
A = [[[0.0, 1.0], [0.0, -1.0]], [[0.0, 1.0], [0.0, -2.0]]]
B = [[[0.0], [1.0]], [[0.0], [1.5]]]
states = ["angle (rad)", "rate (rad/s)"]
[gains]
poles = [-1.0, -2.0]
[observer]
kind = "luenberger"
C = [[1.0, 0.0]]
poles = [-4.0, -5.0]
[signal]
kind = "constant"
mode = 0
[run]
x0 = [1.0, 0.0]
horizon = 1.0
step = 0.05
"""


def test_a_problem_file_with_an_observer_becomes_c_and_an_fmu(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(compiling, "compiler", lambda: None)
    (tmp_path / "problem.toml").write_text(FILE, encoding="utf-8")
    with pytest.raises(SystemExit) as stopped:
        main(["export", "problem.toml", "--c", "out", "--fmu", "law.fmu"])
    assert stopped.value.code == 0
    header = (tmp_path / "out" / "controller.h").read_text()
    assert "Pass the mode at every call: the law does not depend on it, but the observer" in header
    assert "States: z[0]: angle (rad), z[1]: rate (rad/s)." in header
    assert "const controller_real *y, int32_t mode," in header
    assert (tmp_path / "law.fmu").stat().st_size > 5_000


@needs_frama_c
@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "precision"),
    [("small", "float"), ("servo", "double"), ("small, factorised", "double")],
)
def test_frama_c_finds_no_alarm_from_any_state(tmp_path, name, precision):
    law = LAWS[name]()
    controller = dt.Controller(law, law.observer.step, limits=(-9.0, 9.0))
    controller.export_c(tmp_path, precision=precision)
    run = subprocess.run(["make", "eva"], cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("0 alarms generated by the analysis") == 2, run.stdout
    assert "eva:alarm" not in run.stdout, run.stdout
