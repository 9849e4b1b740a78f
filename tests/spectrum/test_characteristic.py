"""Characteristic roots of the ideal loop: closed forms, a second Δ, counts, runs, and limits."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import block_diag, expm
from scipy.special import lambertw

import deadtime as dt
import plants
from deadtime.spectrum.characteristic import count_right_of, rightmost
from deadtime.spectrum.ideal import IdealLoop
from shares import mostly_long

PAPER = plants.paper()
IDEAL = [name for name in plants.IDEAL if name != "mean with gains"]
# The truth and the law's model: the same, a longer and a shorter true delay, other matrices.
LOOPS = {
    "paper": (PAPER, PAPER),
    "same": (plants.generic(), plants.generic()),
    "later": (plants.generic(0.3), plants.generic(0.234)),
    "sooner": (plants.generic(0.234), plants.generic(0.3)),
    "other": (plants.generic(0.3, seed=5), plants.generic(0.234)),
}


def scalar_delayed(k, delay, a=0.0):
    """x' = a x − k x(t − D)."""
    plant = plants.scalar(a, delay=delay)
    return plant, dt.DelayedStateFeedback(plant, [[[-k]]], allow_unstable=True)


# -- closed forms ------------------------------------------------------------------------------


@pytest.mark.few(1)
@pytest.mark.parametrize("plant", [PAPER, plants.generic(), plants.generic(0.7)])
def test_the_exact_law_of_a_plant_leaves_the_n_placed_poles_and_no_other_root(plant):
    K = plants.gains(plant)
    for mode in range(plant.modes):
        placed = np.sort(np.linalg.eigvals(plant.A[mode] + plant.B[mode] @ K[mode]).real)[::-1]
        for law in (dt.SingleModePredictor(plant, K, mode), dt.ExactPredictor(plant, K)):
            found = dt.characteristic_roots(plant, law, mode, count=10)
            assert found.complete
            assert found.roots.shape == placed.shape
            plants.close(found.roots, placed + 0j, 1e-10)
            assert dt.growth_rate(plant, law, mode, None) == pytest.approx(placed[0], abs=1e-10)


@pytest.mark.parametrize(("k", "delay"), [(1.0, 1.0), (5.0, 0.3), (100.0, 1.0), (0.3, 0.7)])
def test_delayed_feedback_of_an_integrator_has_the_roots_of_lambert_w(k, delay):
    plant, law = scalar_delayed(k, delay)
    found = dt.characteristic_roots(plant, law, 0, count=12)
    every = np.array([lambertw(-k * delay, branch) / delay for branch in range(-12, 12)])
    known = every[np.argsort(-every.real, kind="stable")][: found.roots.size]
    assert found.complete
    assert found.roots.size in (12, 13)
    plants.close(np.sort_complex(found.roots), np.sort_complex(known), 1e-12)
    assert dt.growth_rate(plant, law, 0, None) == pytest.approx(known[0].real, abs=1e-12)


def test_a_double_root_is_found_twice_to_half_of_the_digits():
    plant, law = scalar_delayed(1.0 / np.e, 1.0)
    found = dt.characteristic_roots(plant, law, 0, count=2)
    assert found.complete
    plants.close(found.roots, np.array([-1.0 + 0j, -1.0]), 1e-7)


def test_a_scalar_loop_crosses_the_axis_where_its_equation_says():
    # s = −1 − k e^{−sD} at s = iω: k² = 1 + ω², ω D = π − atan ω.
    frequency = 2.0
    delay = (np.pi - np.arctan(frequency)) / frequency
    plant, law = scalar_delayed(np.sqrt(1.0 + frequency**2), delay, a=-1.0)
    found = dt.characteristic_roots(plant, law, 0, count=1)
    plants.close(found.roots, np.array([2j, -2j]), 1e-13)


@pytest.mark.parametrize(
    ("name", "mode", "rate"),
    [("averaged", 0, 0.1282), ("averaged", 1, 0.2821), ("mean", 0, 0.0905), ("mean", 1, 0.3680)],
)
def test_without_switching_the_paper_s_laws_grow_at_these_rates(name, mode, rate):
    law = plants.LAWS[name](PAPER)
    assert dt.growth_rate(PAPER, law, mode, step=None) == pytest.approx(rate, abs=5e-5)


# -- a second Δ, from the laws' definitions ----------------------------------------------------


def definition(law, mode):
    """F and w(τ) of u = F x + ∫ w(τ) u(t − τ) dτ, and the law's delay."""
    model, D = law.plant, law.plant.delay
    if isinstance(law, dt.DelayedStateFeedback):
        return law.gains[mode], None, 0.0
    if isinstance(law, dt.ExpectedPredictor):
        # The mode's probabilities move on while an input travels: no lift, no frozen system.
        modes, m, n = law.gains.shape
        L = law.model.generator
        free = block_diag(*model.A) + np.kron(L.T, np.eye(n))
        row = np.concatenate(list(law.gains), axis=1)
        start = np.kron(np.eye(modes)[:, [mode]], np.eye(n))

        def weight(tau):
            p = expm(np.multiply.outer(D - tau, L.T))[..., [mode]]
            mapped = row @ expm(np.multiply.outer(tau, free)) @ block_diag(*model.B)
            return mapped @ np.kron(p, np.eye(m))

        return row @ expm(D * free) @ start, weight, D
    if isinstance(law, dt.MeanPredictor):
        branches = [(law.gain, *law.mean)]
    elif isinstance(law, dt.AveragedPredictor):
        branches = list(zip(law.weights[:, None, None] * law.gains, model.A, model.B, strict=True))
    else:
        own = law.mode if isinstance(law, dt.SingleModePredictor) else mode
        branches = [(law.gains[own], model.A[own], model.B[own])]
    F = sum(K @ expm(D * A) for K, A, _ in branches)
    return F, lambda tau: sum(K @ expm(np.multiply.outer(tau, A)) @ B for K, A, B in branches), D


def second_matrix(plant, law, mode):
    """s → Δ(s), by Gauss quadrature of the whole window."""
    F, weight, lead = definition(law, mode)
    A, B = plant.A[mode], plant.B[mode]
    n, m = B.shape
    z, w = np.polynomial.legendre.leggauss(40)
    tau = (z + 1.0) / 2.0 * lead
    taps = None if weight is None else lead / 2.0 * w[:, None, None] * weight(tau)

    def matrix(s):
        memory = np.zeros((m, m)) if taps is None else np.tensordot(np.exp(-s * tau), taps, 1)
        pipe = -np.exp(-s * plant.delay) * B
        return np.block([[s * np.eye(n) - A, pipe], [-F, np.eye(m) - memory]])

    return matrix


@pytest.mark.few(2)
@pytest.mark.parametrize("loop", mostly_long(["same", "later", "sooner", "other"], "other"))
@pytest.mark.parametrize("name", IDEAL)
def test_roots_solve_the_equation_written_down_from_the_law_s_definition(name, loop):
    plant, model = LOOPS[loop]
    law = plants.LAWS[name](model)
    for mode in range(plant.modes):
        found = dt.characteristic_roots(plant, law, mode, count=4)
        assert found.complete
        assert (found.residuals < 1e-13).all()
        assert found.roots.size >= 4 or (name, loop) in {("exact", "same"), ("single", "same")}
        matrix = second_matrix(plant, law, mode)
        for root, error in zip(found.roots, found.errors, strict=True):
            # Newton's correction by the second Δ, its slope by differences.
            step = 1e-5
            near = [np.linalg.det(matrix(root + d)) for d in (0.0, step, -step)]
            correction = abs(2.0 * step * near[0] / (near[1] - near[2]))
            assert error < 1e-9
            assert correction <= 1e-11 * (1.0 + abs(root)) + 10.0 * error


@pytest.mark.parametrize(("name", "loop"), [("averaged", "later"), ("expected", "other")])
def test_no_root_is_missing_in_a_box_around_those_found(name, loop):
    plant, model = LOOPS[loop]
    law = plants.LAWS[name](model)
    found = dt.characteristic_roots(plant, law, 0, count=5)
    matrix = second_matrix(plant, law, 0)
    right, top = found.roots.real.max() + 20.0, 60.0
    corners = [found.line - 1j * top, right - 1j * top, right + 1j * top, found.line + 1j * top]
    sides = [
        a + (b - a) * np.linspace(0.0, 1.0, 800, endpoint=False)
        for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)
    ]
    path = np.append(np.concatenate(sides), corners[0])
    turns = np.unwrap(np.angle([np.linalg.det(matrix(s)) for s in path]))
    assert round((turns[-1] - turns[0]) / (2.0 * np.pi)) == found.roots.size


# -- the count ---------------------------------------------------------------------------------


def test_lines_between_known_roots_have_the_right_number_to_their_right():
    plant, law = scalar_delayed(1.0, 1.0)
    loop = IdealLoop.of(plant, law, 0)
    known = [lambertw(-1.0, branch).real for branch in range(12)]
    lines = [0.5, *((a + b) / 2.0 for a, b in pairwise(known))]
    assert [count_right_of(loop, line) for line in lines] == [2 * i for i in range(len(lines))]
    close = known[0] - 1e-9, known[0] + 1e-9
    assert [count_right_of(loop, line) for line in close] == [2, 0]


def test_a_line_through_a_root_has_no_count():
    plant = plants.generic()
    loop = IdealLoop.of(plant, plants.LAWS["exact"](plant), 0)
    assert count_right_of(loop, float(rightmost(loop, 1).roots[0].real)) is None
    assert count_right_of(loop, -0.5) == 0


@pytest.mark.few(2)
@pytest.mark.parametrize("delay", [1.0001, 1.001, 1.02, 0.98, 0.3, 2.5])
def test_roots_far_out_and_close_together_are_all_found(delay):
    # Up to twice the loop's gain |K e^{AD} B| = 73 there are chains of nearly one real part.
    plant, law = plants.paper(delay), dt.SingleModePredictor(PAPER, plants.gains(PAPER), 0)
    found = dt.characteristic_roots(plant, law, 0, count=40)
    assert found.complete
    assert found.roots.size >= 40
    assert (np.diff(found.roots.real) <= 0.0).all()
    assert count_right_of(IdealLoop.of(plant, law, 0), found.roots.real.max() + 1e-7) == 0


def test_more_roots_begin_with_the_same_ones_and_pairs_stay_together():
    law = plants.LAWS["averaged"](PAPER)
    few, many = (dt.characteristic_roots(PAPER, law, 0, count) for count in (2, 9))
    assert few.roots.size == 3
    assert many.roots.size == 9
    assert few.line < few.roots.real.min()
    plants.close(many.roots[:3], few.roots, 1e-12)
    complex_ones = many.roots[many.roots.imag != 0.0]
    assert np.array_equal(complex_ones[0::2], complex_ones[1::2].conj())


@pytest.mark.parametrize("name", ["averaged", "expected", "delayed"])
def test_both_ways_to_compute_the_memory_agree_and_slopes_are_slopes(name):
    loop = IdealLoop.of(PAPER, plants.LAWS[name](PAPER), 1)
    inside = loop.near * np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 17)) * (1.0 - 1e-14)
    outside = inside * (1.0 + 2e-14)
    assert (np.abs(outside) > loop.near).all()
    for one, other in zip(loop.memory(inside)[0], loop.memory(outside)[0], strict=True):
        plants.close(one, other, 1e-12, max(np.abs(one).max(), 1.0))
    s, step = np.concatenate((inside * 0.3, inside * 3.0)), 1e-6
    difference = (loop.matrix(s + step)[0] - loop.matrix(s - step)[0]) / (2.0 * step)
    plants.close(loop.matrix(s)[1], difference, 1e-8)


@pytest.mark.parametrize("delay", [1.0, 1.02])
@pytest.mark.parametrize("name", ["averaged", "exact", "expected", "delayed"])
def test_no_root_lies_beyond_the_radius(name, delay):
    loop = IdealLoop.of(plants.paper(delay), plants.LAWS[name](PAPER), 0)
    found = rightmost(loop, 30)
    assert np.abs(found.roots).max() < loop.radius(found.line)
    stays = loop.radius(0.0, any_delay=True)
    assert stays >= loop.radius(0.0)


# -- limits and runs ---------------------------------------------------------------------------


@pytest.mark.few(2)
@pytest.mark.parametrize("name", IDEAL)
@pytest.mark.parametrize("loop", mostly_long(["paper", "other"], "paper"))
def test_the_digital_rate_tends_to_the_ideal_one_with_order_one(name, loop):
    plant, model = LOOPS[loop]
    law = plants.LAWS[name](model)
    for mode in range(plant.modes):
        limit = dt.growth_rate(plant, law, mode, step=None)
        coarse, fine = (
            abs(dt.growth_rate(plant, law, mode, plant.delay * part) - limit)
            for part in (0.02, 0.01)
        )
        assert 0.85 < np.log2(coarse / fine) < 1.15


@pytest.mark.parametrize(
    ("name", "loop", "count"),
    [("averaged", "paper", 3), ("mean", "paper", 3), ("expected", "paper", 3),
     ("delayed", "paper", 2), ("averaged", "later", 1), ("exact", "other", 3)],
)  # fmt: skip
def test_a_run_of_the_ideal_loop_becomes_a_sum_of_the_rightmost_motions(name, loop, count):
    plant, law = LOOPS[loop][0], plants.LAWS[name](LOOPS[loop][1])
    roots = dt.characteristic_roots(plant, law, 0, count + 1).roots
    tau, late = 0.3 * plant.delay, 15.0 * plant.delay
    # Motions e^{st} of these roots obey one recurrence over τ; the next one has died out.
    recurrence = np.poly(np.exp(roots[:count] * tau)).real
    signal, times = dt.SwitchingSignal.constant(0), late + tau * np.arange(count + 1)
    x0 = np.array([-1.0, 1.0, 0.5])[: plant.states]
    run = dt.simulate(plant, law, signal, x0, times[-1], step=None, times=times)
    terms = run.states[:, ::-1] * recurrence
    rest = np.exp((roots[count].real - roots[0].real) * late)
    assert (np.abs(terms.sum(axis=1)) <= (1e3 * rest + 1e-9) * np.abs(terms).max(axis=1)).all()
    assert rest < 1e-3


# -- relations ---------------------------------------------------------------------------------


@pytest.mark.few(2)
@pytest.mark.parametrize("name", IDEAL)
def test_other_units_of_state_and_time_scale_the_roots(name):
    plant, c = plants.generic(), 1.7
    T = np.array([[2.0, 0.3, 0.0], [0.0, 0.05, 1.0], [30.0, 0.0, 1.0]])
    changed, law = plants.in_other_units(name, T, c)
    for mode in range(3):
        own = dt.characteristic_roots(plant, plants.LAWS[name](plant), mode, count=3).roots
        other = dt.characteristic_roots(changed, law, mode, count=3).roots
        plants.close(np.sort_complex(other * c), np.sort_complex(own), 1e-10)


@pytest.mark.parametrize("kind", ["averaged", "mean"])
def test_a_dwell_time_long_past_changes_nothing(kind):
    plant = plants.generic()
    aware, plain = (plants.LAWS[name](plant) for name in (f"{kind}, dwell-aware", kind))
    for mode in range(3):
        known = dt.characteristic_roots(plant, plain, mode).roots
        assert np.array_equal(dt.characteristic_roots(plant, aware, mode).roots, known)


def test_an_oracle_of_another_mode_is_the_law_of_that_mode():
    K = plants.gains(PAPER)
    oracle = dt.ExactPredictor(PAPER, K, dt.SwitchingSignal.constant(1))
    known = dt.characteristic_roots(PAPER, dt.SingleModePredictor(PAPER, K, 1), 0).roots
    assert np.array_equal(dt.characteristic_roots(PAPER, oracle, 0).roots, known)


def test_identical_modes_make_the_averaged_law_exact():
    plant = plants.identical()
    found = dt.characteristic_roots(plant, plants.LAWS["averaged"](plant), 1)
    plants.close(found.roots, np.array(plants.POLES) + 0j, 1e-10)


# -- refused -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (
            lambda p, K: dt.ExpectedPredictor(p, K, dt.SemiMarkov([1.0, 1.0])),
            r"ExpectedPredictor has no closed form in continuous time under a SemiMarkov model",
        ),
        (
            lambda p, K: dt.OptimalPredictor(p, dt.Markov([[0, 1], [1, 0]]), np.eye(2), [[1.0]]),
            r"OptimalPredictor has no closed form in continuous time",
        ),
        (
            lambda p, K: dt.StateDependentPredictor(p, K, dt.HalfSpace([1.0, 1.0])),
            r"step must be given for StateDependentPredictor where the plant follows a signal",
        ),
        (
            lambda p, K: dt.ExactPredictor(p, K, dt.SwitchingSignal([0.0, 1.0], [0, 1])),
            r"law must not assume a signal of its own that switches",
        ),
    ],
)
def test_laws_without_an_ideal_form_are_refused_by_name(law, message):
    law = law(PAPER, plants.gains(PAPER))
    for function in (dt.characteristic_roots, lambda *a: dt.growth_rate(*a, step=None)):
        with pytest.raises(dt.ArgumentError, match=message):
            function(PAPER, law, 0)


@pytest.mark.parametrize(("count", "mode"), [(0, 0), (1, 2), (1, -1)])
def test_a_count_or_mode_that_makes_no_sense_is_refused(count, mode):
    law = plants.LAWS["averaged"](PAPER)
    with pytest.raises(dt.ArgumentError, match=r"(count|mode) must be"):
        dt.characteristic_roots(PAPER, law, mode, count)


def test_gains_beyond_the_digits_are_refused_not_guessed():
    plant = plants.paper(8.0)
    law = plants.LAWS["exact"](plant)
    with pytest.raises(dt.ArgumentError, match=r"could not be separated: the law's gains"):
        dt.growth_rate(plants.paper(8.008), law, 0, step=None)


def test_gains_that_overflow_are_refused():
    plant = dt.SwitchedSystem([[[800.0]]], [[[1.0]]], delay=1.0)
    law = dt.AveragedPredictor(plant, [[[-900.0]]])
    with pytest.raises(dt.ArgumentError, match="gains over its delay overflow"):
        dt.growth_rate(plant, law, 0, step=None)
