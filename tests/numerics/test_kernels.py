"""Kernels: the same numbers by Python and compiled, and when they go over."""

import os
import subprocess
import sys
import textwrap
import time
from types import SimpleNamespace

import numpy as np
import pytest

import deadtime as dt
from deadtime.base.checks import read_only
from deadtime.numerics import kernels
from deadtime.numerics.exponential import discretise, gramian
from deadtime.numerics.kernels import kernel
from deadtime.plant import SampledPlant
from deadtime.plant.pieces import gramian_up_to, gramians, sample_cuts, transitions
from deadtime.switching.grid import cuts_of


@kernel
def mean_square(a):
    total = 0.0
    for i in range(a.size):
        total += a[i] * a[i]
    return total / a.size


@pytest.fixture
def plant():
    rng = np.random.default_rng(2)
    return dt.SwitchedSystem(rng.normal(size=(3, 4, 4)), rng.normal(size=(3, 4, 2)), delay=0.234)


def test_both_ways_give_the_same_bits(monkeypatch, plant):
    def python_and_compiled(function, *args):
        return function.function(*args), function.dispatcher(*args)

    monkeypatch.setattr(kernels, "WISH", "never")
    A, B = plant.A[0], plant.B[0]
    for tau in (1e-3, 0.3, 7.0):
        ways = python_and_compiled(discretise, A, B, tau)
        for one, other in zip(*ways, strict=True):
            assert np.array_equal(one, other)
        assert np.array_equal(*python_and_compiled(gramian, A, B, tau, plant.identity))
    sampled = SampledPlant(plant, 0.1)
    signal = dt.SwitchingSignal([0.0, 0.17, 0.31], [0, 2, 1])
    cuts = cuts_of(signal, sampled)
    table = sampled.along(cuts, 8)
    place = sampled.every_stretch, cuts.step, cuts.offset, cuts.mode, 2
    for one, other in zip(*python_and_compiled(sample_cuts, *place), strict=True):
        assert np.array_equal(one, other)
    given = plant.A, plant.B, table, cuts.offset, cuts.mode
    M = gramians(*given, plant.identity)
    for e, stop in enumerate(table.stop):
        ways = python_and_compiled(gramian_up_to, *given, e, stop, plant.identity)
        assert np.array_equal(*ways)
        assert np.array_equal(ways[0], M[e])


@pytest.mark.parametrize("scale", [1.0, 1e200])
def test_what_numpy_does_at_once_has_the_bits_of_the_kernel(plant, scale):
    sampled = SampledPlant(plant, 0.1)
    cuts = cuts_of(dt.SwitchingSignal([0.0, 0.17, 0.18, 0.31], [0, 2, 0, 1]), sampled)
    table = sampled.along(cuts, 8)
    place = cuts.offset, cuts.mode
    entries = table.start, table.stop, table.mode, table.cut
    A = read_only(scale * plant.A)  # the larger one is beyond what floats hold
    for function, args in (
        (transitions, (A, plant.B, *entries, *place)),
        (gramians, (A, plant.B, table, *place, plant.identity)),
    ):
        ways = function.plain(*args), function.function(*args), function.dispatcher(*args)
        plain, python, compiled = (way if isinstance(way, tuple) else (way,) for way in ways)
        for one, two, three in zip(plain, python, compiled, strict=True):
            assert np.isfinite(one).any() == (scale == 1.0)
            assert np.array_equal(one, two, equal_nan=True)
            assert np.array_equal(one, three, equal_nan=True)


def test_what_numpy_does_runs_in_place_of_python_however_large(monkeypatch):
    own = kernel(lambda a: a[0], plain=lambda a: -a[0])
    monkeypatch.setattr(kernels, "START", np.inf)  # what an earlier run has compiled is left alone
    assert own(np.ones(kernels.LARGE + 1)) == -1.0
    monkeypatch.setattr(kernels, "PATIENCE", -1.0)
    assert own(np.ones(3)) == 1.0


def test_a_kernel_is_python_until_it_has_cost_its_patience(monkeypatch):
    monkeypatch.setattr(kernels, "START", np.inf)  # whatever other tests have run
    own = kernel(mean_square.function)
    a = np.ones(10)
    assert own(a) == 1.0
    assert own._ready is None
    monkeypatch.setattr(kernels, "PATIENCE", -1.0)
    assert own(a) == 1.0
    assert own._ready is not None


@pytest.mark.parametrize(("wish", "compiled"), [("always", True), ("never", False)])
def test_the_wish_decides(monkeypatch, wish, compiled):
    own = kernel(mean_square.function)
    monkeypatch.setattr(kernels, "WISH", wish)
    assert own(np.ones(kernels.LARGE + 1)) == 1.0
    assert (own._ready is not None) == compiled


def test_large_arguments_are_compiled_for_at_once_wherever_they_are_held():
    own, nested = kernel(mean_square.function), kernel(lambda pair: pair[0][0])
    own(np.ones(kernels.LARGE + 1))
    nested((np.ones(kernels.LARGE + 1), 1))
    assert own._ready is not None
    assert nested._ready is not None


def test_a_kernel_says_itself_how_many_numbers_are_large(monkeypatch):
    monkeypatch.setattr(kernels, "START", np.inf)  # what an earlier run has compiled is left alone
    own = kernel(mean_square.function, large=np.inf)
    patient = kernel(mean_square.function, large=2 * kernels.LARGE)
    eager = kernel(mean_square.function, large=5, plain=mean_square.function)
    for one in (own, patient, eager):
        one(np.ones(kernels.LARGE + 1))
    assert own._ready is patient._ready is None
    assert eager._ready is not None


def test_patience_is_of_a_processor_and_not_of_the_clock(monkeypatch):
    """Where other programs keep the machine busy, compiling takes as much longer as Python does."""

    @kernel
    def idle(a):
        time.sleep(0.2)
        return a[0]

    monkeypatch.setattr(kernels, "PATIENCE", 0.1)
    assert idle(np.ones(3)) == 1.0
    assert idle._own < 0.1


def test_what_is_compiled_is_used_at_once_where_many_calls_are_expected(monkeypatch):
    monkeypatch.setattr(kernels.Kernel, "spent", 0.0)
    before, after = kernel(mean_square.function), kernel(mean_square.function)
    mean_square.dispatcher(np.ones(3))
    for one in (before, after):
        monkeypatch.setattr(one, "dispatcher", mean_square.dispatcher)
    before(np.ones(3))
    kernels.expect_many_calls()
    after(np.ones(3))
    assert (before._ready, after._ready) == (None, mean_square.dispatcher)


def test_overflow_is_silent_both_ways():
    with np.errstate(all="raise"):
        assert kernel(mean_square.function)(np.full(3, 1e200)) == np.inf
        assert mean_square.dispatcher(np.full(3, 1e200)) == np.inf


def test_numbers_are_python_s_both_ways(monkeypatch):
    @kernel
    def ends(a):
        return a[0], (a.size > 1, a.size), a[-1:]

    monkeypatch.setattr(kernels, "WISH", "never")
    for first, (several, count), last in (ends(np.ones(3)), ends.dispatcher(np.ones(3))):
        assert [type(one) for one in (first, several, count)] == [float, bool, int]
        assert isinstance(last, np.ndarray)


def test_an_error_leaves_python_s_way_open():
    @kernel
    def fails(a):
        return a[7]

    with pytest.raises(IndexError):
        fails(np.ones(2))
    assert not kernels._THREAD.interpreting


def run(code, folder, **environment):
    """A program in a process of its own, its compile cache in a folder; what it prints."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder), "NUMBA_OPT": "0", **environment}
    program = [sys.executable, "-c", textwrap.dedent(code)]
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_one_run_needs_no_compiler(tmp_path):
    code = """
        import sys
        import deadtime as dt
        run = dt.problems.follower().simulate("averaged")
        run.metrics()
        print("numba" in sys.modules, "scipy.signal" in sys.modules)
    """
    assert run(code, tmp_path) == ["False", "False"]
    assert not list(tmp_path.rglob("*.nbi"))


MODULES = {
    "inner_kernel.py": """
        from deadtime.numerics.kernels import kernel
        @kernel
        def one(x):
            return {} * x
    """,
    "outer_kernel.py": """
        from deadtime.numerics.kernels import kernel
        from inner_kernel import one
        @kernel
        def two(x):
            return one(x) + 1.0
    """,
}


def test_a_change_in_a_kernel_that_another_file_calls_is_noticed(tmp_path):
    def write(factor):
        for name, text in MODULES.items():
            (tmp_path / name).write_text(textwrap.dedent(text).replace("{}", factor))

    code = "import outer_kernel; print(outer_kernel.two(1.0), outer_kernel.two.dispatcher.stats)"
    path = os.pathsep.join((str(tmp_path), *sys.path))
    found = []
    for factor in ("2.0", "2.0", "30.0"):
        if not (found and factor == "2.0"):
            write(factor)
        wish = {"PYTHONPATH": path, "DEADTIME_COMPILE": "always"}
        found.append(run(code, tmp_path / "cache", **wish)[0])
    assert found == ["3.0", "3.0", "31.0"]


def with_sums(folder):
    """A module `sums` with a kernel, in a folder that the environment returned adds to the path."""
    (folder / "sums.py").write_text(
        "from deadtime.numerics.kernels import kernel\n"
        "@kernel(eager=True)\n"
        "def total(pair):\n"
        "    return pair.real + pair.imag\n"
    )
    return {"PYTHONPATH": os.pathsep.join((str(folder), *sys.path))}


@pytest.mark.long
def test_what_is_compiled_for_a_type_that_is_gone_is_compiled_anew(tmp_path):
    path = with_sums(tmp_path)
    for name in ("Pair", "Couple"):
        fields = "    real: float\n    imag: float\n"
        (tmp_path / "pairs.py").write_text(
            f"from typing import NamedTuple\nclass {name}(NamedTuple):\n{fields}"
        )
        code = f"import sums, pairs; print(sums.total(pairs.{name}(1.0, 2.0)))"
        assert run(code, tmp_path / "cache", **path) == ["3.0"]


def kept_amid(kind, folder):
    """What is found of two things, the second kept by another while the first is."""
    folder.mkdir()
    first, second = (kind(str(folder), "total", ("stamp",)) for _ in range(2))
    load_index = first._load_index

    def interrupted():
        found, first._load_index = load_index(), load_index
        second.save("b", 2)
        return found

    first._load_index = interrupted
    first.save("a", 1)
    return [kind(str(folder), "total", ("stamp",)).load(key) for key in "ab"]


def test_two_processes_that_compile_one_kernel_lose_nothing(tmp_path):
    from numba.core.caching import IndexDataCacheFile

    from deadtime.numerics.compiling import _CacheFile

    assert kept_amid(_CacheFile, tmp_path / "own") == [1, 2]
    assert kept_amid(IndexDataCacheFile, tmp_path / "numba") == [1, None]
    assert _CacheFile(str(tmp_path / "own"), "total", ("later",)).load("a") is None


def test_the_cache_follows_intrinsics_and_what_makes_them():
    from deadtime.numerics.compiling import _stamp
    from deadtime.scenarios.by_period import fill_series

    files = {part[0] for part in _stamp(fill_series)}
    assert {"by_period.py", "intrinsics.py", "code.py"} <= files


def test_the_cache_follows_operators_which_no_kernel_calls_by_name():
    from deadtime.loop.observer_steps import predict_observer
    from deadtime.numerics.compiling import _stamp

    files = {part[0] for part in _stamp(predict_observer)}
    assert {"observer_steps.py", "operators.py", "intrinsics.py"} <= files


@pytest.mark.long
def test_a_numba_with_other_private_names_compiles_all_the_same(tmp_path):
    code = """
        from numba.core import caching
        del caching.Cache.cache_path, caching._Cache.cache_path
        from deadtime.numerics.compiling import is_cached
        import sums
        print(sums.total(1.0 + 2.0j))
        print(is_cached(object()))
    """
    assert run(code, tmp_path / "cache", **with_sums(tmp_path)) == ["3.0", "False"]


@pytest.mark.long
def test_where_no_folder_can_be_written_kernels_are_compiled_all_the_same(tmp_path):
    code = """
        from numba.core import caching
        caching.CacheImpl._locator_classes = []
        import sums
        print(sums.total(1.0 + 2.0j))
    """
    assert run(code, tmp_path / "cache", **with_sums(tmp_path)) == ["3.0"]


def test_many_short_compilations_are_said_as_one_long_one_is(monkeypatch):
    from deadtime.numerics import compiling

    clock, waits = [0.0], []

    class Timer:
        def __init__(self, seconds, _):
            waits.append(seconds)

        def start(self):
            pass

        def cancel(self):
            pass

    monkeypatch.setattr(compiling, "threading", SimpleNamespace(Timer=Timer))
    monkeypatch.setattr(compiling, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    notice = compiling._Notice()
    for _ in range(4):
        notice.on_start(None)
        clock[0] += 0.4
        notice.on_end(None)
        clock[0] += 10.0  # what is not compiling does not count
    assert waits == pytest.approx([1.0, 0.6, 0.2, 0.0])
