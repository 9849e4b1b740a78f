"""Margins of several delays: shifts of all of them, and of one input's, against growth rates."""

import numpy as np
import pytest
from scipy.linalg import block_diag

import certificate_reference as reference
import deadtime as dt
from shares import mostly_long

STEP = 0.05


def shifted(plant, input, shift):
    delays = np.array(plant.delays)
    delays[:, slice(None) if input is None else input] += shift
    return dt.SwitchedSystem(plant.A, plant.B, delays)


def growth(plant, law, input, shift, step=STEP):
    moved = shifted(plant, input, shift)
    return max(dt.growth_rate(moved, law, mode, step) for mode in range(plant.modes))


def drawn(seed):
    rng = np.random.default_rng(seed)
    modes, n, m = rng.integers(1, 3), rng.integers(1, 4), rng.integers(1, 4)
    A = 0.7 * rng.normal(size=(n, n)) + 0.1 * rng.normal(size=(modes, n, n))
    B = rng.normal(size=(n, m)) + 0.1 * rng.normal(size=(modes, n, m))
    shape = [(m,), (modes, 1), (modes, m), ()][rng.integers(4)]
    delays = rng.uniform(0.04, 0.5, size=shape)
    plant = dt.SwitchedSystem(A, B, delays if shape else 0.3)
    return plant, dt.AveragedPredictor(plant, dt.place(plant, -rng.uniform(0.3, 1.5, size=n)))


def test_inputs_are_called_by_their_names():
    plant = dt.SwitchedSystem([[[0.5]]], [[[1.0, 0.4]]], [0.3, 0.1])
    law = dt.AveragedPredictor(plant, dt.place(plant, [-1.0]))
    options = {"step": STEP, "scenarios": 1, "names": ["throttle", "brake"]}
    signal = dt.SwitchingSignal.constant(0)
    sentences = dt.robustness(plant, law, signal, [1.0], 4.0, **options).sentences
    assert "the true delays of input" not in sentences[0]
    assert "delay of input “throttle”" in sentences[1]
    assert "delay of input “brake”" in sentences[2]
    assert " of input 1 " in dt.delay_margin(plant, law, STEP, input=1).message


# Delays by mode; by input, of one mode; by both.
@pytest.mark.few(1)
@pytest.mark.parametrize("seed", mostly_long(range(14, 34), 18, 21, 33))
def test_loops_are_lost_at_the_shifts_that_growth_rates_say(seed):
    plant, law = drawn(seed)
    for input in (None, *range(plant.inputs)):
        margin = dt.delay_margin(plant, law, STEP, input=input)
        if margin.lower is None:
            assert growth(plant, law, input, 0.0) >= 0.0
            continue
        for end, mode, sign in (
            (margin.shorter, margin.lower_mode, -1.0),
            (margin.longer, margin.upper_mode, 1.0),
        ):
            far = min(end if mode is not None else 0.999 * end, 2.0)
            inside = np.linspace(0.0, 1.0, 12)[:-1] * far
            assert all(growth(plant, law, input, sign * shift) < 0.0 for shift in inside)
            if mode is not None and end == far:
                ends = end + 1e-7 * np.array([-1.0, 1.0])
                before, after = (growth(plant, law, input, sign * shift) for shift in ends)
                assert before < 0.0 < after or max(abs(before), abs(after)) < 1e-6


@pytest.mark.parametrize("step", [STEP, None])
def test_the_delay_of_an_input_that_alone_moves_a_part_is_that_parts_own(step):
    parts = [
        dt.SwitchedSystem([[[0.4, 1.0], [0.0, 0.2]]], [[[0.0], [1.0]]], 0.3),
        dt.SwitchedSystem([[[0.8]]], [[[0.5]]], 0.3),
    ]
    gains = [
        dt.place(part, poles) for part, poles in zip(parts, ([-1.0, -2.0], [-1.5]), strict=True)
    ]
    A, B = (block_diag(*(getattr(part, M)[0] for part in parts)) for M in "AB")
    whole = dt.SwitchedSystem([A], [B], 0.3)
    law = dt.SingleModePredictor(whole, [block_diag(*(K[0] for K in gains))], 0)
    for j, (part, K) in enumerate(zip(parts, gains, strict=True)):
        alone = dt.delay_margin(part, dt.SingleModePredictor(part, K, 0), step)
        beside = dt.delay_margin(whole, law, step, input=j)
        assert beside.lower == pytest.approx(alone.lower, rel=1e-9)
        assert beside.upper == pytest.approx(alone.upper, rel=1e-9)
        assert f"the true delay of input {j} is" in beside.message
    both = dt.delay_margin(whole, law, step)
    one, other = (dt.delay_margin(whole, law, step, input=j) for j in (0, 1))
    assert both.lower == pytest.approx(max(one.lower, other.lower), rel=1e-9)
    assert both.upper == pytest.approx(min(one.upper, other.upper), rel=1e-9)


def test_ideal_loops_are_lost_at_the_shifts_that_their_roots_say():
    plant = dt.SwitchedSystem(
        [[[0.4, 1.0], [0.0, 0.2]]], [np.array([[1.0, 0.3], [0.2, 1.0]])], [0.3, 0.17]
    )
    law = dt.SingleModePredictor(plant, dt.place(plant, [-1.0, -2.0]), 0)
    for input in (None, 0, 1):
        margin = dt.delay_margin(plant, law, None, input=input)
        for end, mode, sign in (
            (margin.shorter, margin.lower_mode, -1.0),
            (margin.longer, margin.upper_mode, 1.0),
        ):
            inside = np.linspace(0.0, 0.999, 5) * end
            assert all(growth(plant, law, input, sign * shift, None) < 0.0 for shift in inside)
            if mode is not None:
                assert growth(plant, law, input, sign * (end + 1e-7), None) > 0.0
                assert growth(plant, law, input, sign * (end - 1e-7), None) < 0.0


def test_the_delay_of_the_one_input_is_the_delay():
    plant = dt.problems.paper().plant
    law = dt.SingleModePredictor(
        plant.like(plant.A[:1], plant.B[:1], plant.delays[:1]), [[[-12.0, -6.0]]], 0
    )
    joint, alone = dt.delay_margin(law.plant, law), dt.delay_margin(law.plant, law, input=0)
    assert (alone.lower, alone.upper) == (joint.lower, joint.upper)


def observed_loop():
    A = [[[0.3, 1.0], [0.0, 0.2]]]
    plant = dt.SwitchedSystem(A, [np.eye(2)], [0.23, 0.4])
    law = dt.SingleModePredictor(plant, dt.place(plant, [-1.0, -1.2]), 0)
    return plant, dt.OutputFeedback(law, dt.luenberger(plant, np.eye(2), [-4.0, -5.0], STEP))


def test_with_an_observer_only_the_plants_own_delays_move():
    plant, law = observed_loop()
    for input in (None, 0, 1):
        margin = dt.delay_margin(plant, law, STEP, input=input)
        for end, sign in ((margin.shorter, -1.0), (margin.longer, 1.0)):
            assert growth(plant, law, input, sign * (end - 1e-7)) < 0.0
            if 0 < end < 0.2 or sign > 0.0:
                assert growth(plant, law, input, sign * (end + 1e-7)) > 0.0


def test_shifts_of_delays_that_differ_are_said_as_shifts_and_never_too_large():
    plant = dt.SwitchedSystem([[[0.5]], [[0.6]]], [[[1.0]], [[1.0]]], [[0.3], [0.5]])
    law = dt.AveragedPredictor(plant, dt.place(plant, [-2.0]))
    margin = dt.delay_margin(plant, law, STEP)
    assert margin.differ
    assert margin.nominal == 0.3
    assert margin.longer == margin.upper - 0.3
    said = float(margin.message.split(" s longer")[0].split()[-1])
    assert 0.99 * margin.longer <= said <= margin.longer


def test_delays_that_may_be_wrong_by_any_time_are_said_so():
    A, B = [np.diag([-1.0, 0.5])], [np.eye(2)]
    plant = dt.SwitchedSystem(A, B, [[0.3, 0.2]])
    law = dt.AveragedPredictor(plant, [[[-0.1, 0.0], [0.0, -1.5]]])
    tolerant = dt.SwitchedSystem([[[-1.0]], [[-2.0]]], [[[1.0]], [[1.0]]], [[0.3], [0.5]])
    small = dt.AveragedPredictor(tolerant, [[[-0.1]], [[-0.1]]])
    margin = dt.delay_margin(tolerant, small, STEP)
    assert margin.message.endswith("if the true delays all change by the same time, however long")
    one = dt.delay_margin(plant, law, STEP, input=0)
    assert "whatever the true delay of input 0" in one.message
    assert "whatever" not in dt.delay_margin(plant, law, STEP, input=1).message


@pytest.mark.parametrize("step", [STEP, None])
def test_the_gain_margin_of_several_delays_ends_where_growth_rates_say(step):
    plant, law = drawn(26)
    margin = dt.gain_margin(plant, law, step)

    def growth_at(factor):
        louder = plant.like(plant.A, factor * plant.B)
        return max(dt.growth_rate(louder, law, mode, step) for mode in range(plant.modes))

    assert not plant.has_one_delay
    for end, outwards in ((margin.lower, 1.0 - 1e-6), (margin.upper, 1.0 + 1e-6)):
        assert growth_at(end / outwards) < 0.0 < growth_at(end * outwards)


@pytest.mark.parametrize("input", [2, -1])
def test_an_input_that_is_not_there_is_refused(input):
    plant = dt.SwitchedSystem([[[0.1]]], [[[1.0, 0.5]]], [0.3, 0.1])
    law = dt.AveragedPredictor(plant, dt.place(plant, [-1.0]))
    with pytest.raises(dt.ArgumentError, match=r"input must be in 0\.\.1"):
        dt.delay_margin(plant, law, STEP, input=input)


def certified_pair():
    plant = dt.SwitchedSystem([[[0.5]], [[0.6]]], [[[1.0, 0.4]], [[0.95, 0.4]]], [0.234, 0.17])
    return plant, dt.AveragedPredictor(plant, dt.place(plant, [-2.0]))


@pytest.mark.long
@pytest.mark.parametrize("input", mostly_long([None, 0, 1], 1))
def test_runs_decay_at_delays_drawn_from_the_certified_margin(input):
    plant, law = certified_pair()
    alone = dt.delay_margin(plant, law, 0.1, input=input, upto=0.5)
    margin = dt.delay_margin(plant, law, 0.1, 0.27, upto=0.5, input=input)
    assert margin.certified
    assert margin.input == input
    assert alone.lower <= margin.lower < margin.nominal < margin.upper <= alone.upper
    assert margin.longer > 0.3 * alone.longer
    rng = np.random.default_rng(3)
    for _ in range(6):
        delays = np.array(plant.delays)
        which = slice(None) if input is None else [input]
        delays[:, which] += rng.uniform(-0.99 * margin.shorter, margin.longer)
        times, modes = reference.random_signal(rng, 2, 0.27, 60.0, 0.5)
        truth = dt.SwitchedSystem(plant.A, plant.B, delays)
        run = dt.simulate(truth, law, dt.SwitchingSignal(times, modes), [1.0], 60.0, 0.1)
        late = np.abs(run.states[0])
        assert late[-100:].max() < 0.1 * late[:100].max()


def test_pieces_of_the_certified_margin_end_at_multiples_of_the_period_of_all_delays(monkeypatch):
    plant, law = certified_pair()
    asked = []

    class Answer:
        stable, message = True, ""

    def certify(plant, law, dwell_time, step, *, delays=None, **options):
        asked.append(delays)
        return Answer()

    monkeypatch.setattr("deadtime.certificates.certify", certify)
    margin = dt.delay_margin(plant, law, 0.1, 0.27, upto=0.5)
    for low, high in asked[1:]:
        ratios = np.array([low, high]) / 0.1
        assert (np.floor(ratios[1] - 1e-9) <= np.floor(ratios[0] + 1e-9)).all()
        assert low[0] - low[1] == pytest.approx(plant.delays[0] - plant.delays[1])
    assert "s shorter to" in margin.message
    assert "every constant common change of the true delays" in margin.message


def test_a_certified_margin_of_all_delays_is_of_a_common_shift():
    # The inputs cancel but for how late they are to each other, and no piece holds both corners.
    plant = dt.SwitchedSystem([[[-1.0]]], [[[1.0, -1.0]]], [0.16, 0.14])
    law = dt.DelayedStateFeedback(plant, [[[12.0], [12.0]]])
    margin = dt.delay_margin(plant, law, 0.1, 0.25, upto=0.4)
    assert margin.certified
    for shift in np.linspace(-margin.shorter, margin.longer, 9):
        shifted = dt.SwitchedSystem(plant.A, plant.B, plant.delays + shift)
        assert dt.growth_rate(shifted, law, 0, 0.1) < 0.0
    corner = plant.delays + 0.99 * np.array([-margin.shorter, margin.longer])
    apart = dt.SwitchedSystem(plant.A, plant.B, corner)
    assert dt.growth_rate(apart, law, 0, 0.1) > 1.0
    assert "every constant common change of the true delays" in margin.message
    assert "whatever the others" not in margin.message
