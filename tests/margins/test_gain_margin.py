"""The gain margin: factors of the inputs' effect that keep every constant mode stable."""

import re

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

import deadtime as dt
import encirclements
import plants
from shares import mostly_long

# Three modes so near that a law keeps each; N = 3, φ = 0.051 in truth, φ = 0.034 for the law.
NEAR = plants.generic().apart(0.02)
MODEL = dt.SwitchedSystem(NEAR.A + 2.5 * np.eye(3), NEAR.B, NEAR.delay)
PLANT = dt.SwitchedSystem(1.01 * MODEL.A, 0.98 * MODEL.B, 0.251)
STEP = 0.1
TABLES = [name for name in plants.LAWS if name != "delayed"]


def lifted(plant, table, row, mode):
    """The loop lifted by SciPy's exponentials and the definition alone: M₀ + factor · M₁."""
    h, D = table.step, plant.delay
    N = int(np.ceil(D / h - 1e-9))
    phase = D - (N - 1) * h
    A, B = plant.A[mode], plant.B[mode]
    n, m = B.shape
    Phi, late = plants.held(A, B, h)[0], plants.held(A, B, h - phase)[1]
    early = expm(A * (h - phase)) @ plants.held(A, B, phase)[1]
    taps = max(table.taps, N)
    M, by_factor = np.zeros((2, n + taps * m, n + taps * m))
    F, G = table.state_gain[row], table.input_gain[row]
    M[n : n + m, :n] = F
    for j in range(table.taps):
        M[n : n + m, n + j * m : n + (j + 1) * m] = G[j]
    M[n + m :, n:-m] = np.eye((taps - 1) * m)
    M[:n, :n] = Phi
    by_factor[:n, n + (N - 1) * m : n + N * m] += early
    if N > 1:
        by_factor[:n, n + (N - 2) * m : n + (N - 1) * m] += late
    else:
        by_factor[:n] += late @ M[n : n + m]
    return M, by_factor


@pytest.mark.few(2)
@pytest.mark.parametrize("law", TABLES)
def test_the_gain_margin_ends_where_a_lifted_loop_reaches_the_unit_circle(law):
    made = plants.LAWS[law](MODEL)
    margin = dt.gain_margin(PLANT, made, STEP)
    assert 0.0 < margin.lower < 1.0 < margin.upper
    table = made.digital(STEP, dt.SwitchingSignal.constant(0), 1)
    ends = []
    for mode in range(3):
        signal = dt.SwitchingSignal.constant(mode)
        table = made.digital(STEP, signal, 1)
        row = int(table.rows(np.full(1, mode), table.ages)[0])

        parts = lifted(PLANT, table, row, mode)

        def log_radius(factor, parts=parts):
            M = parts[0] + np.multiply.outer(factor, parts[1])
            return np.log(np.abs(np.linalg.eigvals(M)).max(axis=-1))

        fine = np.linspace(1.0, 1.5 * margin.upper, 400)
        first = fine[np.argmax(log_radius(fine) > 0.0)]
        upper = brentq(log_radius, 1.0, first) if first > 1.0 else np.inf
        fine = np.linspace(1.0, 0.5 * margin.lower, 400)
        first = fine[np.argmax(log_radius(fine) > 0.0)]
        lower = brentq(log_radius, first, 1.0) if first < 1.0 else 0.0
        ends.append((lower, upper))
    lower, upper = np.array(ends).T
    assert margin.lower == pytest.approx(lower.max(), rel=1e-8)
    assert margin.upper == pytest.approx(upper.min(), rel=1e-8)
    assert (margin.lower_mode, margin.upper_mode) == (lower.argmax(), upper.argmin())
    low, high = map(float, re.search("between (.*) and (.*) times", margin.message).groups())
    assert margin.lower <= low <= margin.lower + 0.01 * (1.0 - margin.lower)
    assert margin.upper >= high >= margin.upper - 0.01 * (margin.upper - 1.0)


def test_a_scalar_loop_has_the_margin_of_its_characteristic_equation():
    # x' = −x + 0.2 u, u = −x held, no prediction: x_{k+1} = (e^{−h} − 0.2 k (1 − e^{−h})) x_k.
    plant = plants.scalar(-1.0, 0.2, delay=1e-9)
    law = dt.DelayedStateFeedback(plant, [[[-1.0]]])
    h = 0.5
    margin = dt.gain_margin(plant, law, h)
    # The input comes a whole period late: z² − e^{−h} z + 0.2 k (1 − e^{−h}) = 0 loses at z² = …
    coefficient = 0.2 * (1.0 - np.exp(-h))
    assert margin.lower == 0.0
    assert margin.lower_mode is None
    assert margin.upper == pytest.approx((1.0 + np.exp(-h)) / coefficient, rel=1e-6)


@pytest.mark.parametrize(("pole", "step"), mostly_long([(0.02, 0.01), (0.2, 0.001)], (0.02, 0.01)))
def test_a_slow_unstable_mode_is_lost_at_frequency_zero(pole, step):
    # At rest u = −K̂ x and 0 = p x + k u: the least factor makes the static gain 1.
    plant = plants.scalar(pole, delay=1.0)
    law = dt.SingleModePredictor(plant, dt.lqr(plant, [[1.0]], [[1.0]]), 0)
    table = law.digital(step)
    F, G = table.state_gain[0, 0, 0], table.input_gain[0, :, 0, 0].sum()
    margin = dt.gain_margin(plant, law, step)
    assert margin.lower == pytest.approx(-pole * (1.0 - G) / F, rel=1e-8)


def test_a_plant_that_integrates_bears_any_smaller_effect(recwarn):
    plant = plants.scalar(0.0, delay=1.0)
    law = dt.SingleModePredictor(plant, dt.place(plant, [-0.5]), 0)
    margin = dt.gain_margin(plant, law, 0.01)
    assert margin.lower == 0.0
    assert 4.0 < margin.upper < 6.0
    assert not recwarn


def test_the_papers_first_mode_bears_three_and_a_half_percent():
    paper = dt.problems.paper().plant
    plant = dt.SwitchedSystem(paper.A[:1], paper.B[:1], paper.delay)
    law = dt.SingleModePredictor(plant, dt.place(plant, [-1.0, -2.0]), 0)
    margin = dt.gain_margin(plant, law)
    assert margin.lower == pytest.approx(0.9654, abs=1e-4)
    assert margin.upper == pytest.approx(1.036, abs=1e-3)
    for end, outwards in ((margin.lower, -1.0), (margin.upper, 1.0)):
        rates = [
            dt.growth_rate(
                dt.SwitchedSystem(plant.A, end * (1.0 + d) * plant.B, plant.delay), law, 0
            )
            for d in (-1e-6, 1e-6)
        ]
        assert outwards * rates[0] < 0.0 < outwards * rates[1]


def test_a_mode_that_grows_leaves_no_margin():
    problem = dt.problems.paper()
    margin = dt.gain_margin(problem.plant, problem.laws["averaged"])
    assert margin.lower is margin.upper is None
    assert margin.upper_mode == 1
    assert margin.stabilising is None
    assert re.fullmatch(
        r"there is no gain margin: held in mode 1 the loop grows at \+0\.282 /s already; no effect "
        r"of the inputs 0\.\d+ to 1\.\d+ times as much would make it stable",
        margin.message,
    )


def of_one_pole(factor):
    plant = plants.scalar(1.0, delay=0.2)
    law = dt.SingleModePredictor(plant, dt.place(plant, [-1.0]), 0)
    return plant, law, factor


def of_three_modes(factor):
    return PLANT, plants.LAWS["averaged"](MODEL), factor


def of_the_paper(factor):
    plant = dt.problems.paper().plant.apart(0.2)
    return plant, dt.AveragedPredictor(plant, dt.place(plant, (-1.0, -2.0))), factor


AT_FIRST = [(of_one_pole, 6.0, STEP), (of_one_pole, 0.2, None), (of_three_modes, 0.2, STEP)]
AT_FIRST += [(of_one_pole, 1e-3, STEP), (of_the_paper, 1.4, STEP)]
LATER = [(of_one_pole, 1e-3, None), (of_three_modes, 0.2, None), (of_the_paper, 0.8, None)]


@pytest.mark.parametrize(("made", "factor", "step"), mostly_long(AT_FIRST + LATER, *AT_FIRST))
def test_an_unstable_loop_is_stable_for_the_factors_that_the_loop_as_designed_tolerates(
    made, factor, step
):
    plant, law, factor = made(factor)
    designed = dt.gain_margin(plant, law, step)
    assert designed.stabilising is None
    margin = dt.gain_margin(plant.like(plant.A, factor * plant.B), law, step)
    assert margin.lower is margin.upper is None
    low, high = (factor * end for end in margin.stabilising)
    assert (low, high) == pytest.approx((designed.lower, designed.upper), rel=1e-7)
    said = re.search(r"acted between (\S+) and (\S+) times as much", margin.message).groups()
    low, high = map(float, said)
    assert margin.stabilising[0] <= low < high <= margin.stabilising[1]


def test_a_stable_plant_that_its_law_makes_unstable_is_stable_with_less_of_its_inputs():
    plant = plants.scalar(-1.0, delay=1.0)
    law = dt.DelayedStateFeedback(plant, [[[-5.0]]], allow_unstable=True)
    margin = dt.gain_margin(plant, law, step=None)
    # s + 1 + 5 k e^{−s} = 0 has a root iω first where ω = −tan ω and 5 k = √(1 + ω²).
    omega = brentq(lambda w: np.sin(w) + w * np.cos(w), 0.6 * np.pi, 0.99 * np.pi)
    assert margin.stabilising == pytest.approx((0.0, np.hypot(1.0, omega) / 5.0), rel=1e-7)
    assert margin.message.endswith("stable if the inputs acted less than 0.452 times as much")


def test_a_plant_that_is_stable_by_itself_bears_no_effect_at_all():
    plant = plants.scalar([-1.0, -2.0], 1e-9, delay=0.25)
    law = dt.DelayedStateFeedback(plant, [[[-1e-9]], [[-1e-9]]])
    margin = dt.gain_margin(plant, law, 0.1)
    assert (margin.lower, margin.upper) == (0.0, np.inf)
    assert margin.message == (
        "gain margin infinite: stable in every constant mode at every plant gain from 1e-06 to "
        "1,000,000 times the model's, all that was tried"
    )


def test_messages_about_a_plant_of_one_mode_name_no_mode():
    plant = plants.scalar([0.5], 1.0, delay=0.25)
    law = dt.DelayedStateFeedback(plant, [[[0.0]]], allow_unstable=True)
    for message in (
        dt.gain_margin(plant, law, 0.1).message,
        dt.delay_margin(plant, law, 0.1).message,
    ):
        assert "the loop grows at +0.5 /s already" in message
        assert "mode" not in message


def test_laws_that_are_no_table_are_refused_by_name():
    rule = dt.HalfSpace([1.0, 0.0, 0.0])
    law = dt.StateDependentPredictor(MODEL, plants.gains(MODEL), rule)
    with pytest.raises(dt.ArgumentError, match="StateDependentPredictor"):
        dt.gain_margin(MODEL, law, STEP)
    with pytest.raises(dt.ArgumentError, match="step must be positive"):
        dt.gain_margin(PLANT, plants.LAWS["averaged"](MODEL), 0.0)


@pytest.mark.few(3)
@pytest.mark.parametrize("unit", [1e-300, 1e-200, 1e100, 1e200, 1e250])
@pytest.mark.parametrize("observed", [False, True])
def test_the_units_of_an_input_change_no_margin(unit, observed, recwarn):
    A, B, poles = MODEL.A[:1], MODEL.B[:1], [-1.0, -1.5, -2.0]
    gains = dt.place(dt.SwitchedSystem(A, B, 0.25), poles)
    each = np.array([unit, 1.0])[: B.shape[2]]  # of every input

    def answers(each):
        plant = dt.SwitchedSystem(A, B * each, 0.25)
        law = dt.SingleModePredictor(plant, gains / each[:, None], 0)
        if observed:
            law = dt.OutputFeedback(law, dt.luenberger(plant, np.eye(3), [-4.0, -5.0, -6.0], 0.01))
        margin = dt.gain_margin(plant, law, 0.01)
        return margin.lower, margin.upper, dt.growth_rate(plant, law, 0, 0.01)

    expected = answers(np.ones(each.size))
    assert answers(each) == pytest.approx(expected, rel=1e-8)
    assert answers(np.full(each.size, unit)) == pytest.approx(expected, rel=1e-8)
    assert not recwarn


# -- the ideal loop ------------------------------------------------------------------------------


def test_an_ideal_integrator_has_the_margin_of_its_phase():
    # x' = −k c x(t − D): lost at k c D = π/2, and slowly stable with any less.
    plant = plants.scalar(0.0, delay=0.3)
    margin = dt.gain_margin(plant, dt.DelayedStateFeedback(plant, [[[-2.0]]]), None)
    assert margin.lower == 0.0
    assert margin.upper == pytest.approx(0.5 * np.pi / 0.6, rel=1e-9)


@pytest.mark.few(1)
@pytest.mark.parametrize("delay", [1e-12, 1e-6, 0.2, 1.0])
def test_an_ideal_unstable_mode_is_lost_at_both_ends_where_its_equation_says(delay):
    # x' = x − 3 k x(t − D): at rest 3 k = 1; at s = iω (3 k)² = 1 + ω², ω D = π − atan(ω) … .
    plant = plants.scalar(1.0, delay=0.3 * delay)
    law = dt.DelayedStateFeedback(plant, [[[-3.0]]])
    margin = dt.gain_margin(plant, law, None)
    assert margin.lower == pytest.approx(1.0 / 3.0, rel=1e-9)
    crossing = brentq(lambda w: 0.3 * delay * w - np.arctan(w), 1e-3, np.pi / (0.3 * delay))
    known = np.hypot(1.0, crossing) / 3.0
    assert margin.upper == (pytest.approx(known, rel=1e-9) if known < 1e6 else np.inf)


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", mostly_long(range(8), 0, 1, 2))
def test_ideal_loops_are_lost_to_a_gain_where_roots_begin_to_be_encircled(seed):
    plant, law = encirclements.random_loop(seed + 200)
    margin = dt.gain_margin(plant, law, None)

    def roots(factor):
        stronger = dt.SwitchedSystem(plant.A, factor * plant.B, plant.delay)
        return encirclements.unstable_roots(stronger, law, plant.delay)

    assert roots(1.0) == 0
    for factors, found in (
        (np.linspace(1.0, 4.0, 121), min(margin.upper, 4.0)),
        (np.linspace(1.0, 0.0, 121)[:-1], max(margin.lower, 1.0 / 120.0)),
    ):
        lost = np.flatnonzero([roots(factor) > 0 for factor in factors])
        first = lost[0] if lost.size else factors.size - 1
        assert min(factors[first - 1 : first + 1]) <= found <= max(factors[first - 1 : first + 1])
    for end, outwards in ((margin.lower, 0.999), (margin.upper, 1.001)):
        if 0.0 < end < 4.0:
            assert roots(end / outwards) == 0 < roots(end * outwards)


def test_the_ideal_margin_of_a_predictor_is_the_limit_of_sampled_ones():
    plant = plants.paper()
    one = dt.SwitchedSystem(plant.A[:1], plant.B[:1], 1.0)
    law = dt.SingleModePredictor(one, dt.place(one, [-1.0, -2.0]), 0)
    ideal = dt.gain_margin(one, law, None)
    fine = dt.gain_margin(one, law, 0.005)
    assert ideal.lower == pytest.approx(fine.lower, abs=0.05 * (1.0 - ideal.lower))
    assert ideal.upper == pytest.approx(fine.upper, abs=0.05 * (ideal.upper - 1.0))
