"""Growth is proved or not claimed: bounds of growth rates, and loops that only seem to grow."""

import itertools
import math

import mpmath
import numpy as np
import pytest

import certificate_reference as reference
import deadtime as dt
import exponential_products as products
import plants
from deadtime.certificates.worst_case import growth_proof
from deadtime.certificates.worst_case.cycle_growth import SampledLoop
from deadtime.certificates.worst_case.cycles import Cycle
from deadtime.certificates.worst_case.growth_proof import prove
from deadtime.spectrum import growth
from shares import mostly_long

H = 0.1
DECAY = 2.0**-12


def unimodular(n, seed):
    """An integer matrix of determinant 1, and its inverse, exactly."""
    rng, T, back = np.random.default_rng(seed), np.eye(n), np.eye(n)
    for _ in range(2 * n):
        i, j = rng.permutation(n)[:2]
        step = np.eye(n)
        step[i, j] = rng.integers(-2, 3)
        undo = 2.0 * np.eye(n) - step
        T, back = step @ T, back @ undo
    assert (T @ back == np.eye(n)).all()
    return T, back


def free(A, delay=H):
    """A plant left to itself."""
    A = np.atleast_3d(np.asarray(A, float)) if np.ndim(A) == 3 else np.asarray(A, float)[None]
    plant = dt.SwitchedSystem(A, np.ones((*A.shape[:2], 1)), delay)
    gains = np.zeros((A.shape[0], 1, A.shape[1]))
    return plant, dt.DelayedStateFeedback(plant, gains, allow_unstable=True)


def defective(n, seed, rate=-DECAY):
    """One eigenvalue of multiplicity n, in one Jordan block, exact in binary64."""
    T, back = unimodular(n, seed)
    A = T @ (np.eye(n, k=1) + rate * np.eye(n)) @ back
    assert np.linalg.matrix_rank(A - rate * np.eye(n)) == n - 1
    return free(A)


def precise_rate(plant, law, mode, step):
    """The growth rate by mpmath's eigenvalues of the lifted matrix, both with 50 digits."""
    table = law.digital(step)
    loop = reference.Loop(plant.A, plant.B, plant.delay, table, digits=True)
    with mpmath.workdps(reference.DIGITS):
        M = loop.step(mode, table.ages - 1)
        values = mpmath.eig(mpmath.matrix(M.tolist()), left=False, right=False)
        return float(mpmath.log(max(abs(v) for v in values)) / reference.precise(loop.plant.h))


# -- growth rates ----------------------------------------------------------------------------


@pytest.mark.parametrize(("n", "seed"), list(itertools.product((3, 4, 5, 6), (0, 1, 2))))
def test_a_multiple_eigenvalue_has_its_growth_rate_to_the_last_digits(n, seed):
    plant, law = defective(n, seed)
    low, high = dt.growth_bounds(plant, law, 0, H)
    assert low <= -DECAY <= high < low + 1e-10
    assert dt.growth_rate(plant, law, 0, H) == pytest.approx(-DECAY, abs=1e-9)


@pytest.mark.few(6)
@pytest.mark.parametrize("name", [name for name in plants.LAWS if name != "exact"])
@pytest.mark.parametrize("mode", [0, 2])
def test_bounds_hold_the_growth_rate_of_fifty_digits_and_are_close(name, mode):
    plant = plants.generic()
    law = plants.LAWS[name](plant)
    low, high = dt.growth_bounds(plant, law, mode, H)
    rate = precise_rate(plant, law, mode, H)
    # The reference reads delay and period as decimals, the bounds as binary numbers.
    assert low - 1e-12 <= rate <= high + 1e-12
    assert high - low < 1e-10
    assert dt.growth_rate(plant, law, mode, H) == pytest.approx(rate, abs=1e-9)


@pytest.mark.parametrize("step", mostly_long([0.1, 0.01, 0.001], 0.1, 0.01))
def test_bounds_agree_with_the_spectrum_at_any_order(step):
    plant = plants.paper()
    law = plants.LAWS["averaged"](plant)
    low, high = dt.growth_bounds(plant, law, 1, step)
    assert high - low < 1e-10
    assert dt.growth_rate(plant, law, 1, step) == pytest.approx(0.5 * (low + high), abs=1e-9)


def test_a_loop_that_ends_after_finitely_many_periods_has_no_lower_bound():
    plant = dt.SwitchedSystem([[[0.0]]], [[[1.0]]], 0.5)
    law = dt.SingleModePredictor(plant, [[[-4.0]]], 0)  # with h = 1/4 exact: x_{k+1+N} = 0
    assert dt.growth_bounds(plant, law, 0, 0.25)[0] == -np.inf
    assert dt.growth_bounds(plant, law, 0, 0.25)[1] < -100.0


def test_a_loop_whose_growth_cannot_be_bounded_is_refused_by_name(monkeypatch):
    plant = plants.paper()
    law = plants.LAWS["averaged"](plant)
    rule = dt.StateDependentPredictor(plant, plants.gains(plant), dt.HalfSpace([1.0, 0.0]))
    with pytest.raises(dt.ArgumentError, match="law must be a table, got StateDependentPredictor"):
        dt.growth_bounds(plant, rule, 0)
    monkeypatch.setattr(growth, "LARGEST", 20)
    with pytest.raises(dt.ArgumentError, match="order up to 20, got 102: lengthen it"):
        dt.growth_bounds(plant, law, 0)
    monkeypatch.setattr(growth, "_DOUBT", 0.0)  # beyond the limit doubts stay
    assert dt.growth_rate(plant, law, 1) == pytest.approx(0.281670215, abs=1e-9)


# -- loops that seem to grow -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("n", "seed"), mostly_long(itertools.product((3, 4, 5, 6), (0, 1)), (3, 0), (6, 1))
)
def test_a_stable_loop_of_a_multiple_eigenvalue_is_never_refuted(n, seed):
    plant, law = defective(n, seed)
    worst = dt.falsify(plant, law, 0.2, H)
    assert not worst.proven
    assert "The loop grows" not in worst.message
    if seed == 0:
        certificate = dt.certify(plant, law, 0.2, H, decay_rate=0.0)
        assert certificate.stable is not False


@pytest.mark.parametrize("n", mostly_long([3, 4, 5, 6], 4))
def test_an_unstable_loop_of_a_multiple_eigenvalue_is_refuted(n):
    plant, law = defective(n, 1, rate=DECAY)
    certificate = dt.certify(plant, law, 0.2, H)
    assert certificate.stable is False
    assert certificate.witness.proof.rate == pytest.approx(DECAY, abs=1e-9)


@pytest.mark.long
def test_growth_that_cannot_be_proved_is_no_answer_but_a_reason(monkeypatch):
    plant = plants.paper()
    law = plants.LAWS["averaged"](plant)
    monkeypatch.setattr(growth_proof, "enclose_growth", lambda *_: (-1e-4, 1e-4))
    certificate = dt.certify(plant, law, 0.2, H)
    assert certificate.stable is None
    assert "Growth of +0.277 /s was computed when mode 1 is constant" in certificate.message
    assert "not be proved: the growth rate is between -0.0001 /s and" in certificate.message
    with pytest.raises(dt.ArgumentError, match="must be certified stable"):
        dt.stability_margin(lambda a: (plant.apart(a), law), (1.0, 2.0), 0.2, H)


# -- proofs along cycles -----------------------------------------------------------------------


def assert_refuted(plant, law, dwell_time, step):
    """The witness grows, in products of matrix exponentials that share no code with the proof."""
    worst = dt.falsify(plant, law, dwell_time, step, budget=4000)
    assert worst.proven, worst.message
    assert 0.0 < worst.proof.rate <= worst.growth_rate + 1e-9
    loop = reference.Loop(plant.A, plant.B, plant.delay, law.digital(step))
    product = np.eye(loop.order)
    cycle, ages = worst.cycle, law.digital(step).ages
    if cycle.constant:
        product, periods = loop.step(cycle.modes[0], ages - 1), 1
    else:
        product, periods = reference.over(loop, cycle.modes, cycle.gaps, cycle.offset)
    rate = math.log(np.abs(np.linalg.eigvals(product)).max()) / (periods * step)
    assert rate == pytest.approx(worst.growth_rate, abs=1e-5)
    run = worst.simulate(cycles=max(5, math.ceil(6.0 / (worst.growth_rate * worst.length))))
    size = np.linalg.norm(run.states, axis=0)
    assert size[-1] > 10.0 * size[0]


@pytest.mark.parametrize(
    "name", mostly_long([n for n in plants.LAWS if n != "exact"], "averaged", "expected")
)
def test_growth_under_every_law_of_the_paper_s_plant_is_proved(name):
    plant = plants.paper()
    assert_refuted(plant, plants.LAWS[name](plant), 0.2, H)


@pytest.mark.long
@pytest.mark.parametrize("name", ["weighted", "expected", "averaged, dwell-aware"])
def test_growth_over_a_hundred_periods_of_delay_is_proved(name):
    plant = plants.paper()
    assert_refuted(plant, plants.LAWS[name](plant), 0.2, 0.01)


@pytest.mark.parametrize("name", mostly_long(["averaged", "expected", "delayed"], "expected"))
def test_growth_of_the_three_mode_plant_is_proved(name):
    plant = dt.problems.three_mode().plant
    law = {
        "averaged": lambda: dt.AveragedPredictor(plant, dt.place(plant, [-2.0, -3.0])),
        "expected": lambda: dt.ExpectedPredictor(
            plant, dt.place(plant, [-2.0, -3.0]), plants.markov(3)
        ),
        "delayed": lambda: dt.DelayedStateFeedback(plant, dt.place(plant, [-2.0, -3.0])),
    }[name]()
    assert_refuted(plant, law, 0.9, 0.1)


@pytest.mark.parametrize("seed", mostly_long(range(6), 1, 2))
def test_growth_of_random_plants_is_proved(seed):
    plant = plants.generic(delay=0.13 + 0.05 * seed, seed=seed)
    assert_refuted(plant, plants.LAWS["delayed"](plant), 0.2, H)


def test_growth_within_the_tolerance_of_the_clock_is_proved():
    A = [[[-9.7, 15.8], [-17.39, -2.6]], [[-10.55, -11.29], [-13.6, -23.77]]]
    B = [[[8.22], [12.58]], [[-3.68], [-8.8]]]
    plant = dt.SwitchedSystem(A, B, delay=H)
    law = dt.DelayedStateFeedback(plant, [[[-0.42, 0.24]], [[1.689, -1.205]]])
    assert_refuted(plant, law, 0.2, H)


@pytest.mark.long
def test_a_constant_mode_that_grows_stands_in_for_a_cycle_beyond_reach(monkeypatch):
    plant = plants.paper()
    law = plants.LAWS["weighted"](plant)
    assert not dt.falsify(plant, law, 0.2, H).cycle.constant
    monkeypatch.setattr(growth_proof, "MOST_SECONDS", 0.0)
    worst = dt.falsify(plant, law, 0.2, H)
    assert worst.cycle.constant
    assert worst.proven
    assert dt.certify(plant, law, 0.2, H).stable is False


TURNING = np.array([[[-0.1, 1.0], [-4.0, -0.1]], [[-0.1, 4.0], [-1.0, -0.1]]])
WORD = Cycle((0, 1), (7.0, 8.0))


def along(shift):
    """The loop of two modes that turn, A + shift·I: its growth is moved by exactly as much."""
    plant, law = free(TURNING + shift * np.eye(2))
    return SampledLoop.of(plant, law.digital(H), 0.0)


@pytest.mark.parametrize(("beyond", "proven"), [(1e-5, True), (-1e-5, False), (-1e-9, False)])
def test_a_cycle_is_proved_to_grow_on_one_side_of_the_limit_only(beyond, proven):
    rate = products.multiplier(TURNING, [(0, 0.7), (1, 0.8)])
    loop = along(beyond - math.log(rate) / 1.5)
    found = prove(loop, WORD, max(beyond, 1e-5))  # below the limit the claim is forged
    assert found.proven == proven
    assert found.rate is None if not proven else 0.0 < found.rate <= beyond * 1.001
    assert proven or found.reason.startswith("the traces of up to ")


def test_a_forged_claim_about_a_constant_mode_is_not_proved():
    plant, law = defective(4, 0)
    loop = SampledLoop.of(plant, law.digital(H), 0.0)
    found = prove(loop, Cycle((0,), (5.0,)), 4.1e-4)
    assert not found.proven
    assert found.reason.startswith("the growth rate is between -0.0002441 /s and -0.000244")


def test_what_is_beyond_a_proof_s_reach_is_said(monkeypatch):
    loop = along(1.0)
    assert prove(loop, WORD, -1.0).reason == "no growth was computed"
    monkeypatch.setattr(growth_proof, "MOST_SECONDS", 1e-9)
    assert "a cycle of 15 periods of a loop of order 3 is beyond reach" in (
        prove(loop, WORD, 1.0).reason
    )
    monkeypatch.setattr(growth_proof, "MOST_SECONDS", 1.0)
    monkeypatch.setattr(growth_proof, "BITS", (2,))
    assert prove(loop, WORD, 1.0).reason == "2 bits do not suffice"
    monkeypatch.setattr(growth_proof, "LARGEST", 2)
    assert prove(loop, Cycle((0,), (5.0,)), 1.0).reason == (
        "the loop has order 3, and 2 is the limit; lengthen the step"
    )
