"""The ideal loop under a rule, and the published example of max-switching with an input delay."""

import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import deadtime as dt
import plants
import rule_reference as second
from deadtime.cli.application import main
from deadtime.laws import StateDependentPredictor
from deadtime.problems.file import load_problem
from deadtime.problems.file.load import problem_with_run
from deadtime.switching import FunctionRule, HalfSpace, QuadraticRegions
from sectors import EDGES, PLANE, SECTORS, sector

# The example of arXiv 2603.20027.
A = np.array([[[1.0, -5.0], [0.0, 3.0]], [[3.0, 0.0], [5.0, 1.0]]])
B = np.array([[[0.0], [1.0]], [[1.0], [0.0]]])
K = np.array([[[0.0, -2.0]], [[-2.0, 0.0]]])
S = np.array([[[1.0432, 1.0031], [1.0031, 2.9722]], [[2.9722, -1.0031], [-1.0031, 1.0432]]])
EXAMPLE = dt.SwitchedSystem(A, B, 2.0)
LARGEST = QuadraticRegions(S)
LAW = StateDependentPredictor(EXAMPLE, K, LARGEST, allow_unstable=True)
X0 = [2.0, -1.0]


def example(step, horizon=10.0, times=None):
    return dt.simulate(EXAMPLE, LAW, LARGEST, X0, horizon, step, times=times)


def published(end):
    """x as a function of time, and the switching times: SciPy's events, nothing of the package."""
    form, x, parts, switches = S[0] - S[1], np.array(X0), [], []
    mode = int(x @ form @ x < 0.0)
    for begin, until, loop in ((0.0, 2.0, A), (2.0, end, A + B @ K)):
        t = begin
        while t < until:

            def crossing(_, y):
                return y @ form @ y

            crossing.terminal, crossing.direction = True, 1.0 if mode else -1.0
            found = solve_ivp(
                lambda _, y, M=loop[mode]: M @ y, (t, until), x, method="DOP853", rtol=1e-13,
                atol=1e-14, events=crossing, dense_output=True,
            )  # fmt: skip
            t, x = float(found.t[-1]), found.y[:, -1]
            parts.append((t, found.sol))
            if found.status:
                mode = 1 - mode
                switches.append(t)
    return lambda s: next(solution(s) for until, solution in parts if s <= until), switches


# -- the published example ---------------------------------------------------------------------


def test_the_example_follows_its_differential_equation_to_1e_10_for_10_seconds():
    x, switches = published(12.0)
    one = example(None)
    states = np.array([x(t) for t in one.time]).T
    plants.close(one.states, states, 1e-10)
    ahead = np.array([x(t + 2.0) for t in one.time])
    modes = np.array([int(z @ (S[0] - S[1]) @ z < 0.0) for z in ahead])
    plants.close(one.inputs.T, np.einsum("tmn,tn->tm", K[modes], ahead), 1e-10)
    plants.close(one.signal.times[1:], np.array(switches), 1e-11)
    assert np.abs(one.mismatch).max() <= 1e-13 * np.abs(one.inputs).max()
    assert one.message == ""
    # Without a crossing between them, at other times too.
    some = np.sort(np.random.default_rng(2).uniform(0.0, 10.0, 50))
    fine = example(None, times=some)
    plants.close(fine.states, np.array([x(t) for t in some]).T, 1e-10)
    squares = np.array([x(t) @ x(t) for t in np.linspace(0.0, 10.0, 100_001)])
    ise = (squares.sum() - 0.5 * (squares[0] + squares[-1])) * 1e-4
    assert one.metrics()["ise"] == pytest.approx(ise, rel=1e-6)


@pytest.mark.parametrize("step", [None, 0.01])
def test_the_example_peaks_at_17_46_and_decays(step):
    one = example(step)
    metrics = one.metrics()
    assert metrics["peak"] == pytest.approx(17.46, abs=0.005)
    assert metrics["decay_rate"] > 0.55
    assert metrics["final_norm"] < 0.2
    assert one.end == 10.0
    assert np.abs(one.mismatch).max() <= 1e-12
    if step is not None:
        assert re.fullmatch(
            r"slid along the boundary between modes 0 and 1, 7 times, for 0\.018\d* s in all, "
            r"first at t = 2\.962\d* s\.",
            one.message,
        )


def test_the_smallest_form_does_not_stabilise_the_example():
    rule = QuadraticRegions(-S)
    law = StateDependentPredictor(EXAMPLE, K, rule, allow_unstable=True)
    one = dt.simulate(EXAMPLE, law, rule, X0, 10.0, step=None)
    assert one.metrics()["final_norm"] > 1e6


def slope_of(steps, errors):
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


@pytest.mark.long
def test_the_digital_example_comes_close_to_the_ideal_with_order_1():
    steps = [0.04, 0.02, 0.01, 0.005, 0.0025]
    times = np.linspace(0.0, 10.0, 251)
    ideal = example(None, times=times).states
    errors = np.array(
        [np.linalg.norm(example(h, times=times).states - ideal, axis=0) for h in steps]
    )
    # Up to the first switch that a held input has moved, exactly h. From there on it depends on
    # where in a period each switch falls, too.
    early = errors[:, times <= 2.4].max(axis=1)
    assert slope_of(steps, early) == pytest.approx(1.0, abs=0.01)
    assert early[-1] < 7.5 * steps[-1]
    whole = np.sqrt((errors**2).mean(axis=1))
    assert (np.diff(whole) < 0.0).all()
    assert 1.0 < slope_of(steps, whole) < 1.6
    assert whole[-1] < 0.03


def test_the_digital_example_equals_an_integration_with_sliding():
    step, plant = 0.25, dt.SwitchedSystem(A, B, 0.5)
    law = StateDependentPredictor(plant, K, LARGEST, allow_unstable=True)
    one = dt.simulate(plant, law, LARGEST, X0, 4.0, step)
    form = S[0] - S[1]
    other = second.Plant(
        A, B, 0.5, lambda x: int(x @ form @ x < 0.0), [lambda x: float(x @ form @ x)]
    )
    states, inputs, _ = second.run(
        other, second.predictor(other, K, step), np.array(X0), np.zeros((2, 1)), step, 17
    )
    assert len(one.record.slides.slides(step, 4.0)) >= 3
    plants.close(one.states.T, states, 1e-9)
    plants.close(one.inputs.T, inputs, 1e-9)


# -- other plants ------------------------------------------------------------------------------


@pytest.mark.few(1)
@pytest.mark.parametrize(("seed", "slides"), [(0, 0), (1, 1), (3, 1), (5, 1)])
def test_three_modes_follow_the_delay_free_loop_from_the_delay_on_sliding_or_not(seed, slides):
    gains = 0.8 * np.random.default_rng(seed).normal(size=(3, 1, 2))
    x0 = np.random.default_rng(seed + 20).normal(size=2)
    law = StateDependentPredictor(PLANE, gains, SECTORS, allow_unstable=True)
    line = np.array([[0.7, -0.4]])
    times = np.linspace(0.0, 2.4, 13)
    one = dt.simulate(PLANE, law, SECTORS, x0, 2.4, None, u0=line, times=times)
    assert one.message.count("slid along") == slides

    boundaries = [lambda x, row=row: float(row @ x) for row in EDGES]
    opened = second.Plant(PLANE.A, PLANE.B, 0.37, sector, boundaries)
    closed = second.Plant(PLANE.A + PLANE.B @ gains, PLANE.B, 0.37, sector, boundaries)
    for time, x in zip(times[1:], one.states.T[1:], strict=True):
        y = x0
        for u in line.T:
            y, _ = opened.flow(y, u, min(0.185, time)) if time > 0.0 else (y, [])
            time -= 0.185
        if time > 0.0:
            y, _ = closed.flow(y, np.zeros(1), time)
        plants.close(x, y, 1e-9)


def test_a_closed_loop_that_slides_has_a_closed_form():
    # x' = (x₃, 0) + b u and (−x₂, 0) + b u with b = (0, 1), u = −x₂ or −2x₂, x₃ = 1. On x₁ = 0
    # a = 1, b = −x₂, so x₂' = (−2x₂ − x₂²)/(1 + x₂): with q = x₂(x₂ + 2), q' = −2q.
    plant = dt.SwitchedSystem(
        [[[0, 0, 1], [0, 0, 0], [0, 0, 0]], [[0, -1, 0], [0, 0, 0], [0, 0, 0]]],
        [[[0], [1], [0]]] * 2, 0.5,
    )  # fmt: skip
    rule = HalfSpace([1.0, 0.0, 0.0])
    law = StateDependentPredictor(plant, [[[0, -1, 0]], [[0, -2, 0]]], rule, allow_unstable=True)
    one = dt.simulate(plant, law, rule, [-0.5, 3.0, 1.0], 3.0, step=None)
    late = one.time >= 0.5
    q = 15.0 * np.exp(-2.0 * (one.time[late] - 0.5))
    np.testing.assert_allclose(one.states[1, late], np.sqrt(1.0 + q) - 1.0, rtol=1e-12)
    assert np.abs(one.states[0, late]).max() <= 1e-14
    assert one.message == (
        "slid along the boundary between modes 0 and 1, once, for 2.5 s in all, first at t = 0.5 s."
    )
    # It came from mode 0, and so is the gain.
    x2 = np.sqrt(1.0 + 15.0 * np.exp(-2.0 * one.time)) - 1.0
    np.testing.assert_allclose(one.inputs[0], -x2, rtol=1e-12)
    assert np.abs(one.mismatch).max() <= 1e-14


def test_a_rule_that_never_switches_gives_the_oracle_s_ideal_run_along_a_constant_signal():
    plant, gains = plants.paper(), dt.place(plants.paper(), [-1.0, -2.0])
    for rule in (HalfSpace([1.0, 0.0], 1e9), lambda x: 0):
        law = StateDependentPredictor(plant, gains, rule)
        one = dt.simulate(plant, law, rule, [-1.0, 1.0], 5.0, None, u0=0.3)
        exact = dt.ExactPredictor(plant, gains)
        other = dt.simulate(
            plant, exact, dt.SwitchingSignal.constant(0), [-1.0, 1.0], 5.0, None, u0=0.3
        )
        plants.close(one.states, other.states, 1e-11)
        plants.close(one.inputs, other.inputs, 1e-10)
        for key, value in other.metrics().items():
            assert one.metrics()[key] == pytest.approx(value, rel=1e-8)


def test_a_function_and_a_half_space_that_say_the_same_give_the_same_ideal_run():
    problem = dt.problems.paper()
    runs = []
    for rule in (HalfSpace([1.0, 1.0], 0.5), lambda x: int(x[0] + x[1] >= 0.5)):
        law = StateDependentPredictor(problem.plant, problem.gains, rule)
        runs.append(dt.simulate(problem.plant, law, rule, [-1.0, 1.0], 10.0, None))
    assert runs[0].signal.switches >= 2
    plants.close(runs[1].states, runs[0].states, 1e-11)
    assert runs[0].metrics()["final_norm"] < 0.01


# -- runs that end early -----------------------------------------------------------------------


def pushing(delay):
    """x₁' = ±x₂ with x₂ = 1: from x₁ < 0 and x₁ > 0 to 0."""
    up = np.array([[0.0, 1.0], [0.0, 0.0]])
    return dt.SwitchedSystem([up, -up], np.zeros((2, 2, 1)), delay)


def test_a_function_whose_boundary_both_modes_point_at_ends_the_ideal_run():
    plant = pushing(0.5)
    rule = FunctionRule(lambda x: int(x[0] >= 0.0))
    law = StateDependentPredictor(plant, np.zeros((2, 1, 2)), rule, allow_unstable=True)
    one = dt.simulate(plant, law, rule, [-2.0, 1.0], 3.0, None)
    assert one.end == pytest.approx(1.5, abs=1e-12)
    assert one.message == (
        "chattering at t = 2 s: both vector fields point at the boundary between modes 0 and 1, "
        "and a function does not say how to slide along it: use HalfSpace, Polyhedra or "
        "QuadraticRegions, a delay ahead: the run ends at t = 1.5 s."
    )
    assert not one.diverged
    with pytest.raises(
        dt.ArgumentError, match=r"x0 leads to no ideal loop, chattering at t = 0\.3 s"
    ):
        dt.simulate(plant, law, rule, [-0.3, 1.0], 3.0, None)


def test_an_ideal_run_that_diverges_under_a_rule_ends_and_says_so():
    plant = plants.scalar([50.0, 60.0], delay=0.1)
    rule = HalfSpace([1.0], 5.0)
    law = StateDependentPredictor(plant, np.zeros((2, 1, 1)), rule, allow_unstable=True)
    one = dt.simulate(plant, law, rule, [1.0], 100.0, None)
    assert one.diverged
    assert 3.0 < one.end < 5.0
    assert one.message == f"diverged: |x| left 1e100 after t = {one.end:g} s, where the run ends."


# -- what is refused ---------------------------------------------------------------------------


def ideal(plant=EXAMPLE, law=LAW, rule=LARGEST, horizon=10.0, u0=None):
    return dt.simulate(plant, law, rule, X0, horizon, step=None, u0=u0)


def like(A=A, B=B, delay=2.0, rule=LARGEST):
    return StateDependentPredictor(dt.SwitchedSystem(A, B, delay), K, rule, allow_unstable=True)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ideal(law=like(A=1.01 * A)), "step must be given where the A of the law's model"),
        (lambda: ideal(law=like(B=1.01 * B)), "step must be given where the B of the law's model"),
        (lambda: ideal(law=like(delay=2.01)), "step must be given where the delay of the law's m"),
        (
            lambda: ideal(law=like(rule=QuadraticRegions(-S))),
            "step must be given where the law's rule is not the plant's: the ideal loop of",
        ),
        (
            lambda: ideal(rule=lambda x: 0),
            "step must be given where the law's rule is not the plant's: the ideal loop of",
        ),
        (
            lambda: ideal(law=dt.DelayedStateFeedback(EXAMPLE, K, allow_unstable=True)),
            "step must be given where a rule switches the plant: of the laws only StateDependentP",
        ),
        (
            lambda: ideal(rule=dt.SwitchingSignal.constant(0)),
            "step must be given for StateDependentPredictor where the plant follows a signal: its",
        ),
        (
            lambda: ideal(u0=np.sin),
            "u0 must be None, a number, (m,) or held samples (m, N), oldest first, where the ideal",
        ),
        (lambda: ideal(horizon=1e7), "horizon = 1e+07 s is too long for the ideal loop, more than"),
    ],
)
def test_an_ideal_loop_that_is_not_known_is_refused_by_name(make, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        make()


@pytest.mark.parametrize("step", [0.1, 0.01])
def test_a_digital_loop_that_slides_throughout_keeps_one_gain_and_not_the_ideal_s_mean(step):
    # The plant of the closed form above; neither gain leads on from x₁ = 0, which it meets at D.
    # Held, u_k = −x₂(t_k + D) of mode 0 acts in both modes: x₂(D + kh) = 3 (1 − h)^k.
    plant = dt.SwitchedSystem(
        [[[0, 0, 1], [0, 0, 0], [0, 0, 0]], [[0, -1, 0], [0, 0, 0], [0, 0, 0]]],
        [[[0], [1], [0]]] * 2, 0.5,
    )  # fmt: skip
    rule = HalfSpace([1.0, 0.0, 0.0])
    law = StateDependentPredictor(plant, [[[0, -1, 0]], [[0, -2, 0]]], rule, allow_unstable=True)
    samples = step * np.arange(round(2.0 / step) + 1)
    one = dt.simulate(plant, law, rule, [-0.45, 3.0, 1.0], 3.0, step, times=0.5 + samples)
    expected = 3.0 * (1.0 - step) ** np.arange(samples.size)
    np.testing.assert_allclose(one.states[1], expected, rtol=1e-12)
    assert one.message.endswith("once, for 2.55 s in all, first at t = 0.45 s.")
    assert (
        np.abs(dt.simulate(plant, law, rule, [-0.45, 3.0, 1.0], 3.0, step).mismatch).max() < 1e-12
    )


def test_a_file_of_an_ideal_loop_under_a_rule_is_simulated_and_judged(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spindle.toml").write_text(SPINDLE, encoding="utf-8")
    with pytest.raises(SystemExit) as stopped:
        main(["simulate", "spindle.toml"])
    out = " ".join(capsys.readouterr().out.split())
    assert stopped.value.code == 0
    assert "works on a signal with 6 switches" in out
    assert "held in any one mode it decays" in out


def test_a_file_of_an_ideal_loop_under_a_rule_has_by_default_the_law_that_runs_there(tmp_path):
    path = tmp_path / "spindle.toml"
    path.write_text(SPINDLE.partition("[[law]]")[0], encoding="utf-8")
    assert list(load_problem(path).laws) == ["state-dependent"]
    assert "averaged" in problem_with_run(path, {"step": 0.1}).laws


SPINDLE = """
[plant]
delay = 0.3
A = [ [[0.0, 1.0], [-2.0, 0.3]], [[0.0, 1.0], [-6.0, 0.1]] ]
B = [ [[0.0], [1.0]], [[0.0], [1.5]] ]
[gains]
K = [[[1.0, -1.5]], [[2.0, -1.2]]]
[signal]
kind = "quadratic"
S = [ [[1.0, 0.0], [0.0, -1.0]], [[-1.0, 0.0], [0.0, 1.0]] ]
[run]
x0 = [2.0, 1.0]
horizon = 10.0
step = "ideal"
[[law]]
kind = "state-dependent"
"""
