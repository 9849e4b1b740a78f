"""Score and information of noisy logs against those of the dense Gaussian of the whole log."""

import dataclasses
import tracemalloc

import numpy as np
import pytest
from scipy.linalg import expm

from deadtime.identification.likelihoods.noisy_log import Embedding, NoiseLevels, NoisyLog
from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import Layout
from deadtime.identification.sampling import nodes_for
from synthetic_logs import Plant

H, T = 0.05, 32
A = np.array([[[0.0, 1.0], [-2.0, -1.0]], [[0.0, 1.0], [-3.0, -0.5]]])
B = np.array([[[0.2, 1.0], [1.0, -0.5]], [[0.1, 0.7], [1.2, 0.3]]])
D = np.array([[0.112, 0.184], [0.137, 0.061]])  # of every mode and input
LAYOUT = Layout(2, 2, 2, per_mode=True)
C = np.array([[1.0, 0.2], [0.1, -0.9]])
NOISE = NoiseLevels(np.array([[2e-3, 5e-4], [5e-4, 1e-3]]), np.array([0.02, 0.05]))
WINDOW = 0.05, 0.2


def made(jitter, lost=0):
    """A log whose outputs are known from sample 6 on, all but some."""
    rng = np.random.default_rng(3)
    t = H * np.arange(T) + jitter * H * rng.uniform(-1.0, 1.0, T)
    mode = (np.arange(T) // 5) % 2
    y, u = Plant(A, B, D, 1e-3 * np.eye(2)).log(t, rng.standard_normal((T, 2)), rng, mode)
    y = y @ C.T + 0.02 * rng.standard_normal((T, 2))
    y[:6], y[[12, 20, 21], [0, 1, 1]], y[25] = np.nan, np.nan, np.nan
    rows = np.delete(np.arange(T), np.arange(14, 14 + lost))
    part = Part(*(column[rows] for column in (t, y, u, mode)))
    even = jitter == 0.0 and lost == 0
    return Recording((part,), H, even, ("y1", "y2"), ("u1", "u2"), ("0", "1"), True)


def added(M, W, length):
    """∫₀^τ e^{As} W e^{Aᵀs} ds, by Van Loan's exponential."""
    E = expm(np.block([[-M, W], [np.zeros((2, 2)), M.T]]) * length)
    return E[2:, 2:].T @ E[:2, 2:]


def dense(log, vector):
    """Errors and variances of all measurements, one after the other, by Cholesky's factor."""
    plant = Plant(*log.layout.split(vector[: log.layout.size]))
    part, noise = log.recording.parts[0], log.noise(vector)
    first, n = int(np.flatnonzero(log.starts(*WINDOW)[0])[-1]), 2
    count = part.time.size - first
    mean, cov = np.zeros((count, n)), np.zeros((count, n, count, n))
    cov[0, :, 0] = log.P0
    for k in range(count - 1):
        mode, length = part.mode[first + k], part.time[first + k + 1] - part.time[first + k]
        Phi, forced = plant.period(part.time, part.input, part.mode, first + k)
        mean[k + 1] = Phi @ mean[k] + forced
        cov[k + 1, :, : k + 1] = np.einsum("ab,bcd->acd", Phi, cov[k, :, : k + 1])
        cov[: k + 1, :, k + 1] = cov[k + 1, :, : k + 1].transpose(1, 2, 0)
        own = Phi @ cov[k, :, k] @ Phi.T
        cov[k + 1, :, k + 1] = own + added(plant.A[mode], noise.W, length)
    whole = np.kron(np.eye(count), log.C)
    S = whole @ cov.reshape(count * n, -1) @ whole.T + np.diag(np.tile(noise.deviation**2, count))
    y = part.output[first:].ravel()
    known = np.isfinite(y)
    root = np.linalg.cholesky(S[np.ix_(known, known)])
    e = np.linalg.solve(root, (y - whole @ mean.ravel())[known]) * np.diagonal(root)
    return np.array([e, np.diagonal(root) ** 2])


def log_of(record):
    return NoisyLog(record, LAYOUT, False, WINDOW, nodes_for(record.parts, A), C)


@pytest.mark.parametrize("block", [4096, 7])
@pytest.mark.parametrize("given", [(0.0, 0), (0.3, 0), (0.0, 1), (0.3, 4)])
def test_value_score_and_information_are_those_of_the_dense_gaussian(given, block, monkeypatch):
    """Even rows, rows at jittered times, one row lost, and four: delays within and across rows.

    What is not known of the first state is small enough that differences have digits left.
    """
    monkeypatch.setattr("deadtime.identification.likelihoods.switched_filter._BLOCK", block)
    monkeypatch.setattr("deadtime.identification.likelihoods.noisy_log._VAGUE", 10.0)
    log = log_of(made(*given))
    theta = LAYOUT.join(1.05 * A, 0.9 * B, D + 0.003)
    vector = log.join(theta, NOISE)
    cells = np.ceil(theta[LAYOUT.at_delays] / H).astype(int)
    found = log.evaluate_in(*WINDOW)(cells)(vector)
    starts = log.starts(*WINDOW)
    assert not starts[0][6:].any()
    assert log.evaluate(vector, starts).value == found.value
    e, s = dense(log, vector)
    value = -0.5 * (np.log(2.0 * np.pi * s) + e * e / s).sum()
    assert found.value == pytest.approx(value, rel=1e-9)
    assert log.value(vector, starts) == pytest.approx(value, rel=1e-9)
    size = 1e-4 * np.where(np.arange(vector.size) < LAYOUT.size - LAYOUT.delays, 1.0, 0.1)
    moved = [dense(log, vector + d) - dense(log, vector - d) for d in np.diag(size)]
    by_e, by_s = np.moveaxis(np.array(moved) / (2.0 * size[:, None, None]), 1, 0)
    score = by_s @ (0.5 * (e * e / s - 1.0) / s) - by_e @ (e / s)
    F = (by_e / s) @ by_e.T + 0.5 * (by_s / s) @ (by_s / s).T
    unit = 1.0 / np.sqrt(np.diagonal(F))
    assert np.abs((found.score - score) * unit).max() < 1e-6
    assert np.abs((found.information - F) * unit * unit[:, None]).max() < 1e-6


@pytest.mark.parametrize("jitter", [0.0, 0.3], ids=["even", "uneven"])
def test_derivatives_by_what_is_unknown_are_the_same_without_those_by_what_is_known(
    jitter, monkeypatch
):
    record = made(jitter)
    (part,) = record.parts
    record = record._replace(parts=(part._replace(output=part.output[:, :1]),), outputs=("y1",))
    shape = Embedding((2,), False, np.array([0.3, 0.5]))
    log = NoisyLog(record, LAYOUT, False, WINDOW, nodes_for(record.parts, A), shape.C, shape)
    vector = log.join(LAYOUT.join(A, B, D), NoiseLevels(np.diag([2e-3, 1e-3]), np.array([0.02])))
    some, starts, free = log.evaluate(vector, log.starts(*WINDOW)), log.starts(*WINDOW), log.free
    assert free.size < log.size
    monkeypatch.setattr(NoisyLog, "free", np.arange(log.size))
    every = dataclasses.replace(log).evaluate(vector, starts)
    assert some.value == every.value
    np.testing.assert_allclose(some.score[free], every.score[free], rtol=1e-10, atol=1e-10)
    own, others = np.ix_(free, free), np.setdiff1d(np.arange(log.size), free)
    np.testing.assert_allclose(some.information[own], every.information[own], rtol=1e-10)
    assert every.information[others].any(axis=1).sum() > others.size // 2
    assert not some.information[others].any()
    assert not some.score[others].any()


def test_an_even_log_may_be_taken_for_an_uneven_one():
    record = made(0.0)
    even, uneven = log_of(record), log_of(record._replace(even=False))
    vector = even.join(LAYOUT.join(A, B, D), NOISE)
    starts = even.starts(*WINDOW)
    one, other = even.evaluate(vector, starts), uneven.evaluate(vector, starts)
    assert one.value == pytest.approx(other.value, rel=1e-11)
    np.testing.assert_allclose(one.score, other.score, rtol=1e-8, atol=1e-8)
    unit = 1.0 / np.sqrt(np.diagonal(one.information))
    off = (one.information - other.information) * unit * unit[:, None]
    assert np.abs(off).max() < 1e-9


@pytest.mark.parametrize("even", [True, False])
def test_memory_does_not_grow_with_the_rows_but_for_a_few_numbers_of_each(even):
    """Derivatives of all samples would be 2 · (24 + 13) numbers a row."""
    peaks, rng = [], np.random.default_rng(0)
    for count in (10_000, 30_000):
        t, noise = H * np.arange(count), rng.standard_normal((count, 4))
        part = Part(t, noise[:, :2].copy(), noise[:, 2:].copy(), np.zeros(count, int))
        log = log_of(Recording((part,), H, even, ("y1", "y2"), ("u1", "u2"), ("0", "1"), True))
        vector, starts = log.join(LAYOUT.join(A, B, D), NOISE), log.starts(*WINDOW)
        assert log.P0[0, 0] > 0.0
        tracemalloc.start()
        assert np.isfinite(log.evaluate(vector, starts).value)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] - peaks[0] < 8 * 4 * 20_000
