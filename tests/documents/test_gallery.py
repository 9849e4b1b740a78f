"""The gallery's scripts run, draw, name a source, find what they say; their physics is right."""

import contextlib
import functools
import io
import re
import runpy
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shares import mostly_long

EXAMPLES = Path(__file__).parents[2] / "examples"
SCRIPTS = [
    p
    for folder in ("walkthroughs", "gallery")
    for p in sorted((EXAMPLES / folder).glob("plot_*.py"))
]
NAMES = [path.stem.split("_", 2)[2] for path in SCRIPTS]
# Those that compile or search for seconds; tests of what they find are long, too.
LONG = (
    *("epidemic", "shared_network", "follower", "two_pipes"),
    *("robot_joint", "load_frequency", "three_modes"),
)


@functools.cache
def ran(name):
    """What a script leaves behind: its names, what it printed, sizes of its pictures. Run once."""
    said = io.StringIO()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        with contextlib.redirect_stdout(said):
            names = runpy.run_path(str(SCRIPTS[NAMES.index(name)]))
        pictures = [picture.stat().st_size for picture in Path(folder).glob("*.png")]
    return names | {"said": said.getvalue(), "pictures": pictures}


@pytest.mark.parametrize("name", mostly_long(NAMES, *(name for name in NAMES if name not in LONG)))
def test_script_runs_prints_names_its_source_and_leaves_pictures_of_decent_size(name):
    out = ran(name)
    docstring = out["__doc__"]
    title, line = docstring.split("\n")[1:3]
    assert line == "=" * len(title)
    source = docstring[docstring.index("**Source.**") :]
    assert re.search(r"\b(19|20)\d\d\b|arXiv \d{4}\.\d{5}", source)
    assert re.search(r"\b[Oo]urs\b", source)
    assert out["said"].count("\n") >= 4
    assert out["pictures"]
    assert all(10_000 < size <= 200_000 for size in out["pictures"])


@pytest.mark.long
def test_walkthroughs_find_what_they_say():
    said = ran("researcher")["said"]
    assert "D = 0.05 s, truncated: Stable" in said
    assert "D = 0.10 s, truncated: Not stable" in said
    assert said.count("averaged: Stable") == 5
    out = ran("process_engineer")
    low, high = out["fit"].interval("delay[1][0]")
    assert low < out["DEAD"]["low"] < high
    lines = re.findall(r"(.+): integral of the absolute error (\d+) K min", out["said"])
    error = {name: float(value) for name, value in lines}
    assert error["predicted"] < error["delay ignored, gentle"] < 0.1 * error["delay ignored"]
    assert float(abs(ran("embedded_engineer")["u"]).max()) < 12.0


def slopes(function, point):
    """The Jacobian at a point by central differences."""
    point, width = np.asarray(point, float), 1e-6
    columns = []
    for i in range(point.size):
        ahead, behind = point.copy(), point.copy()
        ahead[i] += width
        behind[i] -= width
        difference = np.array(function(*ahead)) - np.array(function(*behind))
        columns.append(difference / (2 * width))
    return np.stack(columns, axis=1)


def test_the_paper_s_loop_settles_while_it_switches_and_grows_in_either_mode():
    out = ran("paper")
    assert out["runs"]["averaged"].metrics()["final_norm"] < 0.2
    assert min(out["rates"]) > 0.1
    assert out["worst"].modes == (1,)
    assert_allclose(out["worst"].growth_rate, max(out["rates"]), rtol=0.02)


def test_every_bit_of_knowledge_makes_the_median_cheaper():
    out = ran("three_modes")
    medians = [float(out["data"].cost.sel(law=name).median()) for name in out["laws"]]
    assert all(b < 0.95 * a for a, b in pairwise(medians))


@pytest.mark.long
def test_the_follower_s_predictor_is_proved_and_pays_from_this_delay_on():
    out = ran("follower")
    assert out["certificate"].proven
    ratios = {name: np.array(row) for name, row in out["ratios"].items()}
    assert ratios["averaged"].max() < 1.1
    near = out["delays"] > out["limit"]
    assert ratios["delay ignored"][near].min() > 5.0


def test_the_joint_is_the_arm_linearised_and_its_load_is_bracketed():
    out = ran("robot_joint")
    plant = out["joint"](2.0)
    for mode, load in ((0, 0.0), (1, 2.0)):

        def motion(angle, speed, torque, load=load):
            return speed, out["acceleration"](load, angle, speed, torque)

        assert_allclose(slopes(motion, (0, 0, 0)), np.hstack((plant.A[mode], plant.B[mode])), 1e-6)
    # Without friction and motor a point load is a pendulum that falls at the rate √(g/l).
    bare, loaded = out["constants"](0.0), out["constants"](1.0)
    inertia, moment = loaded[0] - bare[0], loaded[2] - bare[2]
    assert_allclose(np.sqrt(moment / inertia), np.sqrt(9.81 / 0.45), rtol=1e-12)
    assert out["margin"].proven
    assert out["margin"].refuted / out["margin"].certified < 1.02


def test_the_grid_settles_where_the_book_says():
    out = ran("load_frequency")
    assert_allclose(out["frequency"], 59.7, atol=0.005)
    assert_allclose(out["tie_power"], -84.5, atol=0.05)
    stiffness = [1 / R + D for R, D in ((0.05, 0.6), (0.0625, 0.9))]
    assert_allclose(out["frequency"], 60 * (1 - 0.1875 / sum(stiffness)), atol=1e-4)
    # With the line out each area obeys its own cubic: governor, turbine, rotor.
    for i, (H, D, R, tg, tt) in enumerate(((5, 0.6, 0.05, 0.2, 0.5), (4, 0.9, 0.0625, 0.3, 0.6))):
        own = out["A"][1][np.ix_([2 + i, 4 + i, 6 + i], [2 + i, 4 + i, 6 + i])]
        cubic = np.polymul(np.polymul([2 * H, D], [tt, 1]), [tg, 1])
        cubic[-1] += 1 / R
        assert_allclose(np.sort(np.linalg.eigvals(own)), np.sort(np.roots(cubic)), rtol=1e-9)


def test_the_grid_needs_gains_for_its_period_and_the_epidemic_prediction():
    out = ran("load_frequency")
    assert np.median(out["errors"]["delay ignored"]) > 2 * np.median(out["errors"]["averaged"])
    for gains, stable in ((out["sampled"], True), (out["continuous"], False)):
        law = out["laws"](gains)["expected"]
        rates = [out["dt"].growth_rate(out["plant"], law, mode, out["PERIOD"]) for mode in (0, 1)]
        assert (max(rates) < 0.0) == stable


@pytest.mark.long
def test_the_epidemic_is_linearised_right_and_only_late_reactions_make_waves():
    out = ran("epidemic")
    for mode, part in enumerate((1.0, 0.5)):

        def numbers(exposed, infectious, u, part=part):
            R, infected = 1 + part * u, 0.23 * exposed
            return R * 1.3 / 4 * infectious - infected, infected - 1.3 / 4 * infectious

        # The aim: 1,000 infectious, and the exposed that keep it; scaled to relative deviations.
        aim = np.array([1000.0 * (1.3 / 4) / 0.23, 1000.0])
        jacobian = slopes(numbers, (*aim, 0.0)) / aim[:, None] * np.array([*aim, 1.0])
        model = np.hstack((out["plant"].A[mode], out["plant"].B[mode]))
        assert_allclose(jacobian, model, rtol=1e-6, atol=1e-9)
        assert_allclose(slopes(lambda e, i, u, p=part: out["rates"](e, i, u, p), (0, 0, 0)), model,
                        rtol=1e-6, atol=1e-9)  # fmt: skip
    laws, run = list(out["laws"].values()), out["simulate_bilinear"]
    predicted, _ = run(laws[0], out["obeyed"], out["start"], out["days"])
    fresh, _ = run(laws[1], out["obeyed"], out["start"], out["days"])
    assert np.abs(predicted[-60:] - 1).max() < 0.01
    assert np.ptp(fresh[-100:]) > 1.0


@pytest.mark.long
def test_the_reactor_has_the_poles_of_its_source_and_the_rule_run_forward_no_mismatch():
    out = ran("shared_network")
    assert_allclose(out["poles"], [1.991, 0.06351, -5.057, -8.666], rtol=5e-4)
    assert_allclose(out["B"].sum(axis=0), out["ACTUATORS"])
    runs = out["runs"]
    assert np.abs(runs["rule run forward"].mismatch).max() < 1e-9
    costs = [run.metrics()["cost"] for run in runs.values()]
    assert costs[0] < costs[1] / 5 < costs[2] / 1e6


def test_the_drone_is_its_model_linearised_and_the_push_is_made_up_for():
    out = ran("drone")
    for mode, drag in enumerate(out["drags"]):

        def motion(position, speed, tilt, command, drag=drag):
            return out["derivatives"](speed, tilt, command, drag)

        model = np.hstack((out["plant"].A[mode], out["plant"].B[mode]))
        assert_allclose(slopes(motion, (0, 0, 0, 0)), model, rtol=1e-6, atol=1e-9)
    # Tilted by 0.1 rad in calm air it comes to 17.8 m/s times that.
    A, B = out["plant"].A[0][1:, 1:], out["plant"].B[0][1:]
    assert_allclose(-np.linalg.solve(A, B)[:, 0] * 0.1, [1.78, 0.1], rtol=1e-12)
    late = (out["runs"]["predicts"].time > 12.0) & (out["runs"]["predicts"].time < 22.0)
    means = [abs(run.states[0, late].mean()) for run in out["runs"].values()]
    assert means[0] < 0.05 < 0.2 < means[1]
    assert np.abs(out["runs"]["delay ignored"].states[0, late]).max() > 1.0


@pytest.mark.long
def test_each_feed_is_as_late_as_its_pipe_is_long_and_no_single_delay_is_as_good_at_both():
    out = ran("two_pipes")
    assert_allclose(out["plant"].delays, [[0.4, 0.15], [0.8, 0.3]])
    # Mass and heat of two tanks, of unit volume, at flow q.
    for mode, q in enumerate(out["FLOWS"]):

        def motion(first, second, ordered, added, q=q):
            return [
                q * (ordered - first) + 0.6 * first,
                q * first + 0.5 * q * added - 1.5 * q * second + 0.7 * second,
            ]

        model = np.hstack((out["A"][mode], out["B"][mode]))
        assert_allclose(slopes(motion, (0, 0, 0, 0)), model, rtol=1e-6, atol=1e-9)
    cost, slowest = out["data"].cost.mean("scenario").values, np.array(out["slowest"])
    assert slowest[0] < slowest[1:].min() - 0.2
    assert cost[1:].min() > 0.9 * cost[0]
    assert slowest[out["best"]] > 0.5 * slowest[0]
