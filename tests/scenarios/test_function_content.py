"""What a function reads tells studies apart by content; what cannot be compared is refused."""

import copy
import functools
import json
import pickle
import threading
from collections import namedtuple
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import expon, uniform

import deadtime as dt
import plants
from deadtime.scenarios.sweeps.function_study import source_of, values_of
from own_sweep import filled, make_loop

Pair = namedtuple("Pair", "a b")
PLANT = plants.paper()


@dataclass(frozen=True)
class Setting:
    """A setting of the user's own."""

    gain: float
    table: tuple = ()

    def twice(self):
        return 2.0 * self.gain


class Slotted:
    """An object without a dictionary."""

    __slots__ = ("value",)

    def __init__(self, value):
        self.value = value


class Grower(list):
    """A list with something beside its items."""

    def __init__(self, items, rate):
        super().__init__(items)
        self.rate = rate


def holding(value):
    """What a function is described by that reads a value from around it."""

    def function(k):
        return k, value

    described = values_of(function)
    assert json.loads(json.dumps(described)) == described
    return described


def named(*texts):
    """A function from each text, as if each were a script of its own."""
    found = []
    for text in texts:
        own = {"np": np, "__name__": "__main__"}
        exec(text, own)
        found.append(own["f"])
    return found


def ring(value):
    """A list that holds itself."""
    whole = [value]
    whole.append(whole)
    return whole


BIG = np.arange(1000.0)
PAIRS = {
    "a number": (0.5, 0.25),
    "not a number": (float("nan"), float("inf")),
    "an array": (np.array([1.0, 2.0]), np.array([1.0, 2.5])),
    "an array's shape": (np.zeros((2, 3)), np.zeros((3, 2))),
    "an array's type": (np.zeros(2, np.float32), np.zeros(2)),
    "one entry of many": (BIG, np.where(np.arange(1000) == 999, -1.0, BIG)),
    "an array of objects": (np.array([{"a": 1}, None]), np.array([{"a": 2}, None])),
    "long doubles": (np.longdouble(1) / 3, np.longdouble(1.0 / 3.0)),
    "bytes": (b"ab", b"ac"),
    "a set": ({3, 1}, {3, 2}),
    "a mapping in mappings": ({"a": {"b": [0, {1: 2.0}]}}, {"a": {"b": [0, {1: 2.5}]}}),
    "a key": ({1: 0}, {"1": 0}),
    "a complex number": (1 + 2j, 1 - 2j),
    "a plant": (PLANT, PLANT.apart(0.5)),
    "a law": (plants.LAWS["averaged"](PLANT), plants.LAWS["mean"](PLANT)),
    "a model": (dt.Markov([[0, 2], [2, 0]]), dt.Markov([[0, 2], [1, 0]])),
    "a distribution": (expon(0.1, 0.2), expon(0.1, 0.3)),
    "another distribution": (expon(0.1, 0.2), uniform(0.1, 0.2)),
    "a semi-Markov model": (dt.SemiMarkov(expon(0.1), modes=2), dt.SemiMarkov(expon(0.2), modes=2)),
    "a problem": (dt.problems.paper(), replace(dt.problems.paper(), horizon=3.0)),
    "a partial function": (functools.partial(max, 1), functools.partial(max, 2)),
    "a bound method": (Setting(1.0).twice, Setting(2.0).twice),
    "an object": (Setting(1.0, (BIG,)), Setting(1.0, (BIG + 1.0,))),
    "slots": (Slotted(1), Slotted(2)),
    "a named tuple": (Pair(1, 2), Pair(1, 3)),
    "items": (Grower([1], 2), Grower([3], 2)),
    "what is beside items": (Grower([1], 2), Grower([1], 3)),
    "a ring": (ring(1), ring(2)),
    "lambdas in a line": (lambda x: x + 1, lambda x: x - 1),  # one line for both
    "a function of a library": (np.sin, np.cos),
    "a function of this package": (dt.simulate, dt.monte_carlo),
}


@pytest.mark.parametrize("name", PAIRS)
def test_what_is_around_a_function_is_compared_by_what_it_holds(name):
    one, other = PAIRS[name]
    assert holding(one) == holding(one)
    assert holding(one) != holding(other)


@pytest.mark.parametrize("name", [name for name in PAIRS if name != "lambdas in a line"])
def test_what_holds_the_same_is_the_same(name):
    one = PAIRS[name][0]
    assert holding(pickle.loads(pickle.dumps(one))) == holding(one)
    assert holding(copy.deepcopy(one)) == holding(one)


def test_what_an_object_has_computed_for_itself_makes_no_difference():
    problem, laws = dt.problems.paper(), [make(PLANT) for make in plants.LAWS.values()]
    model = dt.SemiMarkov(expon(0.1, 0.2), modes=2)
    held = [problem, *laws, PLANT, model]
    before = [holding(one) for one in held]
    for law in laws:
        dt.simulate(PLANT, law, problem.signal, problem.x0, 2.0, 0.05)
    model.sample(3.0)
    expon(0.1, 0.2).rvs(3)
    assert [holding(one) for one in held] == before


MODULE = "import types\nm = types.ModuleType('settings_of_mine')\n"
CALLABLE = (
    "import functools\nclass Like:\n def __init__(self, f, v):\n"
    "  functools.update_wrapper(self, f)\n  self.v = v\n"
)
HELPERS = {
    "a helper's source": ("def g(k): return k + 1", "def g(k): return k + 2"),
    "a helper's default": ("def g(k, a=1): return k + a", "def g(k, a=2): return k + a"),
    "a helper's own helper": (
        "def h(): return 1\ndef g(k): return h()",
        "def h(): return 2\ndef g(k): return h()",
    ),
    "a helper's array": (
        "a = np.ones(3)\ndef g(k): return a",
        "a = np.zeros(3)\ndef g(k): return a",
    ),
    "an array in an inner function": (
        "a = np.ones(3)\ndef g(k): return [lambda: a for _ in range(2)]",
        "a = np.zeros(3)\ndef g(k): return [lambda: a for _ in range(2)]",
    ),
    "a cached helper": (
        "import functools\n@functools.cache\ndef g(k): return 1",
        "import functools\n@functools.cache\ndef g(k): return 2",
    ),
    "a wrapped helper": (
        "import functools\ndef w(f):\n @functools.wraps(f)\n def i(k): return f(k)\n return i\n"
        "@w\ndef g(k): return 1",
        "import functools\ndef w(f):\n @functools.wraps(f)\n def i(k): return f(k)\n return i\n"
        "@w\ndef g(k): return 2",
    ),
    "a class's method": (
        "class g:\n def __init__(self, k): self.k = k",
        "class g:\n def __init__(self, k): self.k = -k",
    ),
    "a class's property": (
        "class g:\n @property\n def a(self): return 1",
        "class g:\n @property\n def a(self): return 2",
    ),
    "a class's attribute": ("class g:\n a = 1", "class g:\n a = 2"),
    "a class's base": (
        "class b:\n a = 1\nclass g(b): pass",
        "class b:\n a = 2\nclass g(b): pass",
    ),
    "a dataclass's default": (
        "from dataclasses import dataclass\n@dataclass\nclass g:\n a: int = 1",
        "from dataclasses import dataclass\n@dataclass\nclass g:\n a: int = 2",
    ),
    "a module's attribute": (
        f"{MODULE}m.D = 1\ndef g(k): return m.D",
        f"{MODULE}m.D = 2\ndef g(k): return m.D",
    ),
    "a module within a module": (
        f"{MODULE}m.n = types.ModuleType('m.n')\nm.n.D = 1\ndef g(k): return [m.n.D for _ in 'ab']",
        f"{MODULE}m.n = types.ModuleType('m.n')\nm.n.D = 2\ndef g(k): return [m.n.D for _ in 'ab']",
    ),
    "a function of a module": (
        f"{MODULE}m.h = lambda k: 1\ndef g(k): return m.h(k)",
        f"{MODULE}m.h = lambda k: 2\ndef g(k): return m.h(k)",
    ),
    "a callable that is like a function": (
        f"{CALLABLE}g = Like(lambda k: 0, 1)",
        f"{CALLABLE}g = Like(lambda k: 0, 2)",
    ),
    "an attribute that is called as a law's tables": (
        "class B: pass\ng = B()\ng._table = 1",
        "class B: pass\ng = B()\ng._table = 2",
    ),
    "a compiled helper": (
        "import numba\n@numba.njit\ndef g(k): return 1",
        "import numba\n@numba.njit\ndef g(k): return 2",
    ),
}


@pytest.mark.parametrize("name", HELPERS)
def test_helpers_and_globals_are_compared_by_what_they_do(name):
    pair = [f"{text}\ndef f(k): return g(k)\n" for text in HELPERS[name]]
    one, other, again = map(values_of, named(*pair, pair[0]))
    assert one == again
    assert one != other


def test_names_that_are_attributes_only_are_not_read():
    (function,) = named("a = (i for i in range(3))\ndef f(k): return k.a\n")
    assert values_of(function) == {}


def test_functions_that_call_each_other_end():
    (function,) = named("def g(k): return f(k)\ndef f(k): return g(k)\n")
    assert set(values_of(function)) == {"g"}
    assert source_of(function).startswith("f ")  # it has no file


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        ((i for i in range(3)), "generator"),
        (threading.Lock(), "lock"),
        (np.random.default_rng(0), "Generator"),
        (np.random.RandomState(0), "RandomState"),
    ],
)
def test_what_cannot_be_compared_is_refused_by_its_path(value, kind):
    message = rf"function reads parts\.deep\[1\], a {kind}, which cannot be compared .*: make it in"
    parts = {"deep": [0, value]}

    def loop(delay):
        return parts, delay

    with pytest.raises(dt.ArgumentError, match=message):
        dt.function_study(loop, {"delay": [0.1]})


def test_modules_of_ones_own_are_compared_by_what_is_read_of_them_and_refused_as_a_whole():
    read, whole = named(
        f"{MODULE}m.D, m.E = 1, object\ndef f(k): return m.D\n",
        f"{MODULE}def f(k): return vars(m)\n",
    )
    assert values_of(read) == {"m.D": 1}
    with pytest.raises(
        dt.ArgumentError, match=r"reads m, a module, .*: read what it holds by name"
    ):
        values_of(whole)


@pytest.mark.parametrize(
    "line",
    [
        "import settings_of_mine",
        "from . import settings_of_mine",
        "from .json import delay",  # called as one of Python's
        "def h():\n  import settings_of_mine\n h()",
    ],
)
def test_modules_of_ones_own_that_a_function_imports_itself_are_refused(line):
    inner, library = named(
        f"def g():\n {line}\ndef f(k): return g()\n",
        "def f(k):\n import numpy as np\n from scipy import linalg\n return np.pi\n",
    )
    with pytest.raises(dt.ArgumentError, match=r"function g imports .* import it at the top"):
        values_of(inner)
    assert values_of(library) == {}


def test_an_open_file_is_refused(tmp_path):
    with (tmp_path / "log.txt").open("w") as file:

        def loop(delay):
            file.write(str(delay))
            return make_loop(delay, 0.5)

        with pytest.raises(dt.ArgumentError, match="function reads file, a TextIOWrapper"):
            dt.function_study(loop, {"delay": [0.1]})


def around(plant):
    """A study whose function holds a plant."""

    def loop(weight):
        return make_loop(0.1, weight) | {"plant": plant}

    return dt.function_study(loop, {"weight": [0.5]}, scenarios=2)


def test_a_store_of_another_plant_is_refused_and_of_an_equal_one_resumed(tmp_path):
    made = [dt.SwitchedSystem(PLANT.A, PLANT.B, delay) for delay in (0.1, 0.1, 0.2)]
    filled(around(made[0]), tmp_path / "x.zarr")
    assert dt.sweep(around(made[1]), tmp_path / "x.zarr").done.all()
    with pytest.raises(dt.ArgumentError, match=r"values\.plant\.delays\.entries was \[\[0\.1\]"):
        dt.sweep(around(made[2]), tmp_path / "x.zarr")
