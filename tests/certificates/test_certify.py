"""Certificates: put back into their inequalities, true of runs, and as tight as claimed."""

import itertools
import math
import re
from fractions import Fraction
from functools import cache
from types import SimpleNamespace

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import certificate_reference as reference
import deadtime as dt
import plants
from certificate_reference import Loop, ellipses, steps
from deadtime.base.errors import ArgumentError
from deadtime.certificates.proof import StretchEvidence
from deadtime.certificates.proof.transitions import Transitions, interpolation

PAPER = dt.problems.paper().plant
THREE = dt.problems.three_mode().plant


def with_delay(plant, delay):
    return dt.SwitchedSystem(plant.A, plant.B, delay)


def designed(plant, poles=(-1.0, -2.0)):
    return plant, dt.AveragedPredictor(plant, dt.place(plant, poles))


GENERIC = plants.generic().apart(0.05)  # three modes, three states, two inputs, N = 3
PAIR = with_delay(PAPER.apart(0.3), 0.234)  # with a step of 0.1, N = 3 and φ = 0.034
ALONE = dt.SwitchedSystem(PAIR.A[:1], PAIR.B[:1], 0.234)
MILD = dt.SwitchedSystem(PAPER.apart(0.5).A - 2.0 * np.eye(2), PAPER.apart(0.5).B, 0.234)
WEAK = np.tile([[-0.5, -0.5]], (2, 1, 1))  # gains for which the delay of MILD hardly matters
LAW = dt.AveragedPredictor(PAIR, plants.gains(PAIR))


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


def proved(*arguments, **options):
    certificate = dt.certify(*arguments, **options)
    assert certificate.stable is True, certificate.message
    assert certificate.proven
    assert certificate.message.startswith("Stable for every admissible signal")
    assert ", proved: the loop decays" in certificate.message
    evidence, rate = certificate.evidence, certificate.decay_rate
    assert rate == pytest.approx(-math.log(evidence.rho) / evidence.setting.step, rel=1e-9)
    return certificate


def undecided(*arguments, **options):
    certificate = dt.certify(*arguments, **options)
    assert certificate.stable is None
    assert (certificate.proven, certificate.evidence, certificate.statement) == (False, None, ())
    return certificate.message


@cache
def certified(name):
    loop, dwell_time, step = CASES[name]
    plant, law = loop()
    return plant, law, proved(plant, law, dwell_time, step)


def still(evidence):
    """Along a stretch V falls by ρ² per period and by no more: what rounding may take from that."""
    return 1e-9 if isinstance(evidence, StretchEvidence) else 0.0


def assert_steps_decrease(certificate, loop, instants, maximum=None, most=None):
    """P_{i,a} ≻ 0 and P_{i,a} − Mᵀ P_{j,b} M/ρ² ≻ 0 along all steps, or `most` of them."""
    rng, evidence = np.random.default_rng(1), certificate.evidence
    setting = evidence.setting
    last = max(evidence.knots[-1], setting.ages, math.ceil(setting.dwell_time / setting.step)) + 1
    everything = list(steps(loop.plant.modes, setting.dwell_time, setting.step, last, maximum))
    if most:
        everything = [everything[k] for k in rng.permutation(len(everything))[:most]]
    for i, a, j, b in everything:
        before, after = certificate.lyapunov(i, a), certificate.lyapunov(j, b)
        lag = still(evidence) * np.linalg.norm(before) * np.eye(len(before))
        low, high = reference.instants(a, setting.dwell_time, setting.step, maximum)
        for s in (*rng.uniform(low, high, instants).tolist(), high) if j != i else (1,):
            M = loop.step(i, a, j, s)
            assert reference.decreases(before + lag, after, M, evidence.rho), (i, a, j, s)


STEPPED = [
    pytest.param(name, digits, marks=() if name in SMALL else pytest.mark.long)
    for digits in (False, True)
    for name in CASES
]


@pytest.mark.parametrize(("name", "digits"), STEPPED)
def test_every_step_decreases_the_lyapunov_function_in_floats_and_in_fifty_digits(name, digits):
    plant, law, certificate = certified(name)
    most = None if name in SMALL else 1 if digits else 20
    with mpmath.workdps(reference.DIGITS):
        loop = Loop(plant.A, plant.B, plant.delay, law.digital(CASES[name][2]), digits)
        assert_steps_decrease(certificate, loop, 1 if digits else 2, most=most)


def assert_runs_decrease(certificate, plant, law, signal, samples, ages=reference.ages):
    """V falls at every sample of a run from random states and inputs; `ages` of sampled modes."""
    rng, setting = np.random.default_rng(2), certificate.evidence.setting
    x0, u0 = rng.normal(size=plant.states), rng.normal(size=(plant.inputs, setting.past))
    if not setting.inputs:  # V is of the loop once past inputs have arrived
        u0[:] = 0.0
    run = dt.simulate(plant, law, signal, x0, samples * setting.step, setting.step, u0)
    inputs = np.concatenate((u0, run.inputs), axis=1).T
    sampled = signal(np.arange(samples + 1) * setting.step + 1e-12)
    values = []
    for k, age in enumerate(ages(sampled.tolist())):
        past = inputs[k : k + setting.past][::-1]
        xi = np.concatenate((run.states[:, k], past.ravel()))
        xi = xi[: certificate.evidence.setting.order]  # without input the state alone
        values.append(xi @ certificate.lyapunov(int(sampled[k]), age) @ xi)
    assert (np.array(values) > 0.0).all()
    most = certificate.evidence.rho**2 * (1.0 + still(certificate.evidence))
    assert (np.array(values[1:]) / values[:-1] < most).all()


@pytest.mark.parametrize(
    "name", [n if n in SMALL else pytest.param(n, marks=pytest.mark.long) for n in CASES]
)
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


@pytest.mark.parametrize(("alpha", "step"), [(0.66, 0.1), (0.6395, 0.01), (0.806, 0.01), (1, 0.1)])
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


def free(A, step=0.1):
    """A plant without feedback: its loop is the products of the modes' exponentials."""
    plant = dt.SwitchedSystem(A, np.ones((*A.shape[:2], 1)), step)
    none = np.zeros((len(A), 1, A.shape[1]))
    return plant, dt.DelayedStateFeedback(plant, none, allow_unstable=True)


@pytest.mark.parametrize("family", ["commuting", "triangular", "normal"])
def test_where_the_joint_spectral_radius_is_that_of_a_mode_certificates_come_close_to_it(family):
    A = getattr(reference, family)(np.random.default_rng(5))
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
        return reference.worst_multiplier(A, [tau] * 2, [tau + turn] * 2)

    limit, loop = reference.critical(growth, 8.0, 0.2), free(A, 0.05)
    undecided(*loop, 0.99 * limit, 0.05, search_signals=False)
    refuted = dt.certify(*loop, 0.95 * limit, 0.05)
    assert refuted.stable is False
    cycle = list(zip(refuted.witness.modes, refuted.witness.sojourns, strict=True))
    assert reference.multiplier(A, cycle) > 1.0
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


# -- other signals, delays and plants ------------------------------------------------------


def test_an_unstable_mode_that_must_be_left_is_certified_and_not_beyond_the_true_limit():
    A = np.array([[[0.1, 1.0], [-1.0, 0.1]], [[-0.5, 0.3], [-0.3, -0.5]]])
    limit = reference.critical(
        lambda longest: reference.worst_multiplier(A, [1.0, 1.0], [longest] * 2), 3.0, 6.0
    )
    assert limit == pytest.approx(5.0, rel=1e-4)  # by hand: 0.1 · 5 = 0.5 · 1
    plant, law = free(A)
    certificate = proved(plant, law, 1.0, 0.1, maximum_dwell=1.8)
    assert "sojourns last between 1.0 s and 1.8 s" in certificate.statement[0]
    assert dt.certify(plant, law, 1.0, 0.1, maximum_dwell=1.02 * limit).stable is False
    plant, law = designed(PAPER.apart(0.65))
    signal = reference.random_signal(np.random.default_rng(6), 2, 0.2, 12.0, 0.7)
    certificate = proved(plant, law, 0.2, 0.1, maximum_dwell=0.7)
    assert certificate.decay_rate > 0.005
    assert_runs_decrease(certificate, plant, law, dt.SwitchingSignal(*signal), 110)


def test_with_an_average_dwell_time_the_function_falls_along_bursts_of_switches():
    (plant, law), average, chatter = free(ellipses(4.0, 0.8)), 4.0, 2
    certificate = proved(plant, law, average, 0.1, chatter=chatter)
    assert "average dwell time of 4.0 s (at most 2 + T/4.0 s switches" in certificate.statement[0]

    def level(sampled):
        """What is left of the switches that a window may hold, in samples, rounded up."""
        levels = [80]
        for before, now in itertools.pairwise(sampled):
            levels.append(min(80, levels[-1] + 1 - 39 * (before != now)))
        return levels

    signal = reference.bursts(np.random.default_rng(7), 2, average, chatter, 60.0, 0.1)
    assert_runs_decrease(certificate, plant, law, dt.SwitchingSignal(*signal), 590, level)
    # No sojourns of 1 s or more make this loop grow, unequal ones of 1 s on average do.
    A = ellipses(9.0, 1.0)
    assert reference.worst_multiplier(A, [1.0, 1.0], [6.0, 6.0]) < 0.5
    assert max(reference.multiplier(A, [(0, t), (1, 2.0 - t)]) for t in np.arange(0.2, 1, 0.05)) > 1
    assert dt.certify(*free(A), 1.0, 0.1, chatter=2, search_signals=False).stable is None


def test_ranges_of_delays_and_polytopes_of_plants_are_certified_at_every_point_in_them():
    law, low, high = dt.DelayedStateFeedback(MILD, WEAK), 0.2, 0.29  # from φ = 0 to φ = 0.09
    certificate = proved(MILD, law, 0.3, 0.1, delays=(low, high))
    assert f"any constant value in [{low}, {high}] s" in certificate.statement[1]
    assert "every constant delay from 0.2 s to 0.29 s" in certificate.message
    for delay in (low + 1e-9, high, *np.random.default_rng(8).uniform(low, high, 3)):
        loop = Loop(MILD.A, MILD.B, float(delay), law.digital(0.1))
        assert loop.plant.count == 3
        assert_steps_decrease(certificate, loop, 2)
    factors = ((1.0, 1.0), (1.1, 1.0), (1.0, 0.9))
    corners = [dt.SwitchedSystem(a * MILD.A, b * MILD.B, MILD.delay) for a, b in factors]
    law = dt.AveragedPredictor(MILD, WEAK)
    certificate = proved(corners, law, 0.3, 0.1)
    assert "any plant in the polytope" in certificate.statement[0]
    assert "and every plant in the polytope" in certificate.message
    for weights in (*np.eye(3), *np.random.default_rng(9).dirichlet(np.ones(3), 3)):
        a, b = weights @ factors
        loop = Loop(a * MILD.A, b * MILD.B, MILD.delay, law.digital(0.1))
        assert_steps_decrease(certificate, loop, 2)


# -- the graph of steps --------------------------------------------------------------------


@pytest.mark.parametrize("longest", [None, 0.93, 0.9])
@pytest.mark.parametrize("dwell_time", [0.11, 0.17, 0.3, 0.449])
def test_every_step_of_signals_in_real_time_is_in_the_graph(longest, dwell_time):
    rng, most = np.random.default_rng(0), longest or dwell_time + 0.9
    shortest = dwell_time * (1.0 - 0.9e-5)  # by a clock that is off
    times, modes = reference.random_signal(rng, 3, shortest, 40.0, most)
    # From just after a sample to the last one by which the mode may be left; from just before a
    # sample for as long as it may last.
    sample = math.ceil(times[-1] / 0.1 + 5.0) * 0.1
    times += [sample + 1e-7, sample + 1e-7 + shortest]
    end = math.ceil(times[-1] / 0.1 + 5.0) * 0.1 - 1e-7
    times += [end, end + (longest or most) * (1.0 + 0.9e-5)]
    modes += [(modes[-1] + k) % 3 for k in (1, 2, 0, 1)]
    signal = dt.SwitchingSignal(times, modes)
    sampled = signal(np.arange(0.0, times[-1] + 0.2, 0.1) + 1e-12).tolist()
    seen = reference.ages(sampled)
    fractions = {math.floor(t / 0.1 - 1e-12): t / 0.1 % 1.0 for t in times[1:]}
    for context, rows in (("none", 1), ("mode", 1), ("mode_age", 7)):
        graph = Transitions.of(3, (dwell_time, longest), 1, 0.1, 1e-5, context, rows)
        for k, (age, later) in enumerate(itertools.pairwise(seen)):
            (low, high) = graph.switches(0, age, 0)[0].instants if not later and k else (0.0, 1.0)
            assert low <= fractions.get(k, low) <= high
        knots = tuple(sorted({0, graph.last // 3, graph.last}))
        found = reference.by_age(graph.all(knots))
        for (i, j), age, later in zip(itertools.pairwise(sampled), seen, seen[1:], strict=False):
            row = {"none": 0, "mode": i, "mode_age": i * rows + min(age, rows - 1)}[context]
            step = (i, min(age, graph.last), row, j, min(later, graph.last))
            assert reference.covered(found, knots, step, interpolation), step
        assert any(age == graph.first and not later for age, later in itertools.pairwise(seen))


@pytest.mark.parametrize("chatter", [2, 3])
@pytest.mark.parametrize("average", [0.17, 0.3, 0.75])
def test_every_step_of_bursts_within_an_average_dwell_time_is_in_the_graph(average, chatter):
    graph = Transitions.of(3, (average, None), chatter, 0.1, 1e-5, "mode", 1)
    knots, level = tuple(sorted({0, graph.last // 2, graph.last})), graph.last
    found = reference.by_age(graph.all(knots))
    signal = reference.bursts(np.random.default_rng(1), 3, average, chatter, 60.0, 0.1)
    assert -1e-9 <= reference.room(signal[0], average, chatter) < 0.1
    sampled = dt.SwitchingSignal(*signal)(np.arange(600) * 0.1 + 1e-12)
    for i, j in itertools.pairwise(sampled.tolist()):
        after = min(level + 1, graph.last) if i == j else level - graph.bucket
        assert reference.covered(found, knots, (i, level, i, j, after), interpolation)
        level = after


# -- what is left open, and what is refused ------------------------------------------------


def test_loops_out_of_reach_are_left_open_with_the_reason():
    oracle = dt.ExactPredictor(PAIR, plants.gains(PAIR))
    assert "foresees the signal" in undecided(PAIR, oracle, 0.3, 0.1)
    rule = dt.HalfSpace([1.0, 0.0], 0.0)
    dependent = dt.StateDependentPredictor(PAIR, plants.gains(PAIR), rule)
    assert "is no table but a nonlinear law" in undecided(PAIR, dependent, 0.3, 0.1)
    assert "is not above one period of 0.1 s" in undecided(PAIR, LAW, 0.09, 0.1)
    assert "two switches may fall into a step" in undecided(PAIR, LAW, 0.1, 0.1)
    message = undecided(PAPER, designed(PAPER)[1], 0.3, 0.0003)
    assert re.search(r"has order 3,336: .* take about \d+\.\d GB and \d+ min, and 3,000", message)
    proved(*designed(ALONE), 0.05, 0.1)  # one mode needs no dwell time


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"maximum_dwell": 0.29}, "maximum_dwell must be at least dwell_time = 0.3 s, got 0.29"),
        ({"chatter": 2, "maximum_dwell": 1.0}, "chatter > 1 and maximum_dwell exclude each other"),
        ({"chatter": 0}, "chatter must be"),
        ({"decay_rate": -0.1}, "decay_rate must be ≥ 0"),
        ({"delays": (0.25, 0.21)}, "delays must ascend"),
        ({"delays": (0.19, 0.21)}, "delays must lie within one period"),
        ({"delays": (0.0, 0.1)}, "delays must be"),
        ({"dwell_time": 0.0}, "dwell_time must be"),
        ({"clock_tolerance": 0.0}, "clock_tolerance must be a part from 1e-08 to 0.1, got 0"),
        ({"step": -0.1}, "step must be"),
        ({"plant": GENERIC}, "law must be made for a plant with 3 modes, got a law for 2"),
        ({"plant": [PAIR, with_delay(PAIR, 0.2)]}, "one delay at all corners"),
        ({"plant": []}, "plant must be a SwitchedSystem or a sequence of them, got none"),
    ],
)
def test_malformed_requests_are_refused_by_name(options, message):
    arguments = {"plant": PAIR, "law": LAW, "dwell_time": 0.3, "step": 0.1} | options
    with pytest.raises(ArgumentError, match=re.escape(message)):
        dt.certify(**arguments)


class PanicError(BaseException):
    """What compiled code raises when it panics: no Exception."""


def panics(cost):
    raise PanicError("index out of bounds")


def says_nan(cost):
    return SimpleNamespace(x=[math.nan] * len(cost), status="Solved")


@pytest.mark.parametrize(("answer", "search"), [(panics, True), (says_nan, False)])
def test_a_solver_that_fails_leaves_the_question_open(monkeypatch, answer, search):
    monkeypatch.setattr(
        "clarabel.DefaultSolver", lambda P, q, *_: SimpleNamespace(solve=lambda: answer(q))
    )
    # Signals are sought at the delays in question, not at the plant's own, where the loop grows.
    far = with_delay(PAIR, 0.8)
    assert dt.growth_rate(far, LAW, 0, 0.1) > 0.1
    message = undecided(far, LAW, 0.3, 0.1, delays=(0.23, 0.24), search_signals=search)
    assert message.startswith("Inconclusive: no Lyapunov function of the kinds tried was found")
