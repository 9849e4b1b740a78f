"""Design for margin: prices by two other methods, gains by their definition, answers put back."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

import deadtime as dt
import plants
from deadtime.spectrum import lifted_loop
from deadtime.synthesis import DelayLimit, TradeOff
from deadtime.synthesis.design_measures import cost_and_growth, estimated_margin
from deadtime.synthesis.design_result import Floors, percent, sentences
from deadtime.synthesis.design_search import DesignSearch, pairs_of
from deadtime.synthesis.gain_families import Poles, Weights


def loop_cost(plant, feedback, mode, weight=None):
    return cost_and_growth(plant, feedback, mode, weight=weight)[0]


# Three modes, two inputs, unstable poles in each; N = 5 and φ = 0.034 s.
PLANT = dt.SwitchedSystem(
    plants.generic().apart(0.1).A + 2.5 * np.eye(3), plants.generic().apart(0.1).B, 0.234
)
LAW = dt.AveragedPredictor(PLANT, dt.lqr(PLANT, np.eye(3), np.eye(2)))
FILTERED = dt.LowPassPredictor(LAW, 0.01)
OTHER = dt.SwitchedSystem(1.01 * PLANT.A, PLANT.B, 0.226)


def alone(mode):
    paper = dt.problems.paper().plant
    return dt.SwitchedSystem(paper.A[[mode]], paper.B[[mode]], 1.0)


# -- what a loop costs ---------------------------------------------------------------------------


@pytest.mark.parametrize("law", [LAW, FILTERED], ids=["averaged", "low-pass"])
@pytest.mark.parametrize(("plant", "step"), [(PLANT, 0.05), (OTHER, 0.05), (PLANT, 0.3)])
def test_the_cost_is_that_of_long_runs_from_every_corner(law, plant, step):
    if step == 0.3:  # one tap, φ < h: a calmer plant
        plant = plants.generic().apart(0.1)
        law = dt.AveragedPredictor(plant, plants.gains(plant))
        law = dt.LowPassPredictor(law, 0.05)
    table = law.digital(step)
    for mode in range(3):
        signal = dt.SwitchingSignal.constant(mode)
        runs = [dt.simulate(plant, law, signal, x0, 60.0, step).metrics() for x0 in np.eye(3)]
        expected = np.mean([run["cost"] for run in runs])
        assert loop_cost(plant, table, mode) == pytest.approx(expected, rel=1e-9)


def test_the_cost_solves_the_lyapunov_equation_of_the_lifted_loop():
    # N = 5: S from the cost of one period, x by quadrature of its own.
    step, mode, nodes = 0.05, 1, 12
    L = lifted_loop(PLANT, FILTERED.digital(step), mode)
    A, B, m, n = PLANT.A[mode], PLANT.B[mode], 2, 3
    points, weights = np.polynomial.legendre.leggauss(nodes)
    S = step * L[n : n + m].T @ L[n : n + m]
    one, phase = np.eye(L.shape[0]), 0.034
    old, new = one[n + 4 * m : n + 5 * m], one[n + 3 * m : n + 4 * m]
    for a, b in ((0.0, phase), (phase, step)):
        for point, weight in zip(points, weights, strict=True):
            t = 0.5 * (a + b) + 0.5 * (b - a) * point
            Phi, Gamma = plants.held(A, B, min(t, phase))
            x = Phi @ one[:n] + Gamma @ old
            Phi, Gamma = plants.held(A, B, max(t - phase, 0.0))
            x = Phi @ x + Gamma @ new
            S += 0.5 * (b - a) * weight * x.T @ x
    X = solve_discrete_lyapunov(L.T, S)
    expected = np.trace(X[:n, :n]) / n
    assert loop_cost(PLANT, FILTERED.digital(step), mode) == pytest.approx(expected, rel=1e-9)


def test_lqr_of_identity_weights_is_the_cheapest_while_the_delay_is_right():
    plant = alone(0)
    best = loop_cost(plant, law_of(plant, dt.lqr(plant, np.eye(2), [[1.0]])).digital(0.01), 0)
    for poles in ((-1.0, -2.0), (-2.0, -2.5), (-0.8, -1.7)):
        other = loop_cost(plant, law_of(plant, dt.place(plant, poles)).digital(0.01), 0)
        assert other > best


def law_of(plant, gains):
    return dt.SingleModePredictor(plant, gains, 0)


def test_a_loop_that_grows_has_no_cost_and_says_how_fast_it_grows():
    problem = dt.problems.paper()
    table = problem.laws["averaged"].digital(0.01)
    for mode, rate in enumerate((0.128182, 0.28213)):
        cost, growth = cost_and_growth(problem.plant, table, mode)
        assert cost == math.inf
        assert growth == pytest.approx(rate, rel=0.1)


# -- what a search varies ------------------------------------------------------------------------


@pytest.mark.parametrize("filtered", [False, True])
@pytest.mark.parametrize("name", ["paper", "follower"])
def test_poles_are_placed_with_the_filter_in_the_loop(name, filtered):
    plant = dt.problems.NAMED[name]().plant
    plant = dt.SwitchedSystem(plant.A[:1], plant.B[:1], plant.delay)
    family = Poles(plant, filtered)
    parameters = np.array([[0.2, -0.3, -0.4, 0.3][: family.size]])
    choice = family.choice(parameters)
    A, B, K = plant.A[0], plant.B[0], choice.gains[0]
    closed = A + B @ K
    if filtered:
        rate = np.linalg.inv(choice.time_constant)
        closed = np.block([[A, B], [rate @ K, -rate]])
    found = np.poly(np.linalg.eigvals(closed))
    values = np.exp(parameters[0])
    expected = np.ones(1)
    for omega, zeta in values[: family.size - family.size % 2].reshape(-1, 2):
        omega *= family.unit
        expected = np.convolve(expected, [1.0, 2.0 * zeta * omega, omega**2])
    if family.size % 2:
        expected = np.convolve(expected, [1.0, values[-1] * family.unit])
    assert found == pytest.approx(expected, rel=1e-7)


def test_a_search_starts_from_the_gains_that_are_given():
    for problem in (dt.problems.paper(), dt.problems.follower()):
        family = Poles(problem.plant, False)
        (start,) = family.starts(problem.gains)
        assert family.choice(start).gains == pytest.approx(problem.gains, rel=1e-6)
    complex_poles = dt.place(PLANT.mean(), [-1.0 + 1.0j, -1.0 - 1.0j, -2.0])
    one_input = dt.SwitchedSystem(PLANT.mean().A, PLANT.mean().B[:, :, :1], 0.2)
    gains = dt.place(one_input, [-1.0 + 1.0j, -1.0 - 1.0j, -2.0])
    (start,) = Poles(one_input, False).starts(gains)
    assert Poles(one_input, False).choice(start).gains == pytest.approx(gains, rel=1e-6)
    assert complex_poles.shape == (1, 2, 3)
    unstable = Poles(one_input, False).starts(np.zeros((1, 1, 3)))[0]
    closed = one_input.A + one_input.B @ Poles(one_input, False).choice(unstable).gains
    assert np.linalg.eigvals(closed).real.max() < 0.0


def test_weights_are_those_of_lqr_with_the_input_as_a_state():
    (start,) = Weights(PLANT, False).starts(LAW.gains)
    lqr = Weights(PLANT, False).choice(start)
    assert lqr.gains == pytest.approx(dt.lqr(PLANT, np.eye(3), np.eye(2)), rel=1e-8)
    same = dt.SwitchedSystem(PLANT.A[[1, 1]], PLANT.B[[1, 1]], PLANT.delay)
    parameters = np.tile([0.3, -0.5, 0.1, 0.4, -3.0], (2, 1))
    choice = Weights(same, True).choice(parameters)
    A, B, w = PLANT.A[1], PLANT.B[1], np.exp(parameters[0])
    big = dt.SwitchedSystem(
        [np.block([[A, B], [np.zeros((2, 5))]])], [np.vstack((np.zeros((3, 2)), np.eye(2)))], 1.0
    )
    Q = np.diag([w[0], w[1], w[2], 1.0, w[3]])
    L = dt.lqr(big, Q, w[4] * PLANT.delay**2 * np.diag([1.0, w[3]]))[0]
    rate = np.linalg.inv(choice.time_constant)
    assert -rate == pytest.approx(L[:, 3:], rel=1e-7)
    assert rate @ choice.gains[0] == pytest.approx(L[:, :3], rel=1e-7)


@pytest.mark.parametrize("law", [LAW, FILTERED], ids=["averaged", "low-pass"])
def test_the_estimate_is_the_margin_that_the_search_for_crossings_finds(law):
    for step in (0.01, 0.02):
        exact = dt.delay_margin(PLANT, law, step).relative
        table = law.digital(step)
        estimates = [estimated_margin(PLANT, table, mode) for mode in range(3)]
        assert min(estimates) == pytest.approx(exact, rel=1e-4)
    assert estimated_margin(dt.SwitchedSystem([[[-1.0]]], [[[1.0]]], 0.2),
                            dt.DelayedStateFeedback(plants.scalar(-1.0), [[[-0.1]]]).digital(0.01),
                            0) == math.inf  # fmt: skip


# -- designs -------------------------------------------------------------------------------------


def confirmed(plant, found):
    """The spectrum, and runs, at both ends of the margin asked for."""
    for sign, growth in zip((-1.0, 1.0), found.growth, strict=True):
        true = dt.SwitchedSystem(plant.A, plant.B, plant.delay * (1.0 + sign * found.asked))
        rates = [dt.growth_rate(true, found.law, mode, found.step) for mode in range(plant.modes)]
        assert rates == pytest.approx(growth.tolist())
        assert max(rates) < 0.0


@pytest.mark.long
def test_the_paper_s_mode_is_designed_for_twice_its_margin_at_a_price():
    plant = alone(0)
    found = dt.design(plant, delay_margin=0.018, gains=dt.place(plant, [-1.0, -2.0]), budget=200)
    assert found.reached
    confirmed(plant, found)
    assert found.plain.margin == pytest.approx(0.0135, abs=1e-4)
    assert found.margin.relative >= 0.018
    assert 1.0 < found.cost / found.plain.cost < 1.6
    margins = [point.margin for point in found.points]
    costs = [point.cost for point in found.points]
    assert (np.diff(margins) > 0.0).all()
    assert (np.diff(costs) > 0.0).all()
    chosen = [point for point in found.points if point.law is found.law]
    assert chosen[0].cost == pytest.approx(found.cost, rel=1e-3)
    assert found.message.startswith("Every constant mode stays stable while the true delay errs")


@pytest.mark.parametrize(
    ("mode", "asked"),
    [pytest.param(0, 0.03, marks=pytest.mark.long), pytest.param(1, 0.02, marks=pytest.mark.long)],
)
def test_what_no_gains_reach_is_the_largest_found_beside_the_limit(mode, asked):
    plant = alone(mode)
    found = dt.design(plant, delay_margin=asked, budget=120)
    assert not found.reached
    (limit,) = found.limits
    assert 0.85 * limit.reached < found.margin.relative < asked < limit.most
    assert f"Not reached: of {found.evaluated} designs" in found.message
    assert "Some linear controller of the mode alone reaches" in found.message
    assert found.margin.relative == dt.delay_margin(plant, found.law, 0.01).relative
    asks_too_much = dt.design(plant, delay_margin=0.08, budget=20)
    assert asks_too_much.message.endswith("the margin asked for does not exist.")


@pytest.mark.long
def test_the_averaged_law_for_both_modes_falls_short_of_half_a_percent():
    found = dt.design(dt.problems.paper().plant, delay_margin=0.005, budget=120)
    assert not found.reached
    assert 0.0 < found.margin.relative < 0.005
    assert found.plain.cost == math.inf
    assert "the plain design is unstable in a constant mode" in found.message
    assert "of mode 1 alone reaches" in found.message


def test_the_follower_has_margin_to_spare():
    problem = dt.problems.follower()
    found = dt.design(problem.plant, delay_margin=0.05, gains=problem.gains, budget=60)
    assert found.reached
    confirmed(problem.plant, found)
    assert found.plain.margin > 1.0
    assert found.cost <= found.plain.cost
    assert found.message.endswith("Nothing in the plant limits the margin below 100 %.")


@pytest.mark.long
@pytest.mark.parametrize("filtered", [False, True])
def test_three_modes_with_two_inputs_are_designed_by_weights(filtered):
    plain = dt.delay_margin(PLANT, LAW, 0.02).relative
    asked = 1.15 * plain
    found = dt.design(PLANT, delay_margin=asked, step=0.02, filtered=filtered, budget=80)
    assert found.reached
    confirmed(PLANT, found)
    assert (found.time_constant is not None) is filtered
    assert found.gains.shape == (3, 2, 3)
    assert all(point.time_constant is None for point in found.points) is not filtered
    assert found.plain.margin == pytest.approx(plain)
    assert asked < min(limit.most for limit in found.limits)


def test_modes_too_far_apart_for_one_law_are_a_result_with_a_reason():
    found = dt.design(plants.generic(), delay_margin=0.1, step=0.1, budget=30)
    assert not found.reached
    assert found.points == ()
    assert found.margin.lower is None
    assert f"none of {found.evaluated} designs that were tried is stable" in found.message
    assert repr(found).startswith("Design(Not reached")


def test_the_answer_depends_on_nothing_but_its_arguments():
    plant = plants.scalar(1.0, 1.0, 1.0)
    first, again = (dt.design(plant, delay_margin=0.2, step=0.05, budget=60) for _ in range(2))
    assert np.array_equal(first.gains, again.gains)
    assert first.message == again.message
    assert first.evaluated <= 1.3 * 60


def test_longer_steps_are_tried_where_they_are_allowed():
    plant = plants.scalar(1.0, 1.0, 1.0)
    search = DesignSearch(plant, dt.AveragedPredictor, 100, Floors(0.1))
    pairs = pairs_of(search, True, 0.05, 0.5)
    assert [step for _, step in pairs] == pytest.approx([0.05, 0.1, 0.25, 0.5])
    assert [(one.filtered, step) for one, step in pairs_of(search, None, 0.05, None)] == [
        (False, 0.05),
        (True, 0.05),
    ]
    found = dt.design(plant, delay_margin=0.1, step=0.05, longest_step=0.5, budget=100)
    assert found.reached
    confirmed(plant, found)


def test_the_law_family_is_the_caller_s():
    plant = dt.problems.follower().plant

    def mean(plant, gains):
        return dt.MeanPredictor(plant, gains.mean(axis=0), gains)

    found = dt.design(plant, delay_margin=0.3, law=mean, filtered=False, budget=40)
    assert isinstance(found.law, dt.MeanPredictor)
    assert found.reached


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"delay_margin": 0.0}, "delay_margin must be above 0 and below 1.* got 0: 0.05 asks"),
        ({"delay_margin": 1.0}, "delay_margin must be above 0 and below 1"),
        ({"delay_margin": -0.1}, "delay_margin must be above 0"),
        ({"step": 0.0}, "step must be positive"),
        ({"step": 0.1, "longest_step": 0.05}, r"longest_step must be at least the step, 0\.1 s"),
        ({"budget": 3}, "budget must be an integer of at least 20"),
        ({"filtered": np.array([True, False])}, "filtered must be True, False or None for both"),
        ({"law": lambda plant: None}, r"takes these two by position, got one that takes \(plant\)"),
        ({"law": 3}, r"law must be a function \(plant, gains\) -> law, got 3"),
        ({"gains": np.zeros((2, 1, 1))}, r"gains must hold one \(m, n\) matrix per mode, 1"),
        (
            {"law": lambda plant, gains: dt.ExactPredictor(plant, gains)},
            "ExactPredictor needs a preview",
        ),
        (
            {"law": lambda plant, K: dt.StateDependentPredictor(plant, K, lambda x: 0)},
            "law must make laws that are tables, got StateDependentPredictor",
        ),
    ],
)
def test_a_request_that_makes_no_sense_is_refused_by_name(change, message):
    with pytest.raises(dt.ArgumentError, match=message):
        dt.design(plants.scalar(1.0, 1.0, 1.0), **({"delay_margin": 0.1} | change))


def test_a_mode_that_cannot_be_controlled_is_refused():
    plant = dt.SwitchedSystem([np.diag([1.0, 2.0])], [[[1.0], [0.0]]], 0.1)
    with pytest.raises(dt.ArgumentError, match="mode 0 is not controllable"):
        dt.design(plant, delay_margin=0.1)


def room(asked, *limits):
    """The last sentence of a design's message."""
    limits = [DelayLimit(*limit, np.empty(0, complex)) for limit in limits]
    plain = TradeOff(LAW, 0.1, 0.0, math.inf)
    return sentences(Floors(asked), False, None, plain, limits, 1).split("constant mode. ")[1]


def test_the_modes_with_the_least_room_are_named():
    oscillator, unstable = (0.052, math.inf), (0.347, 0.9)
    both = "Some linear controller of mode 0 alone reaches 5.20 %, none of mode 1 alone more than "
    assert room(0.1, oscillator, unstable) == both + "90.0 %."
    assert room(0.95, oscillator, unstable).endswith("90.0 %: the margin asked for does not exist.")
    one = "Some linear controller of mode 1 alone reaches 2.00 %, none more than 5.00 %."
    assert room(0.01, (0.1, 0.2), (0.02, 0.05)) == one
    assert room(0.01, (0.05, 0.5), (0.02, 0.5)).endswith("mode 1 alone reaches 2.00 %, none more "
                                                        "than 50.0 %.")  # fmt: skip
    assert room(0.1, (math.inf, math.inf), oscillator).endswith("of mode 1 alone reaches 5.20 %.")


def test_limits_too_small_to_matter_are_numbers_all_the_same():
    limit = dt.delay_limit(plants.scalar(1.0, 1.0, 33.0))
    assert room(0.1, (limit.reached, limit.most)) == (
        "Some linear controller of the mode alone reaches 1.41e-14 %, none more than 2.83e-14 %: "
        "the margin asked for does not exist."
    )
    text = room(0.1, (0.0, 1e-303))
    assert text.startswith("Small gain promises no linear controller of the mode alone any margin")
    assert "more than none" not in text


def test_margins_in_sentences_are_rounded_down():
    assert percent(0.0199999) == "1.99 %"
    assert percent(0.0) == "none"
    assert percent(0.02) == "2.00 %"
    plain = dt.design(plants.scalar(1.0, 1.0, 1.0), delay_margin=0.1, step=0.1, budget=20).plain
    assert replace(plain, margin=0.5).margin == 0.5
