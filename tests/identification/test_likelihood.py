"""Likelihoods against the dense Gaussian of the whole log, and scores against differences."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from deadtime.identification.likelihoods.likelihood import ExactLog, concentrated
from deadtime.identification.likelihoods.noisy_log import NoiseLevels, NoisyLog
from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import Layout
from deadtime.identification.sampling import UsablePeriods, nodes_for, sampling_of
from deadtime.identification.scoring import Climb, Evaluation, climb, climb_cells
from deadtime.identification.transition import transitions_of
from synthetic_logs import Plant, oscillator

H, T = 0.05, 40


def normal(mean, cov) -> Any:
    return multivariate_normal(mean, cov)


RNG = np.random.default_rng(3)
TRUE = oscillator()
MODE = (np.arange(T) // 7) % 2
EVEN = H * np.arange(T)
JITTER = EVEN + RNG.uniform(-0.3, 0.3, T) * H
LAYOUT = Layout(2, 2, 1, per_mode=False)
THETA = LAYOUT.join(1.05 * TRUE.A, 0.9 * TRUE.B, np.full((2, 1), 0.324))
SENSOR = np.array([0.02, 0.05])


def recording(t, mode=MODE):
    y, u = TRUE.log(t, RNG.standard_normal((T, 1)), RNG, mode, SENSOR)
    even = t is EVEN
    return Recording((Part(t, y, u, mode),), H, even, ("x1", "x2"), ("u",), ("0", "1"), True)


LOG = recording(EVEN)
UNEVEN = recording(JITTER)


def exact(record, bounds=(0.25, 0.4)):
    return ExactLog(record, LAYOUT, False, bounds, nodes_for(record.parts, TRUE.A))


def dense(record, theta, first, start, noise, sensor):
    """Log density of all measurements from sample `first` on, the state there N(0, start)."""
    A, B, delays = LAYOUT.split(theta)
    plant = Plant(A, B, delays, noise)
    part = record.parts[0]
    n, count = 2, T - first
    mean, cov = np.zeros((count, n)), np.zeros((count, n, count, n))
    cov[0, :, 0] = start
    for k in range(count - 1):
        Phi, added = plant.period(part.time, part.input, part.mode, first + k)
        mean[k + 1] = Phi @ mean[k] + added
        for j in range(k + 1):
            cov[k + 1, :, j] = Phi @ cov[k, :, j]
            cov[j, :, k + 1] = cov[k + 1, :, j].T
        length = round(part.time[first + k + 1] - part.time[first + k], 13)
        own = Phi @ cov[k, :, k] @ Phi.T
        cov[k + 1, :, k + 1] = own + plant.covariance(part.mode[first + k], length)
    y = part.output[first:].ravel()
    cov = cov.reshape(y.size, y.size) + np.diag(np.tile(sensor**2, count))
    known = np.isfinite(y)
    return normal(mean.ravel()[known], cov[np.ix_(known, known)]).logpdf(y[known])


def slopes(value, theta, size):
    """Central differences, extrapolated to a step of 0."""
    result = np.empty(theta.size)
    for a, step in enumerate(size):
        d = [
            (value(theta + s * e) - value(theta - s * e)) / (2.0 * s)
            for s in (step, 0.5 * step)
            for e in [np.eye(theta.size)[a]]
        ]
        result[a] = (4.0 * d[1] - d[0]) / 3.0
    return result


def test_the_largest_likelihood_over_the_covariance_is_the_normal_density_of_the_residuals():
    log = exact(LOG)
    terms = log.terms_in(0.3, 0.35)(np.array([7]))(THETA)
    found, S = concentrated(terms, LAYOUT.size)
    part, total = LOG.parts[0], 0.0
    plant = Plant(*LAYOUT.split(THETA))
    for k in range(7, T - 1):
        Phi, added = plant.period(part.time, part.input, part.mode, k)
        expected = Phi @ part.output[k] + added
        total += normal(expected, S[part.mode[k]]).logpdf(part.output[k + 1])
    assert found.value == pytest.approx(total, rel=1e-8)  # S has 1e-8 of it added


@pytest.mark.parametrize("record", [LOG, UNEVEN], ids=["even", "uneven"])
def test_the_score_of_exact_states_is_the_derivative(record):
    evaluate = exact(record).evaluate_in(0.3, 0.35)(np.array([7]))
    size = 1e-3 / np.sqrt(np.diagonal(evaluate(THETA).information))
    by_hand = slopes(lambda theta: evaluate(theta).value, THETA, 10.0 * size)
    assert np.abs((evaluate(THETA).score - by_hand) * size).max() < 1e-9


def terms_of(record, periods=None):
    """How a record is sampled, its periods for delays in cell 7, and the regressions over some."""
    sampling, window = sampling_of(record, nodes_for(record.parts, TRUE.A)), (6.0 * H, 7.0 * H)
    k = sampling_of(LOG, sampling.nodes).usable(LOG.parts[0], True, *window)
    usable = UsablePeriods(record.parts, [k])
    found = sampling.terms_in(LAYOUT, periods or usable, window)(np.array([7]))(THETA)
    return sampling, usable, found


def test_sums_of_an_even_log_tell_what_its_samples_tell():
    part = LOG.parts[0]
    sampling, usable, terms = terms_of(LOG)
    (k,), own = usable.k, np.array([7])
    by_sample = [
        term._replace(root=sampling.rows(part, k[part.mode[k] == i], own, False))
        for i, term in enumerate(terms)
    ]
    one, S = concentrated(terms, LAYOUT.size)
    other, S_other = concentrated(by_sample, LAYOUT.size)
    assert one.value == pytest.approx(other.value, rel=1e-10)
    np.testing.assert_allclose(one.score, other.score, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(S, S_other, rtol=1e-10)


def test_an_even_log_may_be_taken_for_an_uneven_one():
    even, S = concentrated(terms_of(LOG)[2], LAYOUT.size)
    uneven, S_uneven = concentrated(terms_of(LOG._replace(even=False))[2], LAYOUT.size)
    assert even.value == pytest.approx(uneven.value, rel=1e-10)
    np.testing.assert_allclose(even.score, uneven.score, rtol=1e-9)
    np.testing.assert_allclose(even.information, uneven.information, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(S, S_uneven, rtol=1e-8)  # so much of it is added


def test_the_same_uneven_log_six_times_tells_six_times_as_much():
    """Their rows are more than a root has, so that they are gathered."""
    every = [UsablePeriods(UNEVEN.parts * n, [np.arange(7, T - 1)] * n) for n in (1, 6)]
    once, six = (concentrated(terms_of(UNEVEN, own)[2], LAYOUT.size) for own in every)
    assert six[0].value == pytest.approx(6.0 * once[0].value, rel=1e-10)
    np.testing.assert_allclose(six[0].score, 6.0 * once[0].score, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(six[1], once[1], rtol=1e-10)


@pytest.mark.parametrize("record", [LOG, UNEVEN], ids=["even", "uneven"])
def test_weights_of_one_and_zero_are_modes_that_were_logged(record):
    part = record.parts[0]
    _, usable, terms = terms_of(record)
    weight = np.eye(2)[part.mode[usable.k[0]]]
    weighted = terms_of(record, usable._replace(weight=weight))[2]
    (one, S), (other, S_other) = (concentrated(each, LAYOUT.size) for each in (terms, weighted))
    assert one.value == pytest.approx(other.value, rel=1e-10)
    np.testing.assert_allclose(one.score, other.score, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(S, S_other, rtol=1e-10)


@pytest.mark.parametrize("record", [LOG, UNEVEN], ids=["even", "uneven"])
def test_a_period_of_weight_two_counts_as_if_it_were_logged_twice(record):
    _, usable, _ = terms_of(record)
    weight = 2.0 * np.eye(2)[record.parts[0].mode[usable.k[0]]]
    twice = UsablePeriods(record.parts * 2, usable.k * 2)
    own = usable._replace(weight=weight), twice
    one, other = (concentrated(terms_of(record, each)[2], LAYOUT.size) for each in own)
    assert one[0].value == pytest.approx(other[0].value, rel=1e-10)
    np.testing.assert_allclose(one[0].score, other[0].score, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(one[1], other[1], rtol=1e-10)


@pytest.mark.parametrize("record", [LOG, UNEVEN], ids=["even", "uneven"])
@pytest.mark.parametrize("missing", [False, True])
def test_the_likelihood_of_noisy_states_is_the_dense_gaussian_of_the_whole_log(record, missing):
    part = record.parts[0]
    output = part.output.copy()
    if missing:
        output[[12, 20, 21], [0, 1, 1]] = np.nan
        output[30] = np.nan
    record = record._replace(parts=(part._replace(output=output),))
    nodes = nodes_for(record.parts, TRUE.A)
    log = NoisyLog(record, LAYOUT, False, (0.25, 0.4), nodes, np.eye(2))
    W = np.array([[2e-3, 5e-4], [5e-4, 1e-3]])
    starts = log.starts(0.3, 0.35)
    first = int(np.flatnonzero(starts[0])[-1])
    assert starts[0][: first + 1].all()
    alone = record._replace(parts=(Part(*(column for column in record.parts[0])),))
    log = NoisyLog(alone, LAYOUT, False, (0.25, 0.4), nodes, np.eye(2))
    vector = log.join(THETA, NoiseLevels(W, SENSOR))
    found = log.value(vector, starts)
    before = 0.0  # samples of which nothing before is known: each on its own
    for k in range(first):
        known = np.isfinite(output[k])
        cov = (log.P0 + np.diag(SENSOR**2))[np.ix_(known, known)]
        before += normal(np.zeros(known.sum()), cov).logpdf(output[k][known])
    whole = dense(record, THETA, first, log.P0, W, SENSOR)
    assert found - before == pytest.approx(whole, rel=1e-9)


def test_scoring_crosses_kinks_to_the_larger_side_and_stays_at_one_that_is_the_top():
    def roof(top):
        def within(cells):
            def value(theta):
                slope = 1.0 if theta[0] < top else -2.0
                inner = 0.5 * (2 * cells[0] - 1)
                slope = 1.0 if inner < top else -2.0
                D = theta[0] - top
                return Evaluation(slope * D - 0.1 * D**2, np.array([slope - 0.2 * D]), np.eye(1))

            return value

        return within

    free = np.full(1, -np.inf), np.full(1, np.inf)
    best, cells = climb_cells(
        roof(4.0), np.array([1.5]), 1.0, (0.0, 9.0), Climb(slice(0, 1), free, np.zeros(1, bool))
    )
    assert (best.theta[0], cells[0]) == (4.0, 4)
    start = np.array([1.0])
    done = climb(
        lambda x: Evaluation(-((x[0] - 3.0) ** 4), -4 * (x - 3.0) ** 3, 12 * np.eye(1)),
        start,
        np.array([-9.0]),
        np.array([2.0]),
    )
    assert done.theta[0] == 2.0
    assert done.bound.all()


@pytest.mark.parametrize("A", [[[1e4]], [[0.0, 1.0], [0.0, 9e4]], [[1e3, -1e5], [1e5, 1e3]]])
def test_a_trial_far_out_overflows_without_a_warning_and_is_no_maximum(A):
    over = transitions_of(np.array(A), np.array([0.1, 1.0]))
    assert not np.isfinite(over.Phi).all()
