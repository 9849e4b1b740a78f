"""A study says what its sweep varies; a bad one is refused by line and by the nearest name."""

import functools
import itertools
import json
import math

import numpy as np
import pytest

import deadtime as dt
from deadtime.scenarios.sweeps.axes import AXES
from own_sweep import PROBLEM, STUDY, filled, load, make_loop

# In a file


def test_values_go_where_their_names_and_paths_say(tmp_path):
    named = {
        "distance": 0.5, "delay": 0.3, "speed": 2.0, "step": 0.01, "horizon": 3.0, "start": 2.0,
        "delay_error": 0.1, "gain_error": -0.2, "sojourn": "uniform", "dwell_time": 0.4,
        "noise": 0.1, "measurement_delay": 0.03, "jitter": 0.005, "dropout": 0.2, "mode_delay": 2,
        "wrong_mode": 0.1, "saturation": 5.0, "rate_limit": 50.0, "disturbance": 0.01, "seed": 7,
    }  # fmt: skip
    assert set(named) == set(AXES)
    lines = "\n".join(f"{name} = {json.dumps(value)}" for name, value in named.items())
    study = load(tmp_path, STUDY.split("plant.delay")[0] + lines + "\nrun.x0.1 = 4.0\n")
    draft, loop = study.draft(next(study.cells())), study.loop(next(study.cells()))
    assert study.shape == (1,) * (len(named) + 1)
    # By hand: α = 0.5, D = 0.3; then errors of the true delay and of the true B.
    A = np.array([[0.2, 1.0, 0.0], [0.0, 0.4, 1.0], [0.3, 0.0, -0.5]])
    np.testing.assert_allclose(loop.plant.A[1], A + 0.5 * (np.array(
        [[0.3, 1.1, 0.0], [0.1, 0.3, 0.9], [0.2, 0.0, -0.4]]) - A), rtol=1e-15)  # fmt: skip
    assert loop.plant.delay == pytest.approx(0.33, rel=1e-15)
    assert loop.laws["averaged"].plant.delay == 0.3
    np.testing.assert_allclose(loop.plant.B, 0.8 * loop.laws["averaged"].plant.B, rtol=1e-15)
    assert draft["gains"]["poles"] == [-3.0, -4.0, -5.0]
    assert (loop.step, loop.horizon, loop.x0.tolist()) == (0.01, 3.0, [2.0, 8.0, 1.0])
    assert loop.laws["told"].dwell_time == 0.4
    assert loop.laws["averaged"].dwell_time is None
    assert loop.model.sample(50.0).dwell_time >= 0.4 * (1 - 1e-12)
    assert [type(one).__name__ for one in loop.imperfections] == [
        "Noise", "MeasurementDelay", "Jitter", "Dropout", "ModeDelay", "WrongMode", "Saturation",
        "RateLimit", "WhiteDisturbance",
    ]  # fmt: skip


def test_nothing_is_imperfect_where_an_axis_is_zero(tmp_path):
    study = load(tmp_path, STUDY.replace("delay_error = [-0.1, 0.0, 0.1]", "noise = [0.0, 0.1]"))
    first, second = (study.loop(study.cell((0, 0, i))) for i in (0, 1))
    assert (len(first.imperfections), len(second.imperfections)) == (0, 1)


LIMITED = """\
[signal]
kind = "random"
dwell_time = [0.1, 0.2, 0.15]
maximum_dwell = [0.4, inf, 0.3]
transitions = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
"""


@pytest.mark.long
def test_cells_draw_the_signals_that_the_problem_allows_until_an_axis_replaces_them(tmp_path):
    before, after = PROBLEM.split("[switching]")[0], "[run]" + PROBLEM.split("[run]")[1]
    before = before.split('[[law]]\nkind = "expected"')[0]
    allowed = {
        "dwell_time": [0.1, 0.2, 0.15],
        "maximum_dwell": [0.4, math.inf, 0.3],
        "transitions": [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    }
    study = load(tmp_path, STUDY, before + LIMITED + after)
    for cell in itertools.islice(study.cells(), 4):
        for seed in range(5):
            study.loop(cell).model.sample(20.0, seed=seed).require_admissible(**allowed)
    replaced = STUDY.replace("law.told.dwell_time = [0.1, 0.15]", "dwell_time = [0.1]")
    drawn = load(tmp_path, replaced, before + LIMITED + after)
    signal = drawn.loop(next(drawn.cells())).model.sample(20.0, seed=1)
    with pytest.raises(dt.ArgumentError, match=r"in mode 2 .*shorter than its dwell_time"):
        signal.require_admissible(**allowed)


BAD = [
    ("plant.delay", "plant.dely", r"line 7, .*plant\.dely is not known: did you mean delay\?"),
    ("plant.delay", "delai", r"line 7, .*delai is not known: did you mean delay\?"),
    ("plant.delay", "low_pas", r"line 7, .*low_pas is not known"),
    ("law.told", "law.tolled", r"line 8, .*'tolled' is not there: .*averaged, told, expected"),
    ("law.told", "law.7", r"line 8, .*'7' is not there"),
    ("dwell_time = [0.1, 0.15]", 'dwell_time = ["a"]', r"line 8, .*dwell_time: .*got 'a'"),
    ("delay_error", "delay_eror", r"line 9, .*delay_eror is not known: did you mean delay_error"),
    ("[-0.1, 0.0, 0.1]", "[]", r"line 9: grid\.delay_error: must hold at least one value"),
    ("[-0.1, 0.0, 0.1]", "[-1.5]", r"line 9: grid\.delay_error\.0: .* greater than -1"),
    ("[0.234, 0.31]", "[0.3, 0.3]", r"line 7, .*plant\.delay: holds 0\.3 twice"),
    ("[0.234, 0.31]", "[]", r"line 7, .*plant\.delay: must hold at least one value"),
    ("scenarios = 12", 'laws = ["told", "orcle"]', r"laws: law 'orcle' is not known: .*'oracle'"),
    ("scenarios = 12", 'metrics = ["isse"]', r"line 3: .*'isse' is not known: did you mean 'ise'"),
    ("seed = 3", "horizn = 3.0", r"line 4: horizn is not known: did you mean horizon\?"),
    ("[grid]", "[grid]\nspeed = [2.0]\ntitel = 3", r"line 8, .*titel is not known: known are"),
    ("plant.delay = [0.234, 0.31]", "plant.delay = [0.3]\ndelay = [0.4]",
     r"line 7, .*plant\.delay is overwritten by delay: keep one"),
    ("plant.delay = [0.234, 0.31]", "dwell_time = [0.3, 0.4]",
     r"line 8, .*law\.told\.dwell_time is overwritten by dwell_time: keep one"),
    ("plant.delay = [0.234, 0.31]", '"plant.delay" = [0.3]\nplant.delay = [0.4]',
     r"line 7, .*plant\.delay is given twice: keep one of them"),
    ("plant.delay = [0.234, 0.31]", 'law.told.kind = ["mean"]', r"line 7, .*changes no result"),
    ("plant.delay = [0.234, 0.31]", "run.seed = [1, 2]", r"line 7, .*run\.seed changes no result"),
    ("plant.delay = [0.234, 0.31]", "signal.mode = [0, 1]", r"line 7, .*mode changes no result"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), BAD, ids=range(len(BAD)))
def test_a_bad_study_is_refused_by_line_and_nearest_name(tmp_path, old, new, message):
    assert old in STUDY
    with pytest.raises(dt.StudyFileError, match=message) as caught:
        load(tmp_path, STUDY.replace(old, new, 1))
    assert "\n" not in str(caught.value)


# In Python


def test_cells_can_be_made_in_python(tmp_path):
    grid = {"delay": [0.1, 0.17], "weight": np.array([0.2, 0.5]), "seed": [0, 1]}
    study = dt.function_study(make_loop, grid, scenarios=5)
    data = filled(study, tmp_path / "mine.zarr").load()
    loop = make_loop(0.17, 0.5)
    direct = dt.monte_carlo(**loop, scenarios=5, seed=1)
    np.testing.assert_array_equal(
        data.ise.sel(delay=0.17, weight=0.5, seed=1).values, direct.ise.values
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"grid": {"delay": []}}, r"grid\['delay'\] must hold at least one value and none twice"),
        ({"grid": {"delay": [0.1, 0.1]}}, r"none twice, got \[0\.1, 0\.1\]"),
        ({"grid": {"delay": "abc"}}, r"grid\['delay'\] must be a list of values, got 'abc'"),
        ({"grid": {"delay": [None]}}, r"grid\['delay'\] must hold numbers or texts, got None"),
        ({"metrics": ["isee"]}, r"metrics must be some of .*, got 'isee'"),
        ({"scenarios": 0}, r"scenarios must be an integer of at least 1"),
        ({"function": 3}, r"function must be a function, got int: write one by def"),
        ({"function": lambda delay: {"plant": 1}}, r"function must return a mapping with plant"),
        (
            {"function": functools.partial(make_loop, weight=0.5)},
            r"a function, got partial",
        ),
        ({"function": lambda delay: 1 / 0}, r"function failed: ZeroDivisionError: division"),
        (
            {"function": lambda delay: make_loop(delay, 0.5) | {"step": 0.0}},
            r"step must be positive",
        ),
        ({"function": lambda delay: make_loop(delay, 0.5) | {"x0": [1.0]}}, r"x0 must have shape"),
        (
            {"function": lambda delay: make_loop(delay, 0.5) | {"model": 3}},
            r"model must have",
        ),
        (
            {"function": lambda delay: make_loop(delay, 0.5) | {"plant": 3}},
            r"plant must be",
        ),
        ({"grid": {"law": [1]}}, r"'law' cannot be the name of an axis"),
        ({"grid": {"a/b": [1]}}, r"'a/b' cannot be the name of an axis"),
        ({"metrics": ["ise", "ise"]}, r"each once, got 'ise'"),
    ],
)
def test_a_bad_study_in_python_is_refused(change, message):
    function = change.pop("function", lambda delay: make_loop(delay, 0.5))
    with pytest.raises(dt.ArgumentError, match=message):
        dt.function_study(function, **{"grid": {"delay": [0.1]}, **change})


def weighted(weight):
    def loop(delay):
        return make_loop(delay, weight)

    return dt.function_study(loop, {"delay": [0.1]}, scenarios=3)


def test_values_around_a_function_tell_studies_apart(tmp_path):
    filled(weighted(0.3), tmp_path / "x.zarr")
    with pytest.raises(dt.ArgumentError, match=r"values\.weight was 0\.3, is 0\.4"):
        dt.sweep(weighted(0.4), tmp_path / "x.zarr")


def test_an_axis_of_one_s_own_keeps_its_name(tmp_path):
    study = dt.function_study(
        lambda speed: make_loop(0.1, speed), {"speed": [0.2, 0.4]}, scenarios=2
    )
    data = filled(study, tmp_path / "x.zarr")
    assert data.speed.attrs == {"long_name": "speed"}
    assert str(study.cell((1,))) == "speed 0.4"
