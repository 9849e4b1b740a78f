"""Filters of plants whose noise depends on the mode: W of each, switches anywhere."""

import itertools

import numpy as np
import pytest
from scipy.linalg import expm

import belief_laws
import deadtime as dt
import mode_paths
import plants
from batches import H, require_single_runs
from c_code import Library, needs_compiler
from deadtime.imperfections import Noise, WhiteDisturbance
from deadtime.numerics.covariance import noise_covariances, switched_covariances
from shares import mostly_long

STEP = 0.1
DELAYS = [[0.234, 0.1], [0.15, 0.31], [0.05, 0.27]]  # per mode and input, none of them alike
COUPLED = np.array([[0.3, 0.1, 0.0], [0.1, 0.2, 0.05], [0.0, 0.05, 0.4]])
EACH = np.stack([COUPLED, 4.0 * np.diag([0.5, 0.0, 0.1]), 0.1 * COUPLED[::-1, ::-1]])
STD = np.array([0.05, 0.02, 0.1])
LEAST = 1e-18  # of forgetting: below what the sums are compared to
PLANT = plants.generic(DELAYS).apart(0.4)
MODEL = plants.markov(3)


def log_of_a_run(samples=8, seed=5):
    """States and inputs of a noisy run in which each mode is likely somewhere."""
    rng = np.random.default_rng(seed)
    inputs = {k: rng.normal(size=2) for k in range(-4, samples)}
    states, modes = [np.array([1.0, -1.0, 0.5])], [0, 0, 1, 1, 2, 2, 0, 0]
    for k in range(samples - 1):
        x = mode_paths.ahead(PLANT, STEP, modes[k], states[-1], inputs, k)
        states.append(x + 0.15 * rng.normal(size=3))
    return np.array(states), inputs


def beliefs_of(filt, seen, inputs):
    running = filt.start(np.array([inputs[k] for k in range(-filt.longest_lag, 0)]).T)
    return [running.update(x, inputs[k - 1]) for k, x in enumerate(seen)]


@pytest.mark.parametrize("switches", ["anywhere", "samples"])
def test_a_belief_is_the_sum_over_all_paths_of_modes(switches):
    states, inputs = log_of_a_run()
    options = {"switches": switches, "forgetting": LEAST, "noise": STD}
    filt = dt.ModeFilter(PLANT, MODEL, STEP, disturbance=EACH, **options)
    found = beliefs_of(filt, states, inputs)
    density = mode_paths.densities(PLANT, STEP, states, inputs, EACH, STD, switches == "anywhere")
    prior = mode_paths.markov_prior(MODEL.rates, STEP)
    for periods in (1, 2, 4, 7):
        plants.close(found[periods], mode_paths.beliefs(density[:periods], prior), 1e-11)
    mean = dt.ModeFilter(PLANT, MODEL, STEP, disturbance=EACH.mean(axis=0), **options)
    assert np.abs(beliefs_of(mean, states, inputs)[-1] - found[-1]).max() > 0.01


@pytest.mark.parametrize("switches", ["anywhere", "samples"])
def test_of_states_that_are_all_seen_outputs_give_the_same_belief(switches):
    states, inputs = log_of_a_run()
    options = {"disturbance": EACH, "switches": switches}
    plain = dt.ModeFilter(PLANT, MODEL, STEP, **options)
    filt = dt.OutputModeFilter(PLANT, MODEL, STEP, np.eye(3), covariance=1.0, **options)
    found = beliefs_of(filt, states, inputs), beliefs_of(plain, states, inputs)
    plants.close(np.array(found[0]), np.array(found[1]), 1e-9)


def test_what_a_cut_period_adds_is_the_mean_over_its_instant():
    found = switched_covariances(PLANT.A, EACH, STEP)
    for i, j in itertools.permutations(range(3), 2):
        plants.close(found[i, j], mode_paths.switched(PLANT, STEP, i, j, EACH), 1e-10)
    held = noise_covariances(PLANT.A, EACH, np.full(3, STEP))
    plants.close(found[[0, 1, 2], [0, 1, 2]], held, 1e-12)
    stiff = np.array([[[-300.0, 40.0], [0.0, -2.0]], [[-5.0, 0.0], [90.0, -80.0]]])
    W, s = np.array([np.eye(2), np.diag([0.0, 9.0])]), (np.arange(4000) + 0.5) / 4000 * STEP
    Q = [
        noise_covariances(np.repeat(A[None], 4000, 0), w, s) for A, w in zip(stiff, W, strict=True)
    ]
    Phi = np.array([expm(stiff[1] * t) for t in s])
    sums = (Phi @ Q[0][::-1] @ Phi.transpose(0, 2, 1) + Q[1]).mean(axis=0)
    plants.close(switched_covariances(stiff, W, STEP)[0, 1], sums, 1e-4)


def test_one_noise_given_mode_by_mode_is_that_noise():
    one, each = (
        dt.ModeFilter(PLANT, MODEL, STEP, disturbance=W)
        for W in (COUPLED, np.tile(COUPLED, (3, 1, 1)))
    )
    assert np.array_equal(one.disturbance, each.disturbance)
    assert np.array_equal(one.form().noise, each.form().noise)
    own = dt.ModeFilter(PLANT, MODEL, STEP, disturbance=EACH)
    assert np.array_equal(own.disturbance, EACH)
    assert own.form().noise.shape == (3, 3, 3, 3)


def test_a_mode_is_told_by_its_noise_alone():
    """A and B alike: nothing but the size of what a period adds differs."""
    plant = dt.SwitchedSystem(np.full((2, 1, 1), -0.2), np.ones((2, 1, 1)), 0.05)
    W, rng, right = np.array([[[0.01]], [[1.0]]]), np.random.default_rng(1), []
    options = {"disturbance": W, "allow_alike": True}
    running, x = (
        dt.ModeFilter(plant, dt.Markov([[0.0, 0.2], [0.2, 0.0]]), STEP, **options).start(),
        0.0,
    )
    for k in range(400):
        mode = k // 40 % 2
        right.append(running.update([x]).argmax() == (k - 1) // 40 % 2)
        x = np.exp(-0.02) * x + np.sqrt(W[mode, 0, 0] * STEP) * rng.normal()
    assert np.mean(right[1:]) > 0.95


@pytest.mark.few(1)
@pytest.mark.parametrize("of", ["states", "outputs"])
def test_runs_of_a_batch_are_single_runs(of):
    plant = plants.generic(0.3, seed=5)
    plant = dt.SwitchedSystem(plant.A - 1.5 * np.eye(3), plant.B, [0.3, 0.07])
    options = {"disturbance": EACH, "noise": 0.05}
    if of == "states":
        filt = dt.ModeFilter(plant, MODEL, H, **options)
    else:
        C = np.array([[1.0, 0.0, 0.2], [0.0, 1.0, 0.0]])
        filt = dt.OutputModeFilter(plant, MODEL, H, C, covariance=1.0, **options)
    law = dt.BeliefPredictor(dt.ExpectedPredictor(plant, plants.gains(plant), MODEL), filt)
    require_single_runs(plant, {of: law}, [WhiteDisturbance(EACH), Noise(0.02)])


@needs_compiler
@pytest.mark.parametrize("of", mostly_long(["states", "outputs"], "states"))
def test_the_c_answers_as_the_controller(tmp_path, of):
    # A state without noise costs a bank digits in C and Python alike, whatever the others have.
    W, model = 0.1 * EACH + 0.005 * np.eye(3), belief_laws.MARKOV
    if of == "states":
        inner = dt.ExpectedPredictor(belief_laws.PLANT, belief_laws.GAINS, model)
        law = belief_laws.on_belief(inner, model, disturbance=W)
    else:
        law = belief_laws.from_outputs(disturbance=W)
    controller = dt.Controller(law, belief_laws.STEP)
    exported = controller.export_c(tmp_path)
    assert exported.check.passed, exported.check
    assert "MODEL_NOISE[3][3][3][3]" in (tmp_path / "controller_tables.h").read_text()
    library = Library(tmp_path, law.plant)
    library.n = len(law.filter.noise)
    library.reset()
    run = belief_laws.record(law, 3.0)
    for y in run.measured.T:
        found, status = library.run([y], [-7], [None], [None])
        u = controller.update(y)
        assert status[0] == controller.status
        plants.close(found[0], u, 1e-12, np.abs(run.inputs).max())


@pytest.mark.parametrize(
    ("W", "message"),
    [
        (EACH[:2], r"disturbance must have shape \(modes, n, n\)"),
        (EACH * [[[1.0]], [[-1.0]], [[1.0]]], r"disturbance\[1\] must be positive semidefinite"),
        (np.ones((3, 3, 3, 3)), "disturbance must"),
    ],
)
def test_what_is_no_noise_of_every_mode_is_refused(W, message):
    with pytest.raises(dt.ArgumentError, match=message):
        dt.ModeFilter(PLANT, MODEL, STEP, disturbance=W)


@pytest.mark.long
def test_what_is_given_a_probability_happens_as_often_and_not_with_the_mean_noise():
    A = [[[0.0, 1.0], [-2.0, -1.0]], [[0.0, 1.0], [-3.0, -0.5]]]
    plant = dt.SwitchedSystem(A, [[[0.0], [1.0]], [[0.0], [1.2]]], 0.312)
    model, W = (
        dt.Markov([[0.0, 0.8], [1.3, 0.0]]),
        np.array([np.diag([0.0, w]) for w in (1e-4, 1e-2)]),
    )
    inner = dt.ExpectedPredictor(plant, plants.gains(plant), model)
    apart = []
    for own in (W, W.mean(axis=0)):
        law = dt.BeliefPredictor(inner, dt.ModeFilter(plant, model, 0.05, disturbance=own))
        given, there = [], []
        for seed in range(60, 120):
            signal = model.sample(15.0, seed=seed)
            options = {"imperfections": [WhiteDisturbance(W)], "seed": seed}
            run = dt.simulate(plant, law, signal, [0.5, 0.0], 15.0, 0.05, **options)
            given.append(run.belief[1])
            there.append(run.mode)
        given, there = np.ravel(given), np.ravel(there)
        quarter = np.minimum((4.0 * given).astype(int), 3)
        apart.append([abs((there - given)[quarter == q].sum()) / there.size for q in range(4)])
    assert np.sum(apart[0]) < 0.008  # of all samples
    assert np.sum(apart[1]) > 0.02
