"""The ideal loop where inputs and modes have delays of their own."""

import numpy as np
import pytest
from scipy.linalg import expm

import deadtime as dt
import ideal_residual
from deadtime.simulation.ideal.segments import Shift, pass_on
from shares import mostly_long

SEEDS = range(8)


def random_plant(rng, modes=None):
    modes, n, m = modes or rng.integers(1, 4), rng.integers(1, 4), rng.integers(1, 3)
    A, B = rng.normal(size=(modes, n, n)), rng.normal(size=(modes, n, m))
    return dt.SwitchedSystem(A, B, rng.uniform(0.15, 0.5, (modes, m)))


def random_gains(rng, plant):
    return 0.6 * rng.normal(size=(plant.modes, plant.inputs, plant.states))


def random_signal(rng, plant):
    if plant.modes == 1:
        return dt.SwitchingSignal.constant(0)
    modes = np.arange(4) % plant.modes
    return dt.SwitchingSignal(np.append(0.0, np.cumsum(rng.uniform(0.15, 0.6, 3))), modes)


def other_delays(plant, rng):
    return dt.SwitchedSystem(
        plant.A, plant.B, plant.delays * rng.uniform(0.8, 1.2, plant.delays.shape)
    )


def expected(law, run, t, bends):
    """u(t) by the definition of a law."""
    model, i = law.plant, int(run.signal(np.array([t]))[0])
    if isinstance(law, dt.DelayedStateFeedback):
        return law.gains[i] @ run.record.states_at(np.array([t]))[0]
    if isinstance(law, dt.ExactPredictor):
        believed = list(zip(run.signal.times, run.signal.modes, strict=True))
        parts = model.A, model.B, model.delays
        return ideal_residual.previewed(run, t, believed, parts, law.gains, bends)
    if getattr(law, "dwell_time", None):
        return dwelling(law, run, t, bends)
    one = ideal_residual.feedback
    if isinstance(law, dt.MeanPredictor):
        return one(run, t, *law.mean, model.delays.mean(axis=0), law.gain, bends)
    single = isinstance(law, dt.SingleModePredictor)
    weights = np.eye(model.modes)[law.mode] if single else law.weights
    return sum(
        weights[i] * one(run, t, model.A[i], model.B[i], model.delays[i], law.gains[i], bends)
        for i in np.flatnonzero(weights)
    )


def dwelling(law, run, t, bends):
    """u(t) of a law that trusts the mode for its dwell time."""
    model, mode = law.plant, int(run.signal(np.array([t]))[0])
    until = max(s for s in run.signal.times if s <= t) + law.dwell_time
    mean = isinstance(law, dt.MeanPredictor)
    after = model.mean() if mean else model
    parts = [
        np.concatenate((getattr(model, name), getattr(after, name)))
        for name in ("A", "B", "delays")
    ]
    answer = np.zeros(model.inputs)
    for b in range(after.modes):
        K = law.gain if mean else law.gains[b]
        believed = (
            [(-1.0, mode), (until, model.modes + b)] if until > t else [(-1.0, model.modes + b)]
        )
        answer += (1.0 if mean else law.weights[b]) * ideal_residual.previewed(
            run, t, believed, parts, np.tile(K, (len(parts[0]), 1, 1)), bends
        )
    return answer


def check(run, plant, law):
    """Put a run back into the plant's equation and the law's."""
    assert not run.diverged
    model = law.plant
    delays = [plant.delays, model.delays, model.delays.mean(axis=0)]
    lead = 0.0
    if isinstance(law, dt.ExactPredictor):
        lead = np.unique(model.delays)
    if getattr(law, "dwell_time", None):
        reaches = np.append(0.0, np.unique(np.concatenate((model.delays, model.mean().delays))))
        lead = reaches - law.dwell_time
    bends, size = ideal_residual.rough(run, delays, lead), np.abs(run.states).max()
    for begin, end in ((0.0, 0.4), (0.4, 1.1), (1.1, 1.6)):
        assert ideal_residual.plant_defect(run, plant, begin, end, bends) < 1e-10 * size
    largest = np.abs(run.inputs).max()
    for t in (0.0, 0.07, 0.31, 0.62, 0.83, 1.17, 1.6):
        u = run.record.inputs_at(np.array([t]))[0]
        assert np.abs(u - expected(law, run, t, bends)).max() < 1e-10 * largest


LAWS = {
    "averaged": lambda model, K: dt.AveragedPredictor(model, K, allow_unstable=True),
    "single": lambda model, K: dt.SingleModePredictor(
        model, K, model.modes - 1, allow_unstable=True
    ),
    "mean": lambda model, K: dt.MeanPredictor(model, K.mean(axis=0), allow_unstable=True),
    "delay ignored": lambda model, K: dt.DelayedStateFeedback(model, K, allow_unstable=True),
}
LAWS_OF_ONE = {
    **LAWS,
    "oracle": lambda model, K: dt.ExactPredictor(model, K, allow_unstable=True),
}


@pytest.mark.few(5)
@pytest.mark.parametrize("seed", mostly_long(SEEDS, 0, 1, 3, 5))
@pytest.mark.parametrize("name", LAWS)
def test_a_run_solves_the_plants_equation_and_the_laws(name, seed):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng)
    model = plant if seed % 2 else other_delays(plant, rng)
    law, signal = LAWS[name](model, random_gains(rng, plant)), random_signal(rng, plant)
    x0, u0 = rng.normal(size=plant.states), rng.normal(size=plant.inputs)
    check(dt.simulate(plant, law, signal, x0, 1.6, step=None, u0=u0), plant, law)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", [*LAWS, "oracle"])
def test_a_plant_with_delays_of_its_own_under_a_law_that_believes_in_one(name, seed):
    rng = np.random.default_rng(100 + seed)
    plant = random_plant(rng)
    model = dt.SwitchedSystem(plant.A, plant.B, 0.3)
    law, signal = LAWS_OF_ONE[name](model, random_gains(rng, plant)), random_signal(rng, plant)
    x0 = rng.normal(size=plant.states)
    check(dt.simulate(plant, law, signal, x0, 1.6, step=None), plant, law)


@pytest.mark.parametrize("seed", range(20))
def test_once_all_inputs_have_arrived_one_mode_follows_its_closed_loop(seed):
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, modes=1)
    K = random_gains(rng, plant)
    law = dt.SingleModePredictor(plant, K, 0, allow_unstable=True)
    x0, u0 = rng.normal(size=plant.states), rng.normal(size=plant.inputs)
    constant = dt.SwitchingSignal.constant(0)
    run = dt.simulate(plant, law, constant, x0, 2.0, step=None, u0=u0)
    first = plant.longest_delay
    start = run.record.states_at(np.array([first]))[0]
    for t in (0.7, 1.1, 2.0):
        x = expm((plant.A[0] + plant.B[0] @ K[0]) * (t - first)) @ start
        assert (
            np.abs(run.record.states_at(np.array([t]))[0] - x).max()
            < 1e-12 * np.abs(run.states).max()
        )
    assert np.nanmax(np.abs(run.mismatch)) < 1e-11 * np.abs(run.inputs).max()


def test_delays_that_differ_by_round_off_are_one():
    plant, one = (
        dt.SwitchedSystem([[[0.4, 1.0], [0.0, 0.5]]], np.eye(2)[None], delay)
        for delay in ([0.1 + 0.2, 0.3], 0.3)
    )
    K = [[[-1.5, -0.6], [0.2, -2.0]]]
    signal, x0 = dt.SwitchingSignal.constant(0), [1.0, -1.0]
    runs = [
        dt.simulate(p, dt.AveragedPredictor(p, K), signal, x0, 2.0, step=None) for p in (plant, one)
    ]
    assert np.abs(runs[0].states - runs[1].states).max() < 1e-13


def test_the_digital_loop_tends_to_the_ideal_one_with_order_one():
    rng = np.random.default_rng(3)
    A, B = rng.normal(size=(2, 2, 2)), rng.normal(size=(2, 2, 2))
    plant = dt.SwitchedSystem(A, B, [[0.3, 0.2], [0.25, 0.4]])
    law = dt.AveragedPredictor(plant, random_gains(rng, plant), allow_unstable=True)
    signal, x0 = dt.SwitchingSignal([0.0, 0.55, 1.15], [0, 1, 0]), [1.0, -0.5]
    ends = [
        dt.simulate(plant, law, signal, x0, 2.0, step=step).states[:, -1]
        for step in (0.01, 0.005, 0.0025)
    ]
    ideal = dt.simulate(plant, law, signal, x0, 2.0, step=None).states[:, -1]
    wrong = [np.linalg.norm(end - ideal) for end in ends]
    assert np.log2(wrong[:-1]) - np.log2(wrong[1:]) == pytest.approx([1.0, 1.0], abs=0.05)


FORESEEING = {
    "oracle": LAWS_OF_ONE["oracle"],
    "averaged": lambda model, K: dt.AveragedPredictor(
        model, K, dwell_time=0.25, allow_unstable=True
    ),
    "mean": lambda model, K: dt.MeanPredictor(
        model, K.mean(axis=0), dwell_time=0.25, allow_unstable=True
    ),
}


def plant_of_a_kind(rng, kind):
    """Two modes: one input, with a delay per mode, or two inputs, each with its own."""
    n, m = rng.integers(1, 4), 1 if kind == "per mode" else 2
    A, B = rng.normal(size=(2, n, n)), rng.normal(size=(2, n, m))
    delays = rng.uniform(0.15, 0.5, (2, 1) if kind == "per mode" else (m,))
    return dt.SwitchedSystem(A, B, delays)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("name", "kind", "seed"),
    mostly_long(
        [
            (name, kind, s)
            for name in FORESEEING
            for kind in ("per mode", "per input")
            for s in SEEDS
        ],
        ("oracle", "per input", 3),  # delays of its modes are read again in `test_ideal_rereading`
        ("averaged", "per mode", 3),
        ("mean", "per input", 3),
    ),
)
def test_laws_that_believe_in_a_switch_ahead_solve_their_equation(name, kind, seed):
    rng = np.random.default_rng(200 + seed)
    plant = plant_of_a_kind(rng, kind)
    model = plant if seed % 2 == 0 else other_delays_of_a_kind(plant, rng)
    law, signal = FORESEEING[name](model, random_gains(rng, plant)), random_signal(rng, plant)
    x0, u0 = rng.normal(size=plant.states), rng.normal(size=plant.inputs)
    check(dt.simulate(plant, law, signal, x0, 1.6, step=None, u0=u0), plant, law)


def other_delays_of_a_kind(plant, rng):
    """Other delays and matrices, with delays that differ between what they differed between."""
    scale = rng.uniform(0.8, 1.2, plant.inputs)
    return dt.SwitchedSystem(0.9 * plant.A, 1.1 * plant.B, plant.delays * scale)


@pytest.mark.long
def test_the_oracle_does_so_where_every_mode_and_input_has_its_own():
    rng = np.random.default_rng(9)
    A, B = rng.normal(size=(2, 3, 3)), rng.normal(size=(2, 3, 2))
    plant = dt.SwitchedSystem(A, B, [[0.3, 0.4], [0.2, 0.35]])
    law = FORESEEING["oracle"](plant, random_gains(rng, plant))
    signal = dt.SwitchingSignal([0.0, 0.9], [0, 1])
    check(dt.simulate(plant, law, signal, rng.normal(size=3), 1.6, step=None), plant, law)


@pytest.mark.parametrize("kind", ["per mode", "per input"])
def test_the_oracle_with_the_right_model_leaves_no_mismatch(kind):
    rng = np.random.default_rng(5)
    plant = plant_of_a_kind(rng, kind)
    law, signal = LAWS_OF_ONE["oracle"](plant, random_gains(rng, plant)), random_signal(rng, plant)
    x0, u0 = rng.normal(size=plant.states), rng.normal(size=plant.inputs)
    run = dt.simulate(plant, law, signal, x0, 1.6, step=None, u0=u0)
    assert run.mismatch is not None
    assert np.nanmax(np.abs(run.mismatch)) < 1e-12 * np.abs(run.inputs).max()


def test_x_is_known_until_the_plant_reads_what_was_not_sent():
    # Mode 1 reads 0.1 s back, but is over by then: mode 0 reads its inputs of before 1 up to 1.4.
    plant = dt.SwitchedSystem(np.zeros((2, 1, 1)), np.ones((2, 1, 1)), [[0.4], [0.1]])
    law = dt.SingleModePredictor(plant, np.full((2, 1, 1), -0.5), 0)
    signal = dt.SwitchingSignal([0.0, 0.3, 1.05], [0, 1, 0])
    run = dt.simulate(plant, law, signal, [1.0], 1.0, step=None)
    assert run.record.last == pytest.approx(1.4, abs=1e-12)
    assert run.mismatch is not None
    assert np.isfinite(run.mismatch).all()
    early = dt.simulate(plant, law, signal, [1.0], 0.9, step=None)
    assert early.record.last == pytest.approx(1.0, abs=1e-12)


def test_a_dwell_aware_law_whose_mode_is_always_sure_is_the_single_mode_law():
    rng = np.random.default_rng(6)
    plant = plant_of_a_kind(rng, "per input")
    K, constant = random_gains(rng, plant), dt.SwitchingSignal.constant(0)
    laws = (
        dt.AveragedPredictor(plant, np.array([K[0], K[0]]), dwell_time=9.0, allow_unstable=True),
        dt.SingleModePredictor(plant, K, 0, allow_unstable=True),
    )
    x0 = rng.normal(size=plant.states)
    one, other = (dt.simulate(plant, law, constant, x0, 2.0, step=None).states for law in laws)
    assert np.abs(one - other).max() < 1e-12 * np.abs(other).max()


def test_jumps_are_passed_on_by_the_mode_that_reads_them_until_they_are_faint():
    signal = dt.SwitchingSignal([0.0, 0.6], [0, 1])
    shifts = [Shift(0.5, 0, 0.01), Shift(0.2, 1, 0.01), Shift(0.3, None, 1e-14)]
    times = pass_on(np.array([0.0]), shifts, signal, 0.95)
    assert times == pytest.approx([0.0, 0.3, 0.5, 0.7, 0.9])
