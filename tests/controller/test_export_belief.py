"""The C of a law on a belief: the answers and the belief of `Controller`, whatever comes in."""

import ctypes
import math
import re
import subprocess

import numpy as np
import pytest

import deadtime as dt
from belief_laws import GAINS, GENERIC, LAWS, MARKOV, PLANT, STEP, on_belief, paper, record
from c_code import Library, needs_compiler, needs_frama_c
from deadtime.controller import Status
from deadtime.controller.export.compiler import WARNINGS, compiler, self_check
from deadtime.feedback.belief import BeliefFilter
from shares import mostly_long

pytestmark = needs_compiler
UNDEFINED = ("-O1", "-fsanitize=undefined", "-fno-sanitize-recover=all")
BELIEF = """
double *NAME_belief(NAME_controller *c) { return &c->belief[0][0]; }
"""


def exact():
    """With no noise at all: predictions are known to round-off only."""
    law = dt.ExpectedPredictor(PLANT, GAINS, MARKOV)
    return dt.BeliefPredictor(law, dt.ModeFilter(PLANT, MARKOV, STEP))


def factorised():
    return on_belief(dt.ExpectedPredictor(GENERIC, GAINS, MARKOV), MARKOV, GENERIC, 0.005)


EVERY = LAWS | {"exact": exact, "factorised": factorised, "paper": paper}


def compiled(folder, law, options=("-O2",), **arguments):
    controller = dt.Controller(law, law.filter.step, **arguments)
    exported = controller.export_c(folder)
    assert exported.check.passed, exported.check
    library = Library(folder, law.plant, options=options, more=BELIEF)
    library.library.controller_belief.restype = ctypes.POINTER(ctypes.c_double)
    library.reset()
    return controller, library


def belief_of(library, controller):
    """As it stands in the struct, over modes and ages; a view."""
    shape = controller.state["belief"].shape
    return np.ctypeslib.as_array(library.call("belief"), shape)


@pytest.mark.few(2)
@pytest.mark.parametrize("name", EVERY)
def test_the_check_passes_and_visits_every_row(tmp_path, name):
    law = EVERY[name]()
    exported = dt.Controller(law, law.filter.step, limits=(-9.0, 9.0)).export_c(tmp_path)
    assert exported.check.passed, exported.check
    rows = len(law.law.digital(law.filter.step).state_gain)
    assert f", {rows} of {rows} rows, all" in exported.check.message


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "table",
    mostly_long(
        ["MODEL_X", "MODEL_U", "MODEL_NOISE", "HAZARD", "JUMP", "PRIOR"], "MODEL_NOISE", "HAZARD"
    ),
)
def test_a_number_of_the_filter_that_is_spoilt_is_found(tmp_path, table):
    law = LAWS["ages"]()
    dt.Controller(law, STEP).export_c(tmp_path)
    path = tmp_path / "controller_tables.h"
    text = path.read_text()
    whole = re.search(table + r"[\[\]\d]+ =\n([^;]*);", text)
    number = [one for one in re.finditer(r"-?\d[\d.e+-]*", whole.group(1)) if float(one.group())][
        -1
    ]
    a, b = (whole.start(1) + place for place in number.span())
    path.write_text(text[:a] + repr(1.01 * float(number.group())) + text[b:])
    check = self_check(tmp_path, "controller")
    assert check.passed is False
    assert " 0 differ" not in check.message


def hostile(law, count, seed=1):
    """A run of the loop, then with all that can be wrong with a call."""
    rng, plant = np.random.default_rng(seed), law.plant
    x = np.resize(record(law, 6.0, seed=seed).measured.T, (count, plant.states))
    applied, times, clock = [], [], 0.0
    for k in range(count):
        kind = rng.integers(0, 15)
        told = 0.3 * rng.normal(size=plant.inputs) if rng.random() < 0.2 else None
        if kind == 0:
            x[k, rng.integers(plant.states)] = (math.nan, math.inf, -math.inf)[k % 3]
        if kind == 1:
            told = np.full(plant.inputs, (math.nan, math.inf, -math.inf)[k % 3])
        clock += rng.choice([0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 3.0, 40.0])
        when = None if k < count // 2 else (clock + 0.4 * rng.uniform(-1.0, 1.0)) * STEP
        if kind == 2 and when is not None:
            when = rng.choice([math.nan, -1e300, 1e300, when - 1.0])
        applied.append(told)
        times.append(when)
    return x, rng.integers(-5, 9, count), applied, times


@pytest.mark.parametrize("name", mostly_long([*LAWS], "ages"))
def test_every_call_gets_the_answer_the_status_and_the_belief_of_the_controller(tmp_path, name):
    law = LAWS[name]()
    controller, library = compiled(tmp_path, law, UNDEFINED, limits=(-6.0, 5.0))
    seen = set()
    for x, mode, told, when in zip(*hostile(law, 1200), strict=True):
        u = controller.update(x, int(mode), told, time=when)
        found, status = library.run([x], [mode], [told], [when])
        assert status[0] == controller.status
        np.testing.assert_allclose(found[0], u, rtol=1e-10, atol=1e-11)
        expected = controller.state["belief"]
        np.testing.assert_allclose(belief_of(library, controller), expected, atol=1e-11)
        seen.add(int(status[0]))
    assert seen >= {0, 1, 2, 4, 7, 8}


@pytest.mark.long
@pytest.mark.parametrize(
    "count", [5_000, pytest.param(1_000_000, marks=pytest.mark.long)], ids=["few", "million"]
)
def test_a_million_periods_in_the_loop_give_the_inputs_of_the_run(tmp_path, count):
    """Each call is told what the run applied, so that round-off has no loop to grow in."""
    law, model = paper(), dt.Markov([[0.0, 1.25], [1.25, 0.0]])
    controller, library = compiled(tmp_path, law)
    horizon = count * 0.02
    noise = [dt.imperfections.WhiteDisturbance(1e-4), dt.imperfections.Noise(0.0)]
    signal = model.sample(horizon, seed=1)
    args = law.plant, law, signal, [-1.0, 1.0], horizon, 0.02
    run = dt.simulate(*args, imperfections=noise, seed=1)
    assert not run.diverged
    told = np.vstack((np.zeros(1), run.inputs.T[:-1]))
    found, status = library.run(run.measured.T, np.zeros(count + 1, int), told)
    assert (status == Status.OK).all()
    scale = np.abs(run.measured).max(axis=0) + np.abs(run.inputs).max()
    assert (np.abs(found.T - run.inputs) <= 1e-10 * scale).all()
    last = belief_of(library, controller).sum(axis=1)
    np.testing.assert_allclose(last, run.belief[:, -1], atol=1e-10)


def test_any_bits_at_all_get_a_finite_input_a_status_and_probabilities(tmp_path):
    law, rng, count = LAWS["ages"](), np.random.default_rng(5), 5_000
    controller, library = compiled(tmp_path, law, UNDEFINED)
    bits = rng.integers(0, 2**64, (count, 5), np.uint64, endpoint=False).view(np.float64)
    bits[::3] = rng.normal(size=(len(bits[::3]), 5)) * 10.0 ** rng.uniform(-200, 120, (1667, 1))
    told = [one if k % 2 else None for k, one in enumerate(bits[:, 3:])]
    for k in range(0, count, 10):
        part = slice(k, k + 10)
        found, status = library.run(bits[part, :3], np.zeros(10, int), told[part])
        assert np.isfinite(found).all()
        assert ((status >= 0) & (status <= 5)).all()
        belief = belief_of(library, controller)
        assert (belief >= 0.0).all()
        assert abs(belief.sum() - 1.0) < 1e-9
        assert belief.sum(axis=1).min() >= 0.3e-9  # no mode is ever ruled out


@pytest.mark.long
def test_a_copy_of_the_state_is_a_warm_restart_and_a_belief_that_is_none_is_said(tmp_path):
    law = LAWS["ages"]()
    controller, library = compiled(tmp_path, law)
    x, modes, told, times = hostile(law, 200, 3)
    library.run(x[:120], modes[:120], told[:120], times[:120])
    kept = library.state.raw
    whole, _ = library.run(x[120:], modes[120:], told[120:], times[120:])
    library.reset()
    assert library.call("restore", kept) == Status.OK
    again, _ = library.run(x[120:], modes[120:], told[120:], times[120:])
    assert again.tolist() == whole.tolist()
    good = record(law, 1.0).measured.T
    for bad in (math.nan, -0.1, 2.0, 0.9):
        assert library.call("restore", kept) == Status.OK
        belief_of(library, controller)[1, 0] = bad
        spoilt = library.state.raw
        found, status = library.run(good[:3], np.zeros(3, int))
        assert status[0] == 9
        assert np.isfinite(found).all()
        assert status[1:].max() <= Status.SATURATED
        assert abs(belief_of(library, controller).sum() - 1.0) < 1e-9
        assert library.call("restore", spoilt) == 10


FUNCTIONS = """
#include "controller.c"
void functions(int count, const double *v, double *out);
void functions(int count, const double *v, double *out)
{
    int i;
    for (i = 0; i < count; i++) {
        double l = controller_logarithm(v[i]);
        out[3 * i] = l;
        out[3 * i + 1] = controller_square_root(v[i]);
        out[3 * i + 2] = controller_exponential(l > 690.0 ? 1.0 : l);
    }
}
"""


def test_its_own_functions_are_those_of_the_library_to_two_units_in_the_last_place(tmp_path):
    dt.Controller(LAWS["mode"](), STEP).export_c(tmp_path)
    (tmp_path / "functions.c").write_text(FUNCTIONS, encoding="utf-8")
    target = tmp_path / "functions.so"
    command = [*compiler(), "-std=c99", "-O2", "-shared", "-fPIC", str(tmp_path / "functions.c")]
    subprocess.run([*command, "-o", str(target)], check=True)
    rng = np.random.default_rng(2)
    v = np.concatenate((2.0 ** rng.uniform(-590, 990, 20_000), rng.uniform(0.5, 2.0, 20_000)))
    v = np.concatenate((v, 2.0 ** np.arange(-500.0, 500.0), [1.0, 4.0, 2.0 - 2.0**-52]))
    out = np.empty((v.size, 3))
    pointers = (array.ctypes.data_as(ctypes.c_void_p) for array in (v, out))
    ctypes.CDLL(str(target)).functions(v.size, *pointers)
    log, root, exp = out.T
    assert (np.abs(log - np.log(v)) <= 2 * np.spacing(np.abs(np.log(v)))).all()
    assert (np.abs(root - np.sqrt(v)) <= np.spacing(np.sqrt(v))).all()
    y = np.where(log > 690.0, 1.0, log)
    expected = np.where(y >= -700.0, np.exp(y), 0.0)
    few = np.abs(y) < 690.0
    assert (np.abs(exp - expected) <= 2 * np.spacing(expected))[few].all()


def test_no_library_and_no_mode_is_needed(tmp_path):
    exported = dt.Controller(LAWS["mode"](), STEP).export_c(tmp_path)
    text = (tmp_path / "controller.c").read_text()
    assert re.findall(r"#include .*", text) == [
        '#include "controller.h"', '#include "controller_tables.h"',
    ]  # fmt: skip
    header = (tmp_path / "controller.h").read_text()
    assert re.findall(r"#include .*", header) == ["#include <stdint.h>"]
    assert "#define CONTROLLER_READS_MODE 0" in header
    numbers = sum(
        math.prod(map(int, re.findall(r"\[(\d+)\]", one)))
        for one in re.findall(
            r"real controller_[A-Z_]+([\[\]\d]+) =", (tmp_path / "controller_tables.h").read_text()
        )
    )
    assert exported.rom == 8 * numbers
    program = tmp_path / "size"
    (tmp_path / "size.c").write_text(
        '#include <stdio.h>\n#include "controller.h"\n'
        'int main(void) { printf("%d", (int)sizeof(controller_controller)); return 0; }\n'
    )
    subprocess.run(
        [*compiler(), *WARNINGS, str(tmp_path / "size.c"), "-o", str(program)], check=True
    )
    size = int(subprocess.run([str(program)], capture_output=True, check=True).stdout)
    assert abs(exported.ram - size) <= 16
    dt.Controller(LAWS["mode"]().law, STEP).export_c(tmp_path / "plain")
    for file in (tmp_path / "plain").glob("*.[ch]"):
        assert "belief" not in file.read_text().lower()


def test_what_cannot_be_is_refused_by_name(tmp_path):
    controller = dt.Controller(LAWS["mode"](), STEP)
    with pytest.raises(dt.ArgumentError, match="precision must be 'double' of BeliefPredictor"):
        controller.export_c(tmp_path, precision="float")
    with pytest.raises(dt.ArgumentError, match=r"tables take 4688 .* 4080 of them the mode filter"):
        controller.export_c(tmp_path, rom_budget=900)
    steep = dt.SwitchedSystem(PLANT.A + 1500.0 * np.eye(3), PLANT.B, PLANT.delays)
    law = dt.BeliefPredictor(
        dt.ExpectedPredictor(PLANT, GAINS, MARKOV), dt.ModeFilter(steep, MARKOV, STEP)
    )
    with pytest.raises(dt.ArgumentError, match="law's filter has no C: over one period"):
        dt.Controller(law, STEP).export_c(tmp_path)
    assert not list(tmp_path.iterdir())


# At every change the sanitizers look on above, and Frama-C at laws that are told the mode. Here
# ages that begin anywhere, and those that begin at samples: the C of the others is a part of it.
@needs_frama_c
@pytest.mark.long
@pytest.mark.parametrize("name", ["ages", "at samples"])
def test_frama_c_finds_no_alarm_from_any_state(tmp_path, name):
    law = EVERY[name]()
    dt.Controller(law, law.filter.step, limits=(-9.0, 9.0)).export_c(tmp_path)
    run = subprocess.run(["make", "eva"], cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("0 alarms generated by the analysis") == 2, run.stdout
    assert "eva:alarm" not in run.stdout, run.stdout


class Unforgetting(BeliefFilter):
    """A filter of one's own, whose form has numbers of other types."""

    def __init__(self, filt):
        own = {name: getattr(filt, name) for name in ("plant", "step", "disturbance", "outputs")}
        vars(self).update(**own, filt=filt)

    def form(self, ages=1):
        form = self.filt.form(ages)
        return form._replace(forgetting=0, within=np.bool_(form.within))


def test_a_form_may_have_numbers_of_other_types(tmp_path):
    law = LAWS["mode"]()
    own = dt.BeliefPredictor(law.law, Unforgetting(law.filter))
    assert dt.Controller(own, STEP).export_c(tmp_path).check.passed
