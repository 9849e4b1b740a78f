"""A plant that rests elsewhere than at 0: controllers and exports in the units of its sensors."""

import ctypes
import json
import subprocess

import fmpy
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import belief_laws
import deadtime as dt
import observed_laws
import plants
from c_code import Library, needs_compiler, needs_frama_c
from deadtime.base import files
from deadtime.base.errors import ArgumentError
from deadtime.cli.application import main
from deadtime.controller import Status, export_plant_fmu
from deadtime.controller.export.compiler import WARNINGS, compiler
from deadtime.plant import OperatingPoint

HEATER = """
title = "A heater that rests at 21 degrees"
[plant]
delay = 18.0
A = [[[-0.00833]]]
B = [[[0.00667]]]
states = ["T (°C)"]
inputs = ["valve (%)"]
[operating_point]
x = [21.0]
u = [40.0]
[gains]
lqr = {Q = [[1.0]], R = [[0.1]]}
[[law]]
kind = "averaged"
[signal]
kind = "constant"
mode = 0
[run]
x0 = [8.0]
horizon = 360.0
step = 2.0
[[imperfection]]
kind = "saturation"
low = -40.0
high = 60.0
[[imperfection]]
kind = "white-disturbance"
intensity = [1e-8]
"""


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 0
    return capsys.readouterr().out


@pytest.fixture
def heater(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "heater.toml").write_text(HEATER, encoding="utf-8")
    return tmp_path


def real_heater(room, valve, seconds):
    """A room with 13 °C outside, which a valve at 40 % holds at 21 °C: all in absolute units."""

    def rate(_, now):
        return -0.00833 * (now - 13.0) + 0.001666 * valve

    return solve_ivp(rate, (0.0, seconds), [room], rtol=1e-10, atol=1e-12).y[0, -1]


@needs_compiler
def test_exported_c_fed_with_degrees_holds_a_real_heater_where_it_rests(heater, capsys):
    """B of the model is four times the true one: it is the rest that is tried, not the model."""
    run(capsys, "export", "heater.toml", "--c", "out")
    library = Library(heater / "out", plants.scalar([0.0]))
    assert library.reset() == Status.OK
    room, sent = 29.0, [40.0] * 9
    for _ in range(600):
        u, status = library.run([[room]], [0])
        assert status[0] <= Status.SATURATED
        assert 0.0 <= u[0, 0] <= 100.0
        sent.append(u[0, 0])
        room = real_heater(room, sent[-10], 2.0)
    assert room == pytest.approx(21.0, abs=0.01)
    assert sent[-1] == pytest.approx(40.0, abs=0.01)


def test_what_is_exported_says_what_its_numbers_are(heater, monkeypatch, capsys):
    monkeypatch.setattr("deadtime.controller.export.compiler.compiler", lambda: None)
    out = run(
        capsys, "export", "heater.toml", "--c", "out", "--fmu", "a.fmu", "--plant-fmu", "b.fmu"
    )
    assert "the operating point, T (°C) = 21 with valve (%) = 40, is built in" in out
    assert "inputs limited to 0 to 100" in out.splitlines()[0]
    header = (heater / "out" / "controller.h").read_text()
    assert "x, applied and u are absolute" in header
    assert "T (°C) = 21 with valve (%) = 40." in header
    assert "Limits of the inputs: [0.0] to [100.0]." in header
    assert "#define CONTROLLER_X0 {21.0}" in header
    assert "#define CONTROLLER_U0 {40.0}" in header
    for name in ("a.fmu", "b.fmu"):
        title = fmpy.read_model_description(name).modelName
        assert title.endswith("; absolute values, at rest T (°C) = 21 with valve (%) = 40")
    json_out = json.loads(run(capsys, "export", "heater.toml", "--c", "out", "--json"))
    assert json_out["operating_point"] == {"x": [21.0], "u": [40.0]}
    run(capsys, "export", "paper", "--c", "plain")
    plain = (heater / "plain" / "controller.h").read_text()
    assert "x, applied and u are deviations from the plant's equilibrium." in plain
    assert "REST" not in (heater / "plain" / "controller.c").read_text()


def test_an_experiment_about_an_operating_point_is_a_table_of_absolute_inputs(heater, capsys):
    options = ("--input-limit", "5", "--horizon", "100", "--noise", "0.05")
    out = run(capsys, "experiment", "heater.toml", *options, "--out", "e.csv")
    said = " ".join(out.split())
    assert "rests at T (°C) = 21 with valve (%) = 40; limits are deviations from it, table" in said
    u = np.loadtxt(heater / "e.csv", delimiter=",", skiprows=1)[:, 1]
    assert u.min() >= 35.0 - 1e-9
    assert u.max() <= 45.0 + 1e-9
    assert np.ptp(u) > 4.0
    record = json.loads(run(capsys, "experiment", "heater.toml", *options, "--json"))
    np.testing.assert_allclose(record["inputs"][0], u, rtol=1e-10)
    added = run(capsys, "experiment", "heater.toml", *options, "--law", "averaged", "--out", "a")
    assert "table inputs are to be added to the law's" in " ".join(added.split())
    add = np.loadtxt(heater / "a.csv", delimiter=",", skiprows=1)[:, 1]
    assert np.abs(add).max() <= 10.0


def test_a_run_says_and_draws_what_its_states_are_deviations_from(heater, capsys):
    out = " ".join(run(capsys, "simulate", "heater.toml", "--out", "run.svg").split())
    assert "deviations from the operating point: T (°C) = 21 with valve (%) = 40." in out
    from deadtime.problems.file import load_problem

    problem = load_problem(heater / "heater.toml")
    names = ["T (°C), deviation from 21"], ["valve (%), deviation from 40"]
    assert problem.curve_names == names
    assert dt.problems.paper().curve_names == (["x₁", "x₂"], ["u"])


def kinds():
    generic, servo = plants.generic(), observed_laws.servo()
    belief = belief_laws.LAWS["mode"]()
    return {
        "factorised": (plants.LAWS["averaged"](generic), 0.0066),
        "dense": (plants.LAWS["expected"](generic), 0.1),
        "a window each": (plants.LAWS["averaged"](observed_laws.PLANT), 0.05),
        "a servo": (servo, servo.observer.step),
        "a belief": (belief, belief.filter.step),
    }


def about(law, seed=0):
    """A point, and what a sensor, an actuator and a reference have there, by their definition."""
    rng = np.random.default_rng(seed)
    point = OperatingPoint(
        30.0 + rng.normal(size=law.plant.states), 50.0 + rng.normal(size=law.plant.inputs)
    )
    y = point.x if law.outputs is None else law.outputs[0] @ point.x
    r = law.servo.tracked @ y if isinstance(law, dt.OutputFeedback) and law.servo else None
    return point, y, r


def calls(law, count, seed=1):
    """Deviations that are measured, modes, applied inputs and references; some are unusable."""
    rng, m = np.random.default_rng(seed), law.plant.inputs
    size = law.plant.states if law.outputs is None else law.outputs.shape[1]
    servo = isinstance(law, dt.OutputFeedback) and law.servo
    x = 0.1 * rng.normal(size=(count, size))
    x[17, 0], x[31, -1] = np.nan, np.inf
    applied = [rng.normal(size=m) if k % 3 else None for k in range(count)]
    applied[40] = np.full(m, np.nan)
    r = [rng.normal(size=len(law.servo.tracked)) if servo and k % 4 else None for k in range(count)]
    return x, np.arange(count) // 7 % law.plant.modes, applied, r


def plus(values, rest):
    return [None if one is None else one + rest for one in values]


@pytest.mark.parametrize("name", kinds())
def test_a_controller_about_a_point_is_the_one_of_deviations_shifted(name):
    """Answers, predictions and limits; rounding is all that differs."""
    law, step = kinds()[name]
    point, y, r = about(law)
    low, high = -2.0, 2.0
    plain = dt.Controller(law, step, limits=(low, high))
    moved = dt.Controller(law, step, limits=(low + point.u, high + point.u), operating_point=point)
    x, modes, applied, references = calls(law, 60)
    given = x, modes, applied, references
    for k, (x, mode, a, ref) in enumerate(zip(*given, strict=True)):
        u = plain.update(x, int(mode), a, reference=ref)
        v = moved.update(
            x + y, int(mode), *plus([a], point.u), reference=None if ref is None else ref + r
        )
        assert moved.status == plain.status
        np.testing.assert_allclose(v, point.u + u, rtol=0.0, atol=1e-9)
        if k % 10 == 9:
            ahead = moved.prediction.states - plain.prediction.states
            n = law.plant.states
            np.testing.assert_allclose(ahead[:, :n] - point.x, 0.0, atol=1e-8)
            assert ahead.shape[1] == n or abs(ahead[:, n:-2]).max() < 1e-8 or r is not None


@needs_compiler
@pytest.mark.few(2)
@pytest.mark.parametrize("name", kinds())
def test_the_c_about_a_point_answers_as_the_controller_does(tmp_path, name):
    law, step = kinds()[name]
    point, y, r = about(law)
    limits = point.u - 2.0, point.u + 2.0
    controller = dt.Controller(law, step, limits=limits, operating_point=point)
    exported = controller.export_c(tmp_path, prediction=True)
    assert exported.check.passed, exported.check
    library = Library(tmp_path, controller.inner.plant, options=("-O1", "-fsanitize=undefined"))
    past = point.u + 0.1 * np.random.default_rng(2).normal(size=(controller.table.taps, 2))
    assert library.reset(past) == Status.OK
    controller.reset(past.T)
    x, modes, applied, references = calls(law, 60)
    x, applied = x + y, plus(applied, point.u)
    references = plus(references, r)
    u, status = library.run(x, modes, applied, references=references)
    for k in range(60):
        expected = controller.update(x[k], int(modes[k]), applied[k], reference=references[k])
        assert status[k] == controller.status
        np.testing.assert_allclose(u[k], expected, rtol=0.0, atol=1e-8)
    size = controller.prediction.states.size
    ahead = (ctypes.c_double * size)()
    own = () if law.outputs is not None else ((ctypes.c_double * len(x[-1]))(*x[-1]),)
    assert library.call("predict", *own, ahead) == Status.OK
    np.testing.assert_allclose(ahead, controller.prediction.states.ravel(), atol=1e-8)


@needs_compiler
def test_without_a_reset_the_c_gives_the_input_at_rest(heater, capsys):
    run(capsys, "export", "heater.toml", "--c", "out")
    library = Library(heater / "out", plants.scalar([0.0]))
    u, status = library.run([[29.0]], [0])
    assert (u[0, 0], status[0]) == (40.0, 10)


@needs_compiler
def test_in_single_precision_the_check_passes_about_a_point(tmp_path):
    law, step = kinds()["factorised"]
    point, *_ = about(law)
    controller = dt.Controller(law, step, operating_point=point)
    assert controller.export_c(tmp_path, precision="float").check.passed


@needs_compiler
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_fmus_of_controller_and_plant_meet_at_the_operating_point(heater, capsys, version):
    """A plant that starts 8 above its rest comes back to it; and both start in absolute values."""
    options = ("--fmu", "law.fmu", "--plant-fmu", "plant.fmu", "--fmi", version)
    run(capsys, "export", "heater.toml", *options)
    law, plant = (fmpy.read_model_description(f"{name}.fmu") for name in ("law", "plant"))
    starts = {v.name: v.start for model in (law, plant) for v in model.modelVariables}
    assert float(starts["u0[1]"]) == 40.0
    assert float(starts["x0[1]"]) == 29.0
    held = fmpy.simulate_fmu("plant.fmu", stop_time=500.0, output=["x[1]"], step_size=2.0)
    expected = 21.0 + 8.0 * np.exp(-0.00833 * held["time"])
    np.testing.assert_allclose(held["x[1]"], expected, rtol=1e-9)
    asked = fmpy.simulate_fmu("law.fmu", stop_time=20.0, output=["u[1]"], step_size=2.0)
    np.testing.assert_allclose(asked["u[1]"], 40.0, rtol=1e-12)  # nothing connected: at rest


@needs_compiler
def test_the_fmu_of_a_law_on_outputs_tells_its_estimate_in_absolute_values(tmp_path):
    law = observed_laws.one_mode()
    point, y, _ = about(law)
    controller = dt.Controller(law, law.observer.step, operating_point=point)
    path = tmp_path / "law.fmu"
    controller.export_fmu(path)
    names = [f"estimate[{i}]" for i in range(1, 4)]
    found = fmpy.simulate_fmu(
        str(path), stop_time=1.0, step_size=law.observer.step, output=names,
        start_values={f"y[{i}]": value for i, value in enumerate(y, 1)},
    )  # fmt: skip
    np.testing.assert_allclose([found[name][0] for name in names], point.x, atol=1e-12)


@needs_frama_c
@pytest.mark.long
@pytest.mark.parametrize("name", ["factorised", "dense"])
def test_frama_c_finds_no_alarm_about_a_point(tmp_path, name):
    plant = plants.paper(0.234)
    law = plants.LAWS[{"factorised": "averaged", "dense": "expected"}[name]](plant)
    point, *_ = about(law)
    controller = dt.Controller(
        law, 0.05, limits=(point.u - 2.0, point.u + 3.0), operating_point=point
    )
    controller.export_c(tmp_path, prediction=True)
    found = subprocess.run(["make", "eva"], cwd=tmp_path, capture_output=True, text=True)
    assert found.stdout.count("0 alarms generated by the analysis") == 2, found.stdout[-3000:]


@needs_compiler
def test_every_c_file_of_a_folder_compiles_by_itself_the_one_for_frama_c_too(tmp_path):
    dt.Controller(plants.LAWS["averaged"](plants.paper()), 0.05).export_c(tmp_path)
    for file in tmp_path.glob("*.c"):
        command = [*compiler(), *WARNINGS, "-pedantic", "-c", str(file), "-o", "/dev/null"]
        found = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (found.returncode, found.stderr) == (0, ""), file.name


@pytest.mark.parametrize(
    ("point", "message"),
    [
        (([1.0, 2.0], [1.0]), r"operating_point.x must have shape \(n,\) = \(3,\)"),
        (([1.0, 2.0, 3.0], [1.0]), r"operating_point.u must have shape \(m,\) = \(2,\)"),
    ],
)
def test_a_point_of_other_sizes_is_refused(point, message):
    law = plants.LAWS["averaged"](plants.generic())
    with pytest.raises(ArgumentError, match=message):
        dt.Controller(law, 0.05, operating_point=OperatingPoint(*point))
    with pytest.raises(ArgumentError, match=message):
        export_plant_fmu(law.plant, "x.fmu", operating_point=OperatingPoint(*point))


def test_sensors_that_differ_by_mode_have_no_operating_point():
    law = belief_laws.from_outputs()
    with pytest.raises(ArgumentError, match="operating_point must have the same outputs in every"):
        dt.Controller(law, law.filter.step, operating_point=OperatingPoint([1.0, 1, 1], [0.0, 0]))


@pytest.mark.parametrize(
    "arguments",
    [
        ("export", "paper", "--c", "/"),
        ("export", "paper", "--c", "/tmp/.."),
        ("reproduce", "paper", "--out", "/"),
        ("study", "no.toml", "--out", "//"),
    ],
)
def test_the_root_of_the_file_system_is_no_folder_to_write_into(arguments, monkeypatch, capsys):
    def never(*_):
        raise AssertionError("about to write into the root")

    monkeypatch.setattr(files.Staging, "_place", never)
    monkeypatch.setattr("deadtime.scenarios.sweeps.load_study", lambda file: None)
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    assert "the root of the file system: name one in it" in capsys.readouterr().err


def test_a_folder_with_other_files_keeps_them(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("deadtime.controller.export.compiler.compiler", lambda: None)
    (tmp_path / "notes.c").write_text("mine")
    run(capsys, "export", "paper", "--c", ".")
    assert (tmp_path / "notes.c").read_text() == "mine"
    assert (tmp_path / "controller.h").exists()
