"""Loops that certificates are asked for."""

import math

import numpy as np
import pytest

import certificate_reference as reference
import deadtime as dt
import plants
from certificate_reference import steps
from deadtime.certificates.proof import StretchEvidence

PAPER = dt.problems.paper().plant
# A problem file that is proved in no time.
MILD_FILE = """
[plant]
delay = 0.234
A = [[[-1.5]], [[-1.2]]]
B = [[[1.0]], [[1.3]]]
[gains]
K = [[[-0.5]], [[-0.4]]]
[[law]]
kind = "averaged"
[signal]
kind = "periodic"
modes = [0, 1]
sojourns = [0.5, 0.5]
[run]
x0 = [1.0]
horizon = 3.0
step = 0.1
"""


def with_delay(plant, delay):
    return dt.SwitchedSystem(plant.A, plant.B, delay)


def designed(plant, poles=(-1.0, -2.0)):
    return plant, dt.AveragedPredictor(plant, dt.place(plant, poles))


GENERIC = plants.generic().apart(0.05)  # three modes, three states, two inputs, N = 3
PAIR = with_delay(PAPER.apart(0.3), 0.234)  # with a step of 0.1, N = 3 and φ = 0.034
ALONE = dt.SwitchedSystem(PAIR.A[:1], PAIR.B[:1], 0.234)
MILD = dt.SwitchedSystem(PAPER.apart(0.5).A - 2.0 * np.eye(2), PAPER.apart(0.5).B, 0.234)
WEAK = np.tile([[-0.5, -0.5]], (2, 1, 1))  # gains for which the delay of MILD hardly matters


def proved(*arguments, **options):
    certificate = dt.certify(*arguments, **options)
    assert certificate.stable is True, certificate.message
    assert certificate.proven
    assert certificate.message.startswith("Stable for every admissible switching signal")
    assert ", proved: the loop decays" in certificate.message
    evidence, rate = certificate.evidence, certificate.decay_rate
    assert rate == pytest.approx(-math.log(evidence.rho) / evidence.setting.step, rel=1e-9)
    return certificate


def undecided(*arguments, **options):
    certificate = dt.certify(*arguments, **options)
    assert certificate.stable is None
    assert (certificate.proven, certificate.evidence, certificate.statement) == (False, None, ())
    return certificate.message


def still(evidence):
    """Along a stretch V falls by ρ² per period and by no more: what rounding may take from that."""
    return 1e-9 if isinstance(evidence, StretchEvidence) else 0.0


def assert_steps_decrease(certificate, loop, instants, maximum=None, most=None):
    """P_{i,a} ≻ 0 and P_{i,a} − Mᵀ P_{j,b} M/ρ² ≻ 0 along all steps, or `most` of them."""
    rng, evidence = np.random.default_rng(1), certificate.evidence
    setting, dwell_time = evidence.setting, evidence.setting.signals.dwell_time
    last = max(evidence.knots[-1], setting.ages, math.ceil(dwell_time / setting.step)) + 1
    everything = list(steps(loop.plant.modes, dwell_time, setting.step, last, maximum))
    if most:
        everything = [everything[k] for k in rng.permutation(len(everything))[:most]]
    for i, a, j, b in everything:
        before, after = certificate.lyapunov(i, a), certificate.lyapunov(j, b)
        lag = still(evidence) * np.linalg.norm(before) * np.eye(len(before))
        low, high = reference.instants(a, dwell_time, setting.step, maximum)
        for s in (*rng.uniform(low, high, instants).tolist(), high) if j != i else (1,):
            M = loop.step(i, a, j, s)
            assert reference.decreases(before + lag, after, M, evidence.rho), (i, a, j, s)


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


def free(A, step=0.1):
    """A plant without feedback: its loop is the products of the modes' exponentials."""
    plant = dt.SwitchedSystem(A, np.ones((*A.shape[:2], 1)), step)
    none = np.zeros((len(A), 1, A.shape[1]))
    return plant, dt.DelayedStateFeedback(plant, none, allow_unstable=True)
