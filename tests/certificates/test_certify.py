"""Certified functions fall at every step and along runs, and come close to growth that is known."""

import math
from fractions import Fraction
from functools import cache

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import certificate_reference as reference
import deadtime as dt
import exponential_products as products
import plants
from certificate_reference import Loop
from certified_loops import (
    ALONE,
    GENERIC,
    MILD,
    PAIR,
    PAPER,
    WEAK,
    assert_runs_decrease,
    assert_steps_decrease,
    designed,
    free,
    proved,
    undecided,
    with_delay,
)
from deadtime.base.errors import ArgumentError
from exponential_products import ellipses
from shares import mostly_long

THREE = dt.problems.three_mode().plant


def mild(delay, law=dt.AveragedPredictor):
    """A law of MILD on a plant with another delay and other matrices."""
    return dt.SwitchedSystem(1.02 * MILD.A, 0.97 * MILD.B, delay), law(MILD, WEAK)


def of(law, plant=PAIR):
    return plant, plants.LAWS[law](plant)


def of_pair(alpha):
    """A law that relies on a dwell time, for two modes of the three-mode plant."""
    far = THREE.apart(alpha)
    plant = dt.SwitchedSystem(far.A[:2], far.B[:2], far.delay)
    return plant, dt.AveragedPredictor(plant, dt.place(plant, (-2.0, -3.0)), None, 0.8)


# name: (plant and law, dwell time, step)
CASES = {
    "generic, averaged": (lambda: of("averaged", GENERIC), 0.25, 0.1),
    "generic, mean with gains": (lambda: of("mean with gains", GENERIC), 0.11, 0.1),
    "weighted": (lambda: of("weighted"), 0.3, 0.1),
    "single": (lambda: of("single"), 0.3, 0.1),
    "mean": (lambda: of("mean"), 0.17, 0.1),
    "averaged, dwell-aware": (lambda: of("averaged, dwell-aware"), 0.1634, 0.1),
    "mean, dwell-aware": (lambda: of("mean, dwell-aware"), 0.31, 0.1),
    "expected": (lambda: of("expected"), 0.3, 0.1),
    "delayed": (lambda: (MILD, dt.DelayedStateFeedback(MILD, WEAK)), 0.3, 0.1),
    "input within its period": (lambda: designed(with_delay(PAIR, 0.034)), 0.2, 0.1),
    "by mode within its period": (lambda: mild(0.034, dt.DelayedStateFeedback), 0.2, 0.1),
    "plant later by two periods": (lambda: mild(0.434), 0.3, 0.1),
    "plant sooner by two periods": (lambda: mild(0.034), 0.3, 0.1),
    "a Lyapunov function for every age": (lambda: of_pair(0.5), 0.8, 0.2),
    "one mode": (lambda: designed(ALONE), 0.3, 0.1),
    "paper": (lambda: designed(PAPER.apart(0.6)), 0.2, 0.1),
    "paper, 0.65": (lambda: designed(PAPER.apart(0.65)), 0.2, 0.1),
    "paper, 0.638, N = 100": (lambda: designed(PAPER.apart(0.638)), 0.2, 0.01),
    "three modes, 0.79, N = 100": (lambda: designed(THREE.apart(0.79), (-2.0, -3.0)), 0.9, 0.01),
}
SMALL = [name for name in CASES if "N = 100" not in name]
# Of the others there are files in the corpus, which both verifiers prove at every change.
ALWAYS = [
    "generic, averaged",
    "averaged, dwell-aware",
    "mean, dwell-aware",
    "expected",
    "by mode within its period",
    "plant sooner by two periods",
    "a Lyapunov function for every age",
    "one mode",
    "paper, 0.65",
]


@cache
def certified(name):
    loop, dwell_time, step = CASES[name]
    plant, law = loop()
    return plant, law, proved(plant, law, dwell_time, step)


@pytest.mark.few(4)
@pytest.mark.parametrize(
    ("name", "digits"),
    # Fifty digits take ten times as long.
    mostly_long(
        [(name, digits) for digits in (False, True) for name in CASES],
        *((name, False) for name in ALWAYS),
        *((name, True) for name in ("generic, averaged", "mean, dwell-aware")),
    ),
)
def test_every_step_decreases_the_lyapunov_function_in_floats_and_in_fifty_digits(name, digits):
    plant, law, certificate = certified(name)
    most = None if name in SMALL else 1 if digits else 20
    with mpmath.workdps(reference.DIGITS):
        loop = Loop(plant.A, plant.B, plant.delay, law.digital(CASES[name][2]), digits)
        assert_steps_decrease(certificate, loop, 1 if digits else 2, most=most)


@pytest.mark.parametrize("name", mostly_long(CASES, *ALWAYS))
def test_the_lyapunov_function_falls_at_every_sample_of_runs(name):
    plant, law, certificate = certified(name)
    _, dwell_time, step = CASES[name]
    samples = 60 if name in SMALL else 150
    for seed in range(3):
        signal = dt.SwitchingSignal.constant(0)
        if plant.modes > 1:
            rng, longest = np.random.default_rng(seed), dwell_time + 5.0 * step
            signal = dt.SwitchingSignal(
                *reference.random_signal(rng, plant.modes, dwell_time, samples * step, longest)
            )
        assert_runs_decrease(certificate, plant, law, signal, samples)


def test_what_is_tried_is_told():
    told = []
    law = dt.AveragedPredictor(MILD, WEAK)
    certificate = dt.certify(MILD, law, 0.2, 0.1, delays=(0.16, 0.18), progress=told.append)
    assert certificate.proven
    kinds = [word for word in told if word.startswith("Lyapunov functions, kind")]
    assert kinds[0].startswith("Lyapunov functions, kind 1 of")
    assert certificate.decay_rate is not None
    assert told[-1].endswith(f"proving a decay of {certificate.decay_rate:.3g} 1/s")


@pytest.mark.parametrize(
    ("alpha", "step"),
    mostly_long([(0.66, 0.1), (0.6395, 0.01), (0.806, 0.01), (1, 0.1)], (0.66, 0.1)),
)
def test_loops_beyond_their_limit_are_refuted_by_a_signal_that_grows(alpha, step):
    (plant, law), dwell_time = designed(PAPER.apart(alpha)), 0.2
    if alpha == 0.806:
        (plant, law), dwell_time = designed(THREE.apart(alpha), (-2.0, -3.0)), 0.9
    certificate = dt.certify(plant, law, dwell_time, step)
    assert (certificate.stable, certificate.proven) == (False, False)
    witness = certificate.witness
    assert witness.growth_rate > 0.0
    assert witness.signal.dwell_time >= dwell_time
    # The mode that lasts for ever grows at that rate, says the reference, too.
    M = Loop(plant.A, plant.B, plant.delay, law.digital(step)).step(witness.modes[0], 10**6)
    rate = math.log(np.abs(np.linalg.eigvals(M)).max()) / step
    assert witness.growth_rate == pytest.approx(rate, rel=1e-3)
    with pytest.raises(ArgumentError, match="has no Lyapunov function: Not stable"):
        certificate.lyapunov()
    with pytest.raises(ArgumentError, match="has no proof to save"):
        certificate.save("nowhere.json")


# -- loops whose growth is known -----------------------------------------------------------


@pytest.mark.parametrize("family", mostly_long(["commuting", "triangular", "normal"], "triangular"))
def test_where_the_joint_spectral_radius_is_that_of_a_mode_certificates_come_close_to_it(family):
    A = getattr(products, family)(np.random.default_rng(5))
    A = A - np.linalg.eigvals(A).real.max() * np.eye(3)  # now the joint spectral radius is 1
    loop = free(A - 0.05 * np.eye(3))
    certificate = proved(*loop, 0.11, 0.1, decay_rate=0.0475)
    assert 0.0475 <= certificate.decay_rate <= 0.0475 * (1.0 + 1e-9)
    certificate = proved(*loop, 0.11, 0.1, decay_rate=0.0)
    assert certificate.decay_rate == 0.0
    assert certificate.message.endswith("proved: the loop decays.")
    assert "more than a constant mode has" in undecided(*loop, 0.11, 0.1, decay_rate=0.0501)
    assert dt.certify(*free(A + 0.001 * np.eye(3)), 0.11, 0.1).stable is False


@pytest.mark.parametrize(
    ("k", "a", "slack"),
    [
        pytest.param(4.0, 0.8, 1.45, marks=pytest.mark.long),
        pytest.param(2.0, 0.1, 1.45, marks=pytest.mark.long),
        (4.0, 0.5, 2.6),
    ],
)
def test_the_critical_dwell_time_of_two_planar_modes_is_approached_and_not_passed(k, a, slack):
    A, turn = ellipses(k, a), 2.0 * np.pi / math.sqrt(k)

    def growth(tau):
        return products.worst_multiplier(A, [tau] * 2, [tau + turn] * 2)

    limit, loop = products.critical(growth, 8.0, 0.2), free(A, 0.05)
    undecided(*loop, 0.99 * limit, 0.05, search_signals=False)
    refuted = dt.certify(*loop, 0.95 * limit, 0.05)
    assert refuted.stable is False
    cycle = list(zip(refuted.witness.modes, refuted.witness.sojourns, strict=True))
    assert products.multiplier(A, cycle) > 1.0
    proved(*loop, slack * limit, 0.05)


def a_problem(rng):
    """A plant, a law, a dwell time and a period; switches make about a third unstable."""
    A = []
    for a, w, k, turn in rng.uniform((0.1, 1.0, 1.0, 0.0), (1.0, 4.0, 2.5, 3.0), (2, 4)):
        Q = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        A.append(Q @ np.array([[-a, w * k], [-w / k, -a]]) @ Q.T)
    model = dt.SwitchedSystem(A, rng.normal(size=(2, 2, 1)), 0.1)
    law = (dt.AveragedPredictor, dt.DelayedStateFeedback)[int(rng.random() < 0.2)]
    law = law(model, 0.1 * rng.normal(size=(2, 1, 2)), allow_unstable=True)
    delay = float(rng.choice([0.1, 0.1, 0.06, 0.17]))
    return with_delay(model, delay), law, 0.1 * rng.uniform(1.001, 9.0), 0.1


@pytest.mark.long
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_no_loop_is_certified_to_decay_faster_than_along_some_periodic_signal(seed):
    rng = np.random.default_rng(seed)
    plant, law, dwell_time, step = a_problem(rng)
    rate = float(rng.choice([0.0, 0.1]))
    certificate = dt.certify(plant, law, dwell_time, step, decay_rate=rate, search_signals=False)
    loop = Loop(plant.A, plant.B, plant.delay, law.digital(step))
    found = [(loop.step(mode, 10**6), 1) for mode in range(2)]
    for waits in rng.exponential(3.0, (10, 2)):
        first, second = (Fraction(float(dwell_time / step + wait)) for wait in waits)
        found.append(reference.period(loop, [first, second + (-first - second) % 1]))
    growth = max(np.abs(np.linalg.eigvals(M)).max() ** (1.0 / count) for M, count in found)
    assert certificate.stable is not False
    assert growth < (certificate.evidence.rho if certificate.stable else math.inf)
