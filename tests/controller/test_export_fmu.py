"""FMUs: valid, and in co-simulation the loop that `simulate` gives."""

import math
import shutil
import subprocess
import zipfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import deadtime as dt
import plants
from belief_laws import LAWS, STEP, from_outputs, record
from c_code import needs_compiler
from deadtime.controller.export import Names, export_plant_fmu
from deadtime.controller.export.compiler import compiler
from observed_laws import hostile, servo
from shares import mostly_long

fmpy = pytest.importorskip("fmpy")
fmi2, fmi3 = pytest.importorskip("fmpy.fmi2"), pytest.importorskip("fmpy.fmi3")
validate_fmu = pytest.importorskip("fmpy.validation").validate_fmu

pytestmark = needs_compiler
GENERIC = plants.generic()
VERSIONS = ("2.0", "3.0")
X0 = [1.0, -1.0, 0.5]


class Slave:
    """An FMU under FMPy, with variables by name."""

    def __init__(self, path, folder, start=None, begin=0.0, ready=True):
        self.description = fmpy.read_model_description(str(path))
        self.version = self.description.fmiVersion
        where = fmpy.extract(str(path), unzipdir=str(folder))
        kind = fmi2.FMU2Slave if self.version == "2.0" else fmi3.FMU3Slave
        self.fmu = kind(
            guid=self.description.guid,
            unzipDirectory=where,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="one",
        )
        self.variables = {v.name: v for v in self.description.modelVariables}
        self.fmu.instantiate()
        self.set(**(start or {}))
        if ready:
            self.initialize(begin, {})

    def initialize(self, begin, start):
        """Values set in initialization mode are seen in it."""
        if self.version == "2.0":
            self.fmu.setupExperiment(startTime=begin)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=begin)
        if start:
            self.set(x0=[4.0], **start)
            assert self.get("x[1]") == 4.0
        self.fmu.exitInitializationMode()

    def set(self, **values):
        for name, value in values.items():
            for i, one in enumerate(np.atleast_1d(value)):
                variable = self.variables[name if np.ndim(value) == 0 else f"{name}[{i + 1}]"]
                cast = float if variable.type in ("Real", "Float64") else int
                put = getattr(self.fmu, f"set{variable.type}")
                put([variable.valueReference], [cast(one)])

    def get(self, name, size=None):
        names = [name] if size is None else [f"{name}[{i + 1}]" for i in range(size)]
        found = [self.variables[one] for one in names]
        read = getattr(self.fmu, f"get{found[0].type}")
        values = read([variable.valueReference for variable in found])
        return list(values) if size else values[0]

    def step(self, time, size):
        self.fmu.doStep(currentCommunicationPoint=time, communicationStepSize=size)

    def close(self):
        self.fmu.terminate()
        self.fmu.freeInstance()


def closed_loop(law_path, plant_path, folder, signal, cuts, step, horizon):
    """u and x at the samples; the plant is stepped from cut to cut, the controller by periods."""
    controller = Slave(law_path, folder / "law")
    plant = Slave(plant_path, folder / "plant", {"x0": X0})
    states, inputs = [plant.get("x", 3)], []
    for k in range(round(horizon / step)):
        time, end = k * step, (k + 1) * step
        controller.set(x=states[-1], mode=int(signal(time)))
        controller.step(time, step)
        inputs.append(controller.get("u", 2))
        plant.set(u=inputs[-1])
        edges = [time, *(cut for cut in cuts if time < cut < end), end]
        for a, b in pairwise(edges):
            plant.set(mode=int(signal(a)))
            plant.step(a, b - a)
        states.append(plant.get("x", 3))
    assert controller.get("status") == 0
    controller.close()
    plant.close()
    return np.array(states).T, np.array(inputs).T


# Of a delay that is no multiple of the period; and of one per mode and input, and another truth.
OWN = np.array([[0.234, 0.1], [0.1, 0.187], [0.3, 0.05]])


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("name", "delay", "true", "version"),
    [
        ("averaged, dwell-aware", 0.234, 0.251, "2.0"),
        ("averaged", OWN, OWN + 0.013, "3.0"),
        pytest.param("averaged", 0.234, 0.251, "3.0", marks=pytest.mark.long),
    ],
)
def test_controller_and_plant_in_co_simulation_are_the_loop_of_simulate(
    tmp_path, name, delay, true, version
):
    """The plant is not the model, and switches are off the grid."""
    law = plants.LAWS[name](dt.SwitchedSystem(GENERIC.A, GENERIC.B, delay))
    signal, truth = plants.off_grid(), dt.SwitchedSystem(1.03 * GENERIC.A, 0.98 * GENERIC.B, true)
    paths = tmp_path / "law.fmu", tmp_path / "plant.fmu"
    exported = dt.Controller(law, 0.01).export_fmu(paths[0], version=version)
    assert "binaries/" in str(exported)
    export_plant_fmu(truth, paths[1], version=version)
    for path in paths:
        assert validate_fmu(str(path)) == []
    cuts = signal.times[signal.times < 2.0].tolist()
    states, inputs = closed_loop(*paths, tmp_path, signal, cuts, 0.01, 2.0)
    run = dt.simulate(truth, law, signal, X0, 2.0, 0.01)
    plants.close(states, run.states, 1e-11)
    plants.close(inputs, run.inputs[:, :-1], 1e-11)


@pytest.mark.parametrize("version", VERSIONS)
def test_the_plant_alone_follows_inputs_of_any_length(tmp_path, version):
    """fmpy.simulate_fmu with steps that have nothing to do with the delay, against exponentials."""
    plant = plants.scalar([-0.7], 1.3, delay=0.3)
    path = tmp_path / "plant.fmu"
    export_plant_fmu(plant, path, x0=[2.0], version=version)
    result = fmpy.simulate_fmu(
        str(path),
        stop_time=1.0,
        step_size=0.0625,
        output_interval=0.0625,
        input=np.array([(0.0, 1.0)], dtype=[("time", "f8"), ("u[1]", "f8")]),
        start_values={"u0[1]": -1.0},
        output=["x[1]"],
    )
    t = result["time"]
    before = 2.0 * np.exp(-0.7 * t) - 1.3 / 0.7 * (1.0 - np.exp(-0.7 * t))
    after = 2.0 * 1.3 / 0.7 * (1.0 - np.exp(-0.7 * np.maximum(t - 0.3, 0.0)))
    plants.close(result["x[1]"], before + after, 1e-14)


@pytest.mark.parametrize("version", VERSIONS)
def test_states_of_both_can_be_kept_and_put_back(tmp_path, version):
    law = plants.LAWS["averaged"](GENERIC)
    path = tmp_path / "law.fmu"
    dt.Controller(law, 0.01).export_fmu(path, version=version)
    slave = Slave(path, tmp_path / "law")
    get, put, free = (
        getattr(slave.fmu, name.format("s" if version == "2.0" else "S"))
        for name in ("getFMU{}tate", "setFMU{}tate", "freeFMU{}tate")
    )
    rng, answers = np.random.default_rng(0), []
    x = rng.normal(size=(40, 3)).tolist()
    for k in range(20):
        slave.set(x=x[k])
        slave.step(0.01 * k, 0.01)
    state = get()
    for _ in range(2):
        put(state)
        for k in range(20, 40):
            slave.set(x=x[k])
            slave.step(0.01 * k, 0.01)
        answers.append(slave.get("u", 2))
    free(state)
    slave.close()
    assert answers[0] == answers[1]


@pytest.mark.parametrize("version", VERSIONS)
def test_bad_inputs_get_a_status_and_applied_is_read_if_told(tmp_path, version):
    law, path = plants.LAWS["averaged, dwell-aware"](GENERIC), tmp_path / "law.fmu"
    dt.Controller(law, 0.01).export_fmu(path, version=version)
    slave = Slave(path, tmp_path / "law", {"report_applied": 1, "mode_age": 3})
    controller = dt.Controller(law, 0.01, mode_age=3)
    rng = np.random.default_rng(0)
    for k in range(60):
        x, applied, mode = rng.normal(size=3), rng.normal(size=2), k // 9 % 4
        if k == 30:
            x[1] = np.nan
        slave.set(x=x.tolist(), applied=applied.tolist(), mode=mode)
        slave.step(0.01 * k, 0.01)
        u = controller.update(x, mode, applied)
        plants.close(np.array(slave.get("u", 2)), u, 1e-12, 10.0)
        assert slave.get("status") == controller.status
    slave.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_functions_are_those_of_the_standard_s_own_headers(tmp_path, version):
    headers = Path(fmpy.__file__).parent / "c-code"
    path = tmp_path / "plant.fmu"
    export_plant_fmu(GENERIC, path, version=version)
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path)
    source = str(tmp_path / "sources" / f"fmi{version[0]}.c")
    command = [*compiler(), "-std=c99", "-Werror", "-DFMI_HEADERS", f"-I{headers}"]
    command += ["-fsyntax-only", "-Wno-strict-prototypes", source]
    run = subprocess.run(command, capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")


def test_the_same_fmu_twice_is_the_same_file(tmp_path):
    for name in ("a.fmu", "b.fmu"):
        dt.Controller(plants.LAWS["mean"](GENERIC), 0.05).export_fmu(tmp_path / name)
    first, second = (zipfile.ZipFile(tmp_path / name) for name in ("a.fmu", "b.fmu"))
    with first, second:
        for name in first.namelist():
            if not name.startswith("binaries"):
                assert first.read(name) == second.read(name)


def test_without_a_compiler_there_are_sources_and_it_says_so(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    exported = export_plant_fmu(GENERIC, tmp_path / "plant.fmu")
    assert exported.binary is None
    assert exported.message == "sources only: no C compiler was found (set CC)"
    assert validate_fmu(str(tmp_path / "plant.fmu")) == []


def test_an_unwritable_path_is_refused_by_name(tmp_path):
    with pytest.raises(dt.ArgumentError, match=r"path '/proc/x\.fmu' cannot be written"):
        export_plant_fmu(GENERIC, "/proc/x.fmu")


def test_sources_build_without_deadtime(tmp_path):
    """What FMPy compiles from the sources alone would be a binary of any platform."""
    assert shutil.which(compiler()[0])
    path = tmp_path / "law.fmu"
    dt.Controller(plants.LAWS["averaged"](GENERIC), 0.01).export_fmu(path)
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path)
    sources = sorted(map(str, (tmp_path / "sources").glob("*.c")))
    command = [*compiler(), "-std=c99", "-shared", "-fPIC", *sources, "-o", str(tmp_path / "x.so")]
    subprocess.run(command, check=True)


@pytest.mark.parametrize(
    ("version", "begin", "count"),
    mostly_long([("2.0", 1e3, 300), ("3.0", 1e6, 1000)], ("3.0", 1e6, 1000)),
)
def test_a_master_that_adds_up_its_time_gets_a_sample_a_step(tmp_path, version, begin, count):
    """Round-off of the sum is far above that of k h, and at 1e6 s above 1e-7 h."""
    law, path, step = plants.LAWS["averaged"](GENERIC), tmp_path / "law.fmu", 0.001
    dt.Controller(law, step).export_fmu(path, version=version)
    slave = Slave(path, tmp_path / "law", begin=begin)
    controller, time = dt.Controller(law, step), begin
    x = np.random.default_rng(4).normal(size=(count, 3)).round(3)
    for k in range(count):
        slave.set(x=x[k].tolist())
        slave.step(time, step)
        time += step
        u = controller.update(x[k])
        plants.close(np.array(slave.get("u", 2)), u, 1e-9, np.abs(u).max())
    assert abs(time - begin - count * step) > 1e-12
    slave.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_calls_that_the_standard_forbids_are_refused_and_change_nothing(tmp_path, version):
    plant, law = plants.scalar([-0.7], 1.3, delay=0.3), tmp_path / "law.fmu"
    dt.Controller(plants.LAWS["averaged"](GENERIC), 0.01).export_fmu(law, version=version)
    path = tmp_path / "plant.fmu"
    export_plant_fmu(plant, path, x0=[2.0], version=version)
    for file, first in ((path, 2.0), (law, None)):
        slave = Slave(file, tmp_path / file.stem, ready=False)
        if first:
            slave.set(x0=[3.0])
        with pytest.raises(Exception, match="status 3"):
            slave.step(0.0, 0.1)
        slave.initialize(0.0, {"u0": [1.0]} if first else {})
        if first:
            assert slave.get("x", 1) == [4.0]
        slave.step(0.0, 0.1)
        for time, size in ((0.2, 0.1), (0.1, np.inf), (0.1, np.nan), (np.nan, 0.1), (0.1, -0.1)):
            with pytest.raises(Exception, match="status 3"):
                slave.step(time, size)
        for name in ("time", "x0[1]" if first else "u[1]", "x[1]" if first else "status"):
            with pytest.raises(Exception, match="status 3"):
                slave.set(**{name: 1})
        if first:
            expected = 4.0 * np.exp(-0.07) + 1.3 / 0.7 * (1.0 - np.exp(-0.07))
            assert slave.get("x[1]") == pytest.approx(expected, rel=1e-14)
        slave.step(0.1 * (1.0 + 1e-15), 0.1)
        slave.close()


@pytest.mark.few(1)
@pytest.mark.parametrize("version", VERSIONS)
def test_descriptions_tell_names_units_dependencies_and_inputs_before_the_start(tmp_path, version):
    names = Names("mine <&>", ("position (m)", "speed", "angle"), ("up", "down", "off"))
    law, path, u0 = plants.LAWS["mean"](GENERIC), tmp_path / "law.fmu", [0.5, -2.0]
    run = dt.Controller(law, 0.05, u0=u0)
    run.export_fmu(path, version=version, u0=u0, names=names)
    export_plant_fmu(GENERIC, tmp_path / "plant.fmu", version=version, u0=u0, names=names)
    for file in (path, tmp_path / "plant.fmu"):
        assert validate_fmu(str(file)) == []
        found = fmpy.read_model_description(str(file))
        variables = {v.name: v for v in found.modelVariables}
        assert variables["time"].unit == "s"
        assert variables["x[1]"].description.endswith(": position (m)")
        assert variables["mode"].description.endswith(": 0: up, 1: down, 2: off")
        assert float(variables["u0[2]"].start) == -2.0
        assert "mine <&>" in found.modelName
        assert [one.dependencies for one in found.outputs] == [[]] * len(found.outputs)
        outputs = {one.variable.name: one.dependencies for one in found.initialUnknowns}
        name, of = ("u[2]", "u0[2]") if file == path else ("x[2]", "x0[2]")
        assert [one.name for one in outputs[name]] == [of]
    slave = Slave(path, tmp_path / "law")
    assert slave.get("u", 2) == u0
    rng = np.random.default_rng(1)
    for k in range(10):
        x = rng.normal(size=3)
        slave.set(x=x.tolist())
        slave.step(0.05 * k, 0.05)
        plants.close(np.array(slave.get("u", 2)), run.update(x, 0), 1e-12, 10.0)
    slave.close()
    with pytest.raises(dt.ArgumentError, match=r"names\.states must be 3 names, got 1"):
        run.export_fmu(path, names=Names(states=("x",)))
    with pytest.raises(dt.ArgumentError, match="plant must be a SwitchedSystem, got"):
        export_plant_fmu(law, path)


def test_a_plant_whose_input_changes_too_often_names_the_argument(tmp_path):
    path = tmp_path / "plant.fmu"
    export_plant_fmu(plants.scalar([-0.7], delay=1.0), path, changes=4, version="2.0")
    with zipfile.ZipFile(path) as archive:
        assert b"with more `changes`" in archive.read("sources/model.c")


CASES = [("x", "2.0"), ("x", "3.0"), ("y", "2.0"), ("y", "3.0")]


@pytest.mark.few(1)
@pytest.mark.parametrize(("given", "version"), mostly_long(CASES, *CASES[:2]))
def test_a_law_on_a_belief_reads_no_mode_and_tells_how_likely_each_is(tmp_path, given, version):
    """Of the state, and of two outputs, on a bank of filters."""
    law, off = (LAWS["ages"](), 1e-11) if given == "x" else (from_outputs(), 1e-9)
    exported = dt.Controller(law, STEP).export_fmu(tmp_path / "law.fmu", version=version)
    assert "binaries/" in str(exported)
    assert validate_fmu(str(exported.path)) == []
    slave = Slave(exported.path, tmp_path / "law")
    assert not {"mode", "mode_age", "y[1]" if given == "x" else "x[1]"} & set(slave.variables)
    assert ("x[3]" if given == "x" else "y[2]") in slave.variables
    assert "y[3]" not in slave.variables
    assert slave.get("belief", 3) == pytest.approx([1 / 3] * 3, abs=1e-15)
    controller = dt.Controller(law, STEP)
    for k, seen in enumerate(record(law, 3.0).measured.T):
        slave.set(**{given: seen.tolist()})
        slave.step(k * STEP, STEP)
        u = controller.update(seen)
        np.testing.assert_allclose(slave.get("u", 2), u, rtol=off, atol=off)
        np.testing.assert_allclose(slave.get("belief", 3), controller.belief, atol=off)
        assert slave.get("status") == 0
    assert controller.belief.max() < 1.0
    assert slave.variables["belief[2]"].description == "probability of mode 1"
    slave.close()


@pytest.mark.parametrize("version", mostly_long(VERSIONS, "3.0"))
def test_a_servo_is_given_outputs_and_a_reference_and_tells_its_estimate(tmp_path, version):
    """Half of the samples with its own reference, half with one that comes in."""
    law, path = servo(), tmp_path / "law.fmu"
    controller = dt.Controller(law, STEP, limits=(-2.0, 2.5))
    controller.export_fmu(path, version=version)
    assert validate_fmu(str(path)) == []
    for reports in (False, True):
        controller.reset()
        slave = Slave(path, tmp_path / f"law{reports}", {"report_reference": reports})
        y, modes, *_ = hostile(law, 80)
        for k, (y_k, mode) in enumerate(zip(y, modes.tolist(), strict=True)):
            r = [np.sin(0.1 * k), math.nan if k == 50 else 0.5]
            slave.set(y=y_k, mode=mode, reference=r)
            slave.step(k * STEP, STEP)
            u = controller.update(y_k, mode, reference=r if reports else None)
            np.testing.assert_allclose(slave.get("u", 2), u, rtol=1e-12, atol=1e-13)
            assert slave.get("status") == controller.status
            x, found = controller.observing.z[:4], slave.get("estimate", 4)
            np.testing.assert_allclose(found, x, rtol=1e-12, atol=1e-13)
        slave.close()
