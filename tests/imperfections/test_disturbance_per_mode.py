"""White noise whose intensity depends on the mode: exact through every switch."""

import itertools

import numpy as np
import pytest
from scipy.linalg import expm

import deadtime as dt
import plants
from batches import require_single_runs
from by_sample import by_sample
from deadtime.imperfections import Noise, Sizes, WhiteDisturbance
from deadtime.imperfections.base import streams
from deadtime.plant import SampledPlant
from deadtime.simulation.forcing import Forcing
from deadtime.switching.grid import cuts_of
from deadtime.synthesis import StationaryNoise

H, X0 = 0.1, np.array([1.0, -1.0, 0.5])
MODEL = plants.generic()
PLANT = dt.SwitchedSystem(1.03 * MODEL.A, 0.98 * MODEL.B, [0.251, 0.117])
EACH = np.array(
    [
        [[0.5, 0.2, 0.0], [0.2, 0.3, 0.1], [0.0, 0.1, 0.1]],
        np.diag([0.0, 4.0, 0.01]),
        [[0.02, 0.01, 0.0], [0.01, 0.03, 0.0], [0.0, 0.0, 9.0]],
    ]
)
SIGNAL = plants.off_grid()
NODES, WEIGHTS = np.polynomial.legendre.leggauss(20)


def marks_between(begin, end):
    inside = [t for t in SIGNAL.times if begin + 1e-9 < t < end - 1e-9]
    return list(itertools.pairwise([begin, *inside, end]))


def covariance(begin, end, plant=PLANT):
    """∫ Φ(end, t) W_σ(t) Φ(end, t)ᵀ dt, piece by piece, by Gauss and Legendre's rule."""
    total = np.zeros((3, 3))
    for a, b in marks_between(begin, end):
        A, W = plant.A[SIGNAL(0.5 * (a + b))], EACH[SIGNAL(0.5 * (a + b))]
        E = expm(A * (b - a))
        total = E @ total @ E.T
        for s, w in zip(0.5 * (b - a) * (1.0 + NODES), 0.5 * (b - a) * WEIGHTS, strict=True):
            total += w * expm(A * s) @ W @ expm(A * s).T
    return total


def run(*imperfections, **options):
    law = plants.LAWS["averaged"](dt.SwitchedSystem(MODEL.A, MODEL.B, [0.251, 0.117]))
    return dt.simulate(PLANT, law, SIGNAL, X0, 2.0, H, imperfections=imperfections, **options)


@pytest.mark.parametrize("delay", [[0.251, 0.117], [[0.251, 0.1], [0.32, 0.135], [0.08, 0.251]]])
def test_what_a_stretch_adds_has_the_covariance_of_the_modes_that_acted(delay):
    """Of its root, which makes normal numbers of it, too: Cholesky's is the only triangular one."""
    plant = dt.SwitchedSystem(PLANT.A, PLANT.B, delay)
    sampled, one = SampledPlant(plant, H).cut_alike(), WhiteDisturbance(EACH)
    cuts, cut = cuts_of(SIGNAL, sampled), 0
    table, stretches = sampled.along(cuts, 20), sampled.stretches(0)
    lengths = tuple(part.stop - part.start for part in stretches)
    shift, _ = Forcing(sampled, 20, [(one, np.random.default_rng(3))]).along(table, cuts)
    numbers = one.draws(Sizes.of(plant, H), lengths, 20, np.random.default_rng(3))
    for k, (place, part) in itertools.product(range(20), enumerate(stretches)):
        added = np.zeros(3)
        for q in range(table.first[k], table.first[k + 1]):
            if part.start <= table.start[table.entry[q]] < part.stop:
                added = table.Phi[table.entry[q]] @ added + shift[q]
        begin, end = k * H + part.start, k * H + part.stop
        L = np.linalg.cholesky(covariance(begin, end, plant))
        plants.close(added, L @ numbers[k, place], 1e-11, 1.0)
        cut += len(marks_between(begin, end)) > 1
    assert cut >= 4


def test_a_run_is_moved_by_just_that():
    loop, one = run(WhiteDisturbance(EACH), seed=7), WhiteDisturbance(EACH)
    plain = run(seed=7)
    (rng,) = streams([one], 7)
    ends = [0.0, 0.017, 0.051, H]  # arrivals of both inputs
    lengths = tuple(np.diff(ends))
    numbers = one.draws(Sizes.of(PLANT, H), lengths, loop.time.size, rng)
    x = np.zeros(3)
    for k in range(2):  # before an input that the noise has moved arrives
        for place, (a, b) in enumerate(itertools.pairwise(ends)):
            for c, d in marks_between(k * H + a, k * H + b):
                x = expm(PLANT.A[SIGNAL(0.5 * (c + d))] * (d - c)) @ x
            L = np.linalg.cholesky(covariance(k * H + a, k * H + b))
            x = x + L @ numbers[k, place]
        at = np.searchsorted(loop.time, (k + 1) * H - 1e-9)
        plants.close(loop.states[:, at] - plain.states[:, at], x, 1e-11)
    assert np.abs(x).max() > 0.1


def test_compiled_and_step_by_step_runs_agree():
    fast, slow = run(WhiteDisturbance(EACH)), run(WhiteDisturbance(EACH), by_sample(Noise(0.0)))
    plants.close(slow.states, fast.states, 1e-12)
    assert (fast.states != run(WhiteDisturbance(EACH[0])).states).any()


def test_one_noise_given_mode_by_mode_is_that_noise():
    one, each = run(WhiteDisturbance(EACH[0])), run(WhiteDisturbance(np.tile(EACH[:1], (3, 1, 1))))
    assert np.array_equal(one.states, each.states)


def test_runs_of_a_batch_are_single_runs():
    law = plants.LAWS["averaged"](plants.generic([0.3, 0.07], seed=5))
    require_single_runs(PLANT, {"averaged": law}, [WhiteDisturbance(EACH)])


def test_under_stationary_noise_each_mode_has_its_own():
    plant = dt.problems.paper().plant
    law, W = (
        dt.AveragedPredictor(plant, plants.gains(plant)),
        np.array([np.eye(2), np.diag([0.0, 3.0])]),
    )
    found = dt.synthesis.input_peak(plant, law, 0.05, StationaryNoise(W)).level
    for mode in range(2):
        own = dt.synthesis.input_peak(plant, law, 0.05, StationaryNoise(W[mode])).level
        assert np.array_equal(found[mode], own[mode])
    with pytest.raises(dt.ArgumentError, match="process must be one matrix or one for each of 2"):
        dt.synthesis.input_peak(plant, law, 0.05, StationaryNoise(EACH[:, :2, :2]))


@pytest.mark.parametrize(
    ("W", "message"),
    [
        (EACH[:2], r"WhiteDisturbance.intensity must have shape \(modes, n, n\)"),
        (EACH * [[[1.0]], [[-1.0]], [[1.0]]], r"WhiteDisturbance.intensity\[1\] must be positive"),
        (np.ones((2, 3, 3, 3)), "WhiteDisturbance.intensity must"),
    ],
)
def test_what_is_no_noise_of_every_mode_is_refused(W, message):
    with pytest.raises(dt.ArgumentError, match=message):
        run(WhiteDisturbance(W))
