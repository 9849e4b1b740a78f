"""The delay margin of constant modes: closed forms, dense eigenvalues, scans, and relations."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import brentq

import deadtime as dt
import plants
from deadtime.spectrum import lifted_loop
from deadtime.spectrum.crossing import first_crossing, relevant
from deadtime.spectrum.digital_response import DigitalResponse
from deadtime.spectrum.margin import FARTHEST, constant_delay_margin

PAPER = plants.paper()
H = 0.1


def of(delay, plant=PAPER, mode=None):
    """The same plant with another true delay; with one of its modes only."""
    modes = slice(None) if mode is None else slice(mode, mode + 1)
    return dt.SwitchedSystem(plant.A[modes], plant.B[modes], delay)


ALONE = of(1.0, mode=0)
EXACT = dt.SingleModePredictor(ALONE, dt.place(ALONE, [-1.0, -2.0]), 0)
NEAR = PAPER.apart(0.5)
AVERAGED = dt.AveragedPredictor(NEAR, plants.gains(NEAR))


def growth(plant, law, delay, step):
    """The fastest growth of any constant mode, from all eigenvalues of the lifted loop."""
    rates = []
    for mode in range(plant.modes):
        table = law.digital(step, dt.SwitchingSignal.constant(mode), 1)
        L = lifted_loop(of(delay, plant), table, mode)
        rates.append(math.log(np.abs(np.linalg.eigvals(L)).max()) / step)
    return max(rates)


def drawn(seed):
    """A plant, a law and a period drawn at random, with a stable loop at the nominal delay."""
    rng = np.random.default_rng(seed)
    while True:
        n = int(rng.integers(1, 4))
        m, modes = int(rng.integers(1, min(n, 2) + 1)), int(rng.integers(1, 3))
        A, B = rng.normal(size=(modes, n, n)), rng.normal(size=(modes, n, m))
        plant = dt.SwitchedSystem(A, B, float(rng.choice([0.25, 0.5, 0.777])))
        try:
            K = dt.place(plant, -rng.uniform(0.2, 2.0, size=n))
        except dt.ArgumentError:
            continue
        kinds = dt.AveragedPredictor, dt.DelayedStateFeedback, dt.ExactPredictor
        law, step = kinds[seed % 3](plant, K), float(rng.choice([0.05, 0.1, 0.6]))
        if np.abs(K).max() < 100.0 and growth(plant, law, plant.delay, step) < 0.0:
            return plant, law, step


# -- known figures and closed forms ------------------------------------------------------------


def test_the_paper_s_mode_under_its_own_law_bears_1_35_percent_either_way():
    margin = constant_delay_margin(ALONE, EXACT, 0.01)
    assert 1.0 - margin.lower == pytest.approx(0.0135, abs=1e-4)
    assert margin.upper - 1.0 == pytest.approx(0.0135, abs=1e-4)
    assert margin.relative == margin.upper - 1.0
    assert not margin.certified
    assert margin.message == (
        "the loop stays stable in every constant mode while the true delay is between 0.9865 s "
        "and 1.0135 s (−1.36 %, +1.35 %)"
    )


@pytest.mark.parametrize(("count", "digits"), [(1, 1e-7), (4, 1e-11), (30, 1e-11)])
def test_a_sampled_integrator_is_lost_at_the_delay_of_its_closed_form(count, digits):
    # z^N (z − 1) = −k h on |z| = 1: z = e^{iπ/(2N + 1)}, k h = 2 sin(π/(4N + 2)). For N = 1 the
    # root moves along the circle for delays just above, which costs half of the digits.
    angle = math.pi / (2 * count + 1)
    k = 2.0 * math.sin(angle / 2.0) / H
    plant = plants.scalar(0.0, delay=0.3 * count * H)
    law = dt.DelayedStateFeedback(plant, [[[-k]]])
    margin = constant_delay_margin(plant, law, H)
    assert margin.upper == pytest.approx(count * H, rel=digits)
    assert margin.upper_frequency == pytest.approx(angle / H, rel=digits)
    assert (margin.lower, margin.lower_mode, margin.upper_mode) == (0.0, None, 0)


@pytest.mark.parametrize(("a", "k"), [(0.0, 1.0), (0.0, 40.0), (-1.0, 3.0), (0.7, 2.0)])
def test_a_scalar_loop_is_lost_at_the_delay_of_its_closed_form(a, k):
    # iω = a − k e^{−iωD}: ω² = k² − a², ω D = arg(a + iω).
    frequency = math.sqrt(k * k - a * a)
    limit = math.atan2(frequency, a) / frequency
    plant = plants.scalar(a, delay=0.4 * limit)
    law = dt.DelayedStateFeedback(plant, [[[-k]]])
    margin = constant_delay_margin(plant, law, None)
    assert margin.upper == pytest.approx(limit, rel=1e-12)
    assert margin.upper_frequency == pytest.approx(frequency, rel=1e-12)
    assert margin.lower == 0.0


def test_loops_of_gain_below_one_bear_any_delay():
    plant = plants.scalar([-2.0, -3.0], delay=0.3)
    law = dt.DelayedStateFeedback(plant, [[[-1.9]], [[-2.0]]])
    for step in (H, None):
        margin = constant_delay_margin(plant, law, step)
        assert (margin.lower, margin.upper, margin.upper_mode) == (0.0, math.inf, None)
        assert margin.relative == math.inf
        assert margin.message.endswith("in every constant mode whatever the true delay")


def test_where_no_longer_delay_loses_the_loop_the_search_ends_and_says_so():
    plant = plants.scalar(-1.0, delay=0.3)
    law = dt.DelayedStateFeedback(plant, [[[-1.2]]])  # lost at 3.85 s
    margin = constant_delay_margin(plant, law, H)
    assert (margin.upper, margin.upper_mode) == (pytest.approx(FARTHEST * 0.3), None)
    assert margin.relative == pytest.approx(FARTHEST - 1.0)
    assert margin.message.endswith("below 3.00 s (longer ones were not tried)")


# -- dense eigenvalues -------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(18))
def test_every_delay_inside_is_stable_and_the_next_one_outside_is_not(seed):
    plant, law, step = drawn(seed)
    margin = constant_delay_margin(plant, law, step)
    rng = np.random.default_rng(seed)
    inside = rng.uniform(margin.lower, min(margin.upper, FARTHEST * plant.delay), 40)
    assert max(growth(plant, law, delay, step) for delay in inside) < 0.0
    for edge, mode, outwards in (
        (margin.lower, margin.lower_mode, -1e-8),
        (margin.upper, margin.upper_mode, 1e-8),
    ):
        if mode is not None:
            assert growth(plant, law, edge * (1.0 - outwards), step) < 0.0
            assert growth(plant, law, edge * (1.0 + outwards), step) > 0.0


@pytest.mark.parametrize(
    ("plant", "law", "step"),
    [(NEAR, AVERAGED, 0.1), (ALONE, EXACT, 0.08), (ALONE, EXACT, 0.05)],
)
def test_a_fine_scan_of_all_eigenvalues_finds_the_same_limits(plant, law, step):
    margin = constant_delay_margin(plant, law, step)

    def rate(delay):
        return growth(plant, law, delay, step)

    for end, limit in ((1.05, margin.upper), (0.95, margin.lower)):
        delays = np.linspace(1.0, end, 200)
        first = next(k for k, delay in enumerate(delays) if rate(delay) > 0.0)
        assert limit == pytest.approx(brentq(rate, delays[first - 1], delays[first]), rel=1e-9)


def test_a_root_stands_on_the_circle_at_the_frequency_given():
    margin = constant_delay_margin(NEAR, AVERAGED, H)
    for delay, mode, frequency in (
        (margin.lower, margin.lower_mode, margin.lower_frequency),
        (margin.upper, margin.upper_mode, margin.upper_frequency),
    ):
        roots = np.linalg.eigvals(lifted_loop(of(delay, NEAR), AVERAGED.digital(H), mode))
        assert np.abs(roots - np.exp(1j * frequency * H)).min() < 1e-9


def test_stable_windows_of_an_oscillator_are_told_apart():
    # Stable, unstable and stable again as the delay grows: only the window around it counts.
    plant = dt.SwitchedSystem([[[0.0, 1.0], [-25.0, -0.3]]], [[[0.0], [1.0]]], 1.0)
    law = dt.DelayedStateFeedback(plant, [[[0.0, -0.6]]])
    delays = np.arange(1, 800) * 0.005
    stable = np.array([growth(plant, law, delay, H) < 0.0 for delay in delays])
    edges = np.flatnonzero(np.diff(stable)) + 1
    assert edges.size >= 4
    for first, stop in pairwise(edges):
        if stable[first]:
            middle = of((delays[first] + delays[stop - 1]) / 2.0, plant)
            margin = constant_delay_margin(middle, law, H)
            assert delays[first - 1] < margin.lower <= delays[first]
            assert delays[stop - 1] <= margin.upper < delays[stop]
            assert first_crossing(*_walk(middle, law), middle.delay, 0.0).delay == margin.lower


def _walk(plant, law):
    response = DigitalResponse.of(plant, law.digital(H), 0)
    return response, relevant(response, plant.delay)


def test_the_ideal_margin_is_the_limit_of_the_digital_ones():
    ideal = constant_delay_margin(ALONE, EXACT, None)
    for side in ("lower", "upper"):
        limit = getattr(ideal, side)
        steps = 0.004, 0.002, 0.001
        errors = [
            abs(getattr(constant_delay_margin(ALONE, EXACT, step), side) - limit) for step in steps
        ]
        assert 0.8 < np.log2(errors[1] / errors[2]) < 1.2
        for sign in (-1e-9, 1e-9):
            rate = dt.growth_rate(of(limit * (1.0 + sign), ALONE), EXACT, 0, step=None)
            assert (rate > 0.0) == ((sign > 0.0) == (side == "upper"))


# -- relations ---------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [0.05, 0.01, None])
def test_the_nominal_delay_plays_no_part_within_the_interval(step):
    here, there = (constant_delay_margin(of(d, NEAR), AVERAGED, step) for d in (1.0, 1.006))
    assert there.lower == pytest.approx(here.lower, rel=1e-10)
    assert there.upper == pytest.approx(here.upper, rel=1e-10)
    assert (there.lower_mode, there.upper_mode) == (here.lower_mode, here.upper_mode)


@pytest.mark.parametrize("name", ["exact", "delayed"])
def test_the_interval_of_all_modes_is_the_common_part_of_each_one_s(name):
    plant = plants.generic(0.15)
    law = plants.LAWS[name](plant)
    whole = constant_delay_margin(plant, law, 0.02)
    K = plants.gains(plant)
    each = [
        constant_delay_margin(of(0.15, plant, i), type(law)(of(0.15, plant, i), K[i : i + 1]), 0.02)
        for i in range(3)
    ]
    lower, upper = max(one.lower for one in each), min(one.upper for one in each)
    assert whole.lower == pytest.approx(lower, rel=1e-10)
    assert whole.upper == pytest.approx(upper, rel=1e-10)
    assert each[whole.upper_mode].upper == upper
    plants.close(whole.growth, np.concatenate([one.growth for one in each]), 1e-9)


@pytest.mark.parametrize("step", [H, None])
def test_other_units_of_state_and_time_scale_the_interval(step):
    plant, c = plants.generic(), 1.7
    T = np.array([[2.0, 0.3, 0.0], [0.0, 0.05, 1.0], [30.0, 0.0, 1.0]])
    changed, law = plants.in_other_units("exact", T, c)
    own = constant_delay_margin(plant, plants.LAWS["exact"](plant), step)
    other = constant_delay_margin(changed, law, step and c * step)
    assert other.lower == pytest.approx(c * own.lower, rel=1e-9)
    assert other.upper == pytest.approx(c * own.upper, rel=1e-9)
    assert other.upper_frequency * c == pytest.approx(own.upper_frequency, rel=1e-7)


def test_a_dwell_time_long_past_changes_nothing():
    aware = dt.AveragedPredictor(NEAR, AVERAGED.gains, dwell_time=0.3)
    one, other = (constant_delay_margin(NEAR, law, H) for law in (AVERAGED, aware))
    assert other.lower == pytest.approx(one.lower, rel=1e-10)
    assert other.upper == pytest.approx(one.upper, rel=1e-10)


# -- no margin, and refused --------------------------------------------------------------------


@pytest.mark.parametrize(("step", "rate"), [(0.01, 0.2817), (None, 0.2821)])
def test_a_loop_that_a_constant_mode_loses_has_no_margin(step, rate):
    margin = constant_delay_margin(PAPER, plants.LAWS["averaged"](PAPER), step)
    assert (margin.lower, margin.upper, margin.relative) == (None, None, None)
    assert (margin.lower_mode, margin.upper_mode) == (1, 1)
    assert margin.growth[1] == pytest.approx(rate, abs=1e-4)
    assert margin.message == (
        "there is no delay margin, since held in mode 1 the loop grows at +0.282 /s already"
    )


@pytest.mark.parametrize(
    ("law", "step", "message"),
    [
        (
            lambda p, K: dt.StateDependentPredictor(p, K, dt.HalfSpace([1.0, 1.0])),
            H,
            "StateDependentPredictor has no table",
        ),
        (
            lambda p, K: dt.ExactPredictor(p, K, dt.SwitchingSignal([0.0, 1.0], [0, 1])),
            H,
            "law must not foresee a signal of its own",
        ),
        (lambda p, K: dt.AveragedPredictor(p, K), 0.0, "step must be positive"),
        (
            lambda p, K: dt.ExpectedPredictor(p, K, dt.SemiMarkov([1.0, 1.0])),
            None,
            "no closed form in continuous time",
        ),
    ],
)
def test_what_has_no_margin_to_speak_of_is_refused_by_name(law, step, message):
    with pytest.raises(dt.ArgumentError, match=message):
        constant_delay_margin(PAPER, law(PAPER, plants.gains(PAPER)), step)
