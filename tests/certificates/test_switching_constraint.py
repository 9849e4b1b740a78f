"""Certificates and worst signals where not every switch and not every sojourn is allowed.

The maps over a period, the words and the signals are made here; the joint spectral radius is the
published one.
"""

import dataclasses
import itertools
import json
import math
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm, logm

import deadtime as dt
from certificate_reference import rewritten
from deadtime.certificates.proof import check
from deadtime.certificates.proof.transitions import SwitchGraph

VERIFY = Path(__file__).parents[2] / "verifier/verify.py"
H, DELAYS, DWELL = 0.1, [0.13, 0.27], [0.3, 0.6, 0.3]
THROUGH = [[0, 1, 0], [1, 0, 1], [0, 1, 0]]  # from 0 to 2 and back only through 1, which damps
A = np.array([[[0.0, 1], [-10, -1]], [[-2, 1], [-1, -2]], [[0, 1], [-0.1, -0.5]]])
B = np.array([[[0.0, 0.3], [1, 0]], [[0.2, 0], [0, 1]], [[0, 0.2], [1, 0.1]]])
K = np.array([[[-0.1, -0.1], [-0.1, 0]]] * 3)
PLANT = dt.SwitchedSystem(A, B, DELAYS)
LAW = dt.DelayedStateFeedback(PLANT, K, allow_unstable=True)


@pytest.fixture(scope="module")
def certificate():
    return dt.certify(PLANT, LAW, DWELL, H, transitions=THROUGH, decay_rate=0.02)


@pytest.fixture(scope="module")
def worst():
    longest = [1.2, 1.2, 1.8]
    return dt.falsify(PLANT, LAW, DWELL, H, maximum_dwell=longest, transitions=THROUGH)


def period(mode):
    """The loop's map over a period without a switch, of (x, u₋₁, u₋₂, u₋₃)."""
    held = {0: [(0.03, 2), (0.07, 1)], 1: [(0.07, 3), (0.03, 2)]}  # seconds, samples ago
    n, Phi = 2, expm(A[mode] * H)
    M = np.zeros((8, 8))
    M[:n, :n] = Phi
    for j, parts in held.items():
        rest = H
        for seconds, ago in parts:
            rest -= seconds
            block = np.zeros((3, 3))
            block[:2, :2], block[:2, 2] = A[mode], B[mode][:, j]
            M[:n, 2 * ago + j] += expm(A[mode] * rest) @ expm(block * seconds)[:2, 2]
    M[2:4, :2] = K[mode]
    M[4:, 2:6] = np.eye(4)
    return M


def growth(word):
    """Of a cycle of (mode, periods), 1/s."""
    M = np.eye(8)
    for mode, count in word:
        M = np.linalg.matrix_power(period(mode), count) @ M
    return math.log(np.abs(np.linalg.eigvals(M)).max()) / (H * sum(count for _, count in word))


def drawn(rng, seconds):
    """An admissible signal that is mostly as short as it may be."""
    times, modes = [0.0], [int(rng.integers(3))]
    while times[-1] < seconds:
        mode = modes[-1]
        times.append(times[-1] + DWELL[mode] + rng.choice([0.0, rng.exponential(0.5)]))
        modes.append(int(rng.choice(np.flatnonzero(THROUGH[mode]))))
    return dt.SwitchingSignal(times, modes)


def by_the_second_verifier(path):
    found = subprocess.run([sys.executable, "-I", str(VERIFY), str(path)], capture_output=True)
    return found.returncode == 0


def without_ways(setting):
    """The same for all switches."""
    free = dataclasses.replace(setting.signals, transitions=None)
    return dataclasses.replace(setting, signals=free)


# -- what is proved ------------------------------------------------------------------------------


def test_a_coarse_loop_is_proved_for_its_graph_by_both_verifiers_and_for_no_other(tmp_path):
    plant = dt.SwitchedSystem(A, B[:, :, 1:], 0.1)
    law = dt.DelayedStateFeedback(plant, K[:, 1:], allow_unstable=True)
    found = dt.certify(plant, law, DWELL, 0.15, transitions=THROUGH, decay_rate=0.02)
    assert found.proven
    free = dt.falsify(plant, law, DWELL, 0.15, budget=500)
    assert free.proven
    assert set(free.modes) == {0, 2}
    setting = without_ways(found.evidence.setting)
    assert not check(dataclasses.replace(found.evidence, setting=setting)).proven
    path = found.save(tmp_path / "cert.json")
    assert dt.verify(path, dwell_time=DWELL, transitions=THROUGH).proven
    assert by_the_second_verifier(path)
    for values in FORGERIES[:2]:
        found.save(path)
        rewritten(path, "signals", values)
        assert not dt.verify(path).proven
        assert not by_the_second_verifier(path)


@pytest.mark.long
def test_a_loop_that_a_forbidden_switch_would_destabilise_is_proved(certificate, worst):
    assert certificate.stable
    assert certificate.proven
    free = dt.falsify(PLANT, LAW, DWELL, H, budget=4_000)
    assert free.proven
    assert set(free.modes) == {0, 2}
    assert worst.growth_rate <= -certificate.decay_rate
    said = "switches only so: from mode 0 to 1, from mode 1 to 0 or 2, from mode 2 to 1"
    assert said in certificate.statement[0]


@pytest.mark.long
def test_v_falls_along_admissible_runs_as_it_claims(certificate):
    rho, rng = certificate.evidence.rho, np.random.default_rng(0)
    known = {}
    for _ in range(4):
        signal, x0 = drawn(rng, 8.0), rng.normal(size=2)
        signal.require_within(dt.SignalClass(DWELL, transitions=THROUGH).limits(3))
        run = dt.simulate(PLANT, LAW, signal, x0, 8.0, H, u0=rng.normal(size=(2, 3)))
        past = [run.inputs[:, k] for k in range(80)]
        before, age = None, 0
        for k in range(4, 80):
            mode = int(signal([k * H + 1e-9])[0])
            age = age + 1 if mode == int(signal([(k - 1) * H + 1e-9])[0]) else 0
            if k < 12:
                continue  # the age is known once a switch was seen
            key = mode, min(age, certificate.evidence.setting.transitions.clocks[mode].last)
            known.setdefault(key, certificate.lyapunov(*key))
            xi = np.concatenate((run.states[:, k], past[k - 1], past[k - 2], past[k - 3]))
            V = xi @ known[key] @ xi
            assert V > 0.0
            assert before is None or before * rho**2 * (1.0 + 1e-9) > V
            before = V


FORGERIES = [
    {"transitions": [[0, 1, 1], [1, 0, 1], [0, 1, 0]]},
    {"dwell_time": 0.3},
    {"dwell_time": [0.3, 0.3, 0.3]},
    # The file of a loop is one: left out where it allows all.
    {"transitions": (np.ones((3, 3), int) - np.eye(3, dtype=int)).tolist()},
    {"transitions": [[1, 1, 0], [1, 0, 1], [0, 1, 0]]},
    {"transitions": [[0, 1], [1, 0]]},
    {"transitions": [[0, 1, 0], [1, 0, 1], [0, 0.5, 0]]},
    {"transitions": [[0, 0, 0], [1, 0, 1], [0, 1, 0]], "maximum_dwell": 2.0},
    {"dwell_time": [0.3, 0.6]},
    {"dwell_time": [0.3, None, 0.3]},
    {"maximum_dwell": [None, 0.5, 0.2]},
    {"chatter": 2},
]


@pytest.mark.long
@pytest.mark.parametrize("values", FORGERIES, ids=str)
def test_neither_verifier_proves_a_file_that_allows_more(certificate, tmp_path, values):
    path = certificate.save(tmp_path / "cert.json")
    rewritten(path, "signals", values)
    try:
        proven = dt.verify(path).proven
    except dt.CertificateFileError:
        proven = False
    assert not proven
    assert not by_the_second_verifier(path)


@pytest.mark.long
def test_both_verifiers_prove_the_file_for_what_it_allows(certificate, tmp_path):
    path = certificate.save(tmp_path / "cert.json")
    asked = {"step": H, "dwell_time": DWELL, "transitions": THROUGH}
    assert dt.verify(path, PLANT, LAW, **asked).proven
    assert by_the_second_verifier(path)
    more = dt.verify(path, PLANT, LAW, step=H, dwell_time=DWELL).message
    assert "not for a switch from mode 0 to mode 2" in more
    shorter = dt.verify(path, dwell_time=[0.3, 0.5, 0.3], transitions=THROUGH)
    assert "not 0.5 s in mode 1" in shorter.message
    content = json.loads(path.read_text())
    assert content["signals"]["transitions"] == THROUGH


@pytest.mark.long
def test_a_proof_for_one_graph_is_none_for_another(certificate):
    setting = without_ways(certificate.evidence.setting)
    assert not check(dataclasses.replace(certificate.evidence, setting=setting)).proven


@pytest.mark.parametrize("longest", [pytest.param(math.inf, marks=pytest.mark.long), 0.9])
def test_stretches_hold_each_mode_s_own_ages(longest, tmp_path):
    idle = dt.SwitchedSystem(A, np.zeros((3, 2, 1)), 0.1)
    law = dt.SingleModePredictor(idle, np.zeros((3, 1, 2)), 0, allow_unstable=True)
    options = {"transitions": THROUGH, "maximum_dwell": [math.inf, math.inf, longest]}
    found = dt.certify(idle, law, DWELL, H, decay_rate=0.02, **options)
    assert found.proven
    assert found.evidence.P.ndim == 4
    path = found.save(tmp_path / "cert.json")
    assert dt.verify(path, dwell_time=DWELL, **options).proven
    assert by_the_second_verifier(path)
    rewritten(path, "signals", {"dwell_time": [0.3, 0.2, 0.3]})
    assert not dt.verify(path).proven
    assert not by_the_second_verifier(path)


# -- what is searched ----------------------------------------------------------------------------


@pytest.mark.long
def test_no_word_that_is_enumerated_grows_faster_than_the_worst_one(certificate, worst):
    lengths = {0: (3, 4, 5, 6, 8), 1: (6, 7), 2: (3, 6, 9, 14, 18)}
    rates = [
        growth(list(zip(word, counts, strict=True)))
        for word in ((0, 1), (1, 2), (0, 1, 2, 1))
        for counts in itertools.product(*(lengths[i] for i in word))
    ]
    assert max(rates) < -certificate.decay_rate
    assert worst.growth_rate >= max(rates) - 1e-9
    assert growth([(0, 5), (2, 14)]) > 0.3  # what the graph forbids
    fastest = [(i, round(s / H)) for i, s in zip(worst.modes, worst.sojourns, strict=True)]
    assert growth(fastest) == pytest.approx(worst.growth_rate, abs=0.05)  # moved onto samples


def test_a_witness_is_admissible_and_grows_as_it_says():
    longest, back = [0.5, 1.5, math.inf], [[0, 1, 1], [1, 0, 0], [1, 0, 0]]
    options = {"maximum_dwell": longest, "transitions": back}
    found = dt.falsify(PLANT, LAW, DWELL, H, budget=4_000, **options)
    assert found.proven
    assert 2 in found.modes
    found.signal.require_within(dt.SignalClass(DWELL, **options).limits(3), tolerance=1.1e-5)
    size = np.linalg.norm(found.simulate(30).states, axis=0)
    assert math.log(size[-1]) / (30 * found.length) == pytest.approx(found.growth_rate, abs=0.05)


def test_a_graph_without_a_way_back_leaves_the_modes_that_last():
    found = dt.falsify(PLANT, LAW, DWELL, H, transitions=[[0, 1, 0], [0, 0, 1], [0, 0, 0]])
    assert found.sojourns == (math.inf,)


@pytest.mark.long
def test_a_law_that_is_run_is_run_along_admissible_cycles_only():
    plant = dt.SwitchedSystem(A, B, 0.1)
    law = dt.StateDependentPredictor(plant, K, lambda x: int(x[0] > 0.0), allow_unstable=True)
    options = {"transitions": [[0, 1, 0], [0, 0, 1], [1, 0, 0]], "maximum_dwell": [0.5, 0.7, 0.9]}
    found = dt.falsify(plant, law, DWELL, H, budget=4_000, **options)
    found.signal.require_within(dt.SignalClass(DWELL, **options).limits(3), tolerance=1.1e-5)


# -- the graph -----------------------------------------------------------------------------------


def test_the_graph_has_the_steps_of_every_mode_s_own_sojourns():
    h, least, most = Fraction(1, 10), (0.23, 0.3, 0.52), (0.5, None, 0.6)
    ways = [[0, 1, 0], [1, 0, 1], [1, 0, 0]]
    signals = dt.SignalClass(least, [x or math.inf for x in most], ways)
    graph = SwitchGraph.of(3, signals, 0.1, "mode", 1)
    seen = {(t.mode, t.age, t.after): t.instants for t in graph.all((0,))}
    slack = Fraction(1, 10**5)
    for mode, (low, high) in enumerate(zip(least, most, strict=True)):
        shortest = Fraction(repr(low)) * (1 - slack)
        longest = None if high is None else Fraction(repr(high)) * (1 + slack)
        parts = [Fraction(1, 10**6), *(Fraction(k, 20) for k in range(1, 21))]
        allowed = {
            (q, s2)
            for q, s1, s2 in itertools.product(range(8), parts, parts)
            if (q + 1 - s1 + s2) * h >= shortest
            and (longest is None or (q + 1 - s1 + s2) * h <= longest)
        }
        clock = graph.clocks[mode]
        for q, s2 in allowed:
            if longest is not None:
                assert clock.first <= q <= clock.last
            age = min(q, clock.last)
            for after in graph.following[mode]:
                if (mode, age, after) in seen and q in (clock.first, clock.last):
                    first, latest = seen[mode, age, after]
                    assert first <= float(s2) <= latest or (longest is None and q > clock.last)
        assert min(q for q, _ in allowed) == clock.first
    assert {(t.mode, t.after) for t in graph.all((0,)) if t.switches} == {
        (0, 1), (1, 0), (1, 2), (2, 0)
    }  # fmt: skip


# -- the constrained joint spectral radius -------------------------------------------------------


def failing_controller(depth):
    """Philippe, Essick, Dullerud and Jungers (Automatica 72, 2016), section 4, in unit sojourns.

    Channels of u = Kx fail, none twice in a row: products of four matrices, of which `depth`
    labels are remembered by a mode. A mode that would follow itself is there twice.
    """
    plant, k = np.array([[0.94, 0.56], [0.14, 0.46]]), np.array([-0.49, 0.27])
    kept = ([1, 1], [0, 1], [1, 0], [0, 0])
    once = [[np.add(a, b).min() > 0 for b in kept] for a in kept]  # no channel fails twice
    may = [np.flatnonzero(row).tolist() for row in once]
    words = [
        w
        for w in itertools.product(range(4), repeat=depth)
        if all(b in may[a] for a, b in itertools.pairwise(w))
    ]
    after = {w: {(*w[1:], j) for j in may[w[-1]]} for w in words}
    names = [(w, twin) for w in words for twin in range(1 + (w in after[w]))]
    allowed = [[w2 in after[w1] and (w1 != w2 or a != b) for w2, b in names] for w1, a in names]
    matrices = [plant + np.outer([0, 1], k * kept[i]) for i in range(4)]
    rates = [logm(matrices[w[-1]]).real for w, _ in names]
    truth = dt.SwitchedSystem(np.array(rates), np.zeros((len(names), 2, 1)), 0.1)
    law = dt.SingleModePredictor(truth, np.zeros((len(names), 1, 2)), 0, allow_unstable=True)
    return (truth, law, 1.0), {"maximum_dwell": 1.0, "transitions": allowed}


RADIUS = 0.9748171979372074


def test_the_worst_cycle_has_the_constrained_joint_spectral_radius():
    (*loop, dwell), options = failing_controller(1)
    found = dt.falsify(*loop, dwell, 0.25, clock_tolerance=0.0, **options)
    assert math.exp(found.growth_rate) == pytest.approx(RADIUS, abs=1e-14)
    assert len(found.modes) == 8


@pytest.mark.parametrize(
    ("depth", "rate", "step", "gap"),
    [
        pytest.param(2, 0.013, 0.01, 0.013, marks=pytest.mark.long),
        pytest.param(3, 0.0235, 0.001, 0.0021, marks=pytest.mark.long),
    ],
)
def test_a_lyapunov_function_bounds_the_radius_from_above(depth, rate, step, gap):
    (*loop, dwell), options = failing_controller(depth)
    found = dt.certify(*loop, dwell, step, clock_tolerance=1e-8, decay_rate=rate, **options)
    assert found.proven
    assert RADIUS < math.exp(-found.decay_rate) < RADIUS * (1.0 + gap)
