"""Lyapunov functions along stretches: back in their inequalities, and as far as LMIs reach."""

import dataclasses
import math

import cvxpy as cp
import numpy as np
import pytest
from scipy.linalg import expm

import certificate_reference as reference
import deadtime as dt
import plants
from certificate_corpus import CORPUS
from certificate_reference import Loop
from deadtime.certificates.dwell.stretch_program import future_sums
from deadtime.certificates.dwell.stretch_search import StretchSearch
from deadtime.certificates.proof import Check, StretchEvidence, balls, check, load_evidence
from deadtime.certificates.proof.delays import Delays
from deadtime.certificates.proof.evidence import Setting
from deadtime.certificates.proof.stretches import StretchInequalities
from deadtime.numerics.precision import precision
from deadtime.plant.plant_set import Polytope

LEFT = np.array([[[0.1, 1.0], [-1.0, 0.1]], [[-0.5, 0.3], [-0.3, -0.5]]])  # mode 0 grows
TURNING = np.array([[[0.0, 1.0], [-10.0, -1.0]], [[0.0, 1.0], [-0.1, -0.5]]])
THREE = dt.problems.three_mode().plant
PAIR = plants.generic().apart(0.05)  # three modes, three states, two inputs


def idle(A, delay=0.3):
    """A plant without feedback."""
    plant = dt.SwitchedSystem(A, np.ones((*A.shape[:2], 1)), delay)
    gains = np.zeros((len(A), 1, A.shape[1]))
    return plant, dt.AveragedPredictor(plant, gains, allow_unstable=True)


def late(plant, delay):
    return dt.SwitchedSystem(plant.A, plant.B, delay)


def two_of_three(alpha, dwell_time=None):
    far = THREE.apart(alpha)
    plant = dt.SwitchedSystem(far.A[:2], far.B[:2], far.delay)
    return plant, dt.AveragedPredictor(plant, dt.place(plant, (-2.0, -3.0)), None, dwell_time)


def by_mode(rng):
    A = [[[-1.0, 2.0], [-2.0, -1.0]], [[-0.5, 0.2], [-3.0, -0.6]]]
    model = dt.SwitchedSystem(A, rng.normal(size=(2, 2, 1)), 0.2)
    gains = 0.1 * rng.normal(size=(2, 1, 2))
    return model, dt.DelayedStateFeedback(model, gains, allow_unstable=True)


def of_another_plant():
    plant, law = by_mode(np.random.default_rng(1))
    return dt.SwitchedSystem(1.02 * plant.A, 0.97 * plant.B, 0.34), law


# name: (plant and law, dwell time, longest, step)
LOOPS = {
    "no input": (lambda: idle(TURNING), 2.9, None, 0.1),
    "three modes, two inputs": (lambda: (PAIR, plants.LAWS["averaged"](PAIR)), 0.35, None, 0.1),
    "rows by mode": (lambda: by_mode(np.random.default_rng(1)), 0.5, None, 0.1),
    "fractional delay, truth is not model": (of_another_plant, 0.55, None, 0.1),
    "rows by mode and age": (lambda: two_of_three(0.5, 0.8), 0.8, None, 0.2),
    "a mode that must be left": (lambda: idle(LEFT), 1.0, 1.8, 0.1),
    "longest dwell time": (lambda: two_of_three(0.5), 0.8, 1.9, 0.2),
}


def setting_of(plant, law, dwell_time, longest, step):
    table = law.digital(step)
    numbers = (table.state_gain, table.input_gain, table.context, table.ages, step)
    delays = Delays.of(None, plant, step)
    signals = dt.SignalClass(dwell_time, longest)
    return Setting(Polytope.of([plant]), delays, *numbers, signals)


def assert_stretches_decrease(evidence, loop):
    """P_here − Mᵀ P_there M/ρ^{2L} ≻ 0, period by period from node to node."""
    setting, knots, modes = evidence.setting, evidence.knots, evidence.P.shape[0]
    signals = setting.signals
    longest = None if math.isinf(signals.maximum_dwell) else signals.maximum_dwell
    times = signals.dwell_time, setting.step
    arrivals = {j: np.eye(setting.order) for j in range(modes)}
    for j in range(modes):
        for a in range(knots[0]):
            arrivals[j] = loop.step(j, a, j, 1) @ arrivals[j]
    count = 0

    def falls(here, there, M, periods):
        nonlocal count
        count += 1
        scaled = M / evidence.rho ** (periods - 1)
        assert reference.decreases(evidence.P[here], evidence.P[there], scaled, evidence.rho)

    for i in range(modes):
        for k, start in enumerate(knots):
            M, a = np.eye(setting.order), start
            while True:
                if reference.may_leave(a, *times):
                    low, high = reference.instants(a, *times, longest)
                    for s in np.linspace(low, high, 5) if high > 0.0 else ():
                        for j in set(range(modes)) - {i}:
                            mixed = arrivals[j] @ loop.step(i, a, j, s) @ M
                            falls((i, k), (j, 0), mixed, a - start + 1 + knots[0])
                if not reference.may_stay(a, longest, setting.step):
                    break
                M, a = loop.step(i, a, i, 1) @ M, a + 1
                if a in knots:
                    falls((i, k), (i, knots.index(a)), M, a - start)
                    break
                if start == knots[-1] and longest is None:
                    falls((i, k), (i, k), M, 1)
                    break
    assert count >= modes * (5 * (modes - 1) + 1)


@pytest.mark.few(2)
@pytest.mark.parametrize("name", LOOPS)
def test_every_stretch_decreases_the_lyapunov_function(name):
    make, *times = LOOPS[name]
    plant, law = make()
    setting = setting_of(plant, law, *times)
    search = StretchSearch(setting)
    evidence, outcome = search.prove(search.propose(1.0))
    assert outcome.proven, outcome.reason
    loop = Loop(plant.A, plant.B, plant.delay, law.digital(setting.step))
    assert_stretches_decrease(evidence, loop)


@pytest.mark.parametrize("name", LOOPS)
def test_the_function_of_a_mode_that_may_last_is_a_sum_over_what_comes(name):
    make, *times = LOOPS[name]
    search = StretchSearch(setting_of(*make(), *times))
    loops = search._loops(1.0, 1.0)
    lasting = range(search.setting.modes) if times[1] is None else ()
    assert set(loops.shape.sums) == {(mode, len(search.knots) - 1) for mode in lasting}


def test_a_sum_over_the_future_solves_the_lyapunov_equation_and_none_is_made_where_it_diverges():
    rng = np.random.default_rng(0)
    M = rng.normal(size=(5, 5))
    M *= 0.999 / np.abs(np.linalg.eigvals(M)).max()
    X = np.eye(5) + 0.1 * np.ones((2, 5, 5))
    V = future_sums(M, X)
    np.testing.assert_allclose(V - M.T @ V @ M, X, atol=1e-9 * np.abs(V).max())
    assert future_sums(1.01 * M / 0.999, X) is None


def lmi_dwell_time(A, low, high):
    """The least T of A_iᵀP_i + P_iA_i ≺ 0, e^{A_iᵀT}P_j e^{A_iT} ≺ P_i (Geromel and Colaneri)."""

    def margin(T):
        n, t = A.shape[1], cp.Variable()
        P = [cp.Variable((n, n), symmetric=True) for _ in A]
        bounds = []
        for i, a in enumerate(A):
            bounds += [P[i] << np.eye(n), a.T @ P[i] + P[i] @ a << -t * np.eye(n)]
            E = expm(a * T)
            bounds += [E.T @ P[j] @ E - P[i] << -t * np.eye(n) for j in range(len(A)) if j != i]
        problem = cp.Problem(cp.Maximize(t), bounds)
        problem.solve(solver="CLARABEL")
        return problem.value

    assert margin(high) > 1e-7
    while high - low > 1e-3 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if margin(middle) > 1e-7 else (middle, high)
    return high


def random_modes(rng, modes, n):
    """Modes that decay at 0.3 1/s at least."""
    A = rng.normal(size=(modes, n, n)) * 2.0
    return np.stack([a - (np.linalg.eigvals(a).real.max() + 0.3) * np.eye(n) for a in A])


@pytest.mark.few(1)
@pytest.mark.parametrize(("seed", "modes", "n"), [(3, 2, 2), (5, 2, 3), (2, 3, 2), (6, 2, 4)])
def test_without_input_certify_reaches_what_the_lmis_on_exponentials_prove(seed, modes, n):
    A, step = random_modes(np.random.default_rng(seed), modes, n), 0.02
    least = lmi_dwell_time(A, 0.0, 30.0)
    assert least > 3.0 * step
    plant, law = idle(A)
    certificate = dt.certify(
        plant, law, least + 2.0 * step + 1e-3, step, decay_rate=0.0, search_signals=False
    )
    assert certificate.stable is True, certificate.message


@pytest.mark.long
def test_two_modes_that_turn_are_proved_at_twenty_seconds_whatever_delay_nothing_travels_through():
    found = [dt.certify(*idle(TURNING, delay), 20.0, 0.01) for delay in (0.3, 0.305)]
    for certificate in found:
        assert (certificate.stable, certificate.proven) == (True, True)
        assert certificate.decay_rate > 0.22
        assert isinstance(certificate.evidence, StretchEvidence)
        np.testing.assert_array_equal(certificate.evidence.P, found[0].evidence.P)


def test_a_mode_that_must_be_left_is_certified_close_to_how_long_it_may_last():
    # By hand: e^{0.1 T} e^{−0.5} < 1, so T < 5; commuting modes, every other sojourn 1 s.
    certificate = dt.certify(*idle(LEFT), 1.0, 0.1, maximum_dwell=4.3, search_signals=False)
    assert certificate.stable is True, certificate.message
    beyond = dt.certify(*idle(LEFT), 1.0, 0.1, maximum_dwell=5.1, search_signals=False)
    assert beyond.stable is None


def along_stretches(name):
    evidence = load_evidence(CORPUS / f"{name}.json").evidence
    assert isinstance(evidence, StretchEvidence)
    return evidence


@pytest.mark.parametrize("longest", [7.0, 30.0, 100.0, 240.0])
def test_sojourns_claimed_far_too_long_are_refused_after_few_of_their_steps(longest):
    evidence = along_stretches("stretches-maximum")
    signals = dataclasses.replace(evidence.setting.signals, maximum_dwell=longest)
    claimed = dataclasses.replace(evidence.setting, signals=signals)
    outcome = check(dataclasses.replace(evidence, setting=claimed))
    assert not outcome.proven
    assert outcome.cells < 100


def test_long_products_of_equal_steps_cost_a_few_multiplications():
    evidence = along_stretches("stretches-maximum")
    inequalities = StretchInequalities(evidence)
    with precision():
        for end in (2000, 2001, 2002, 1999):
            inequalities.full(0, 0, end)
        M = balls.middle(inequalities.full(1, 0, 1))
        assert np.allclose(
            balls.middle(inequalities.full(1, 3, 40)), np.linalg.matrix_power(M, 37), rtol=1e-9
        )
    assert len(inequalities.known) < 60


def test_more_knots_than_stretches_may_be_are_refused_before_any_is_looked_at():
    evidence = along_stretches("stretches-maximum-free")
    setting = dataclasses.replace(evidence.setting, signals=dt.SignalClass(600.0, 600.2))
    knots = tuple(range(5_990))
    P = np.repeat(evidence.P[:, :1], len(knots), axis=1)
    claimed = dataclasses.replace(evidence, setting=setting, knots=knots, P=P)
    assert check(claimed) == Check(False, "there are too many stretches")


@pytest.mark.long
def test_rows_by_mode_and_age_are_certified_at_ninety_ages_close_to_the_limit():
    plant = THREE.apart(0.79)  # a constant mode grows from 0.8 on
    law = dt.AveragedPredictor(plant, dt.place(plant, (-2.0, -3.0)), None, 0.9)
    certificate = dt.certify(plant, law, 0.9, 0.01, decay_rate=0.0, search_signals=False)
    assert certificate.stable is True, certificate.message
