"""What `simulate` takes: histories, instants, horizons."""

import numpy as np
import pytest

import deadtime as dt
import plants

H = 0.1
PLANT = plants.generic()  # D = 0.234, φ = 0.034, N = 3
LAW = plants.LAWS["averaged"](PLANT)
SIGNAL = plants.off_grid()
X0 = [1.0, -0.5, 0.8]
HISTORY = np.random.default_rng(5).normal(size=(2, 3))


def run(horizon=3.0, u0=HISTORY, times=None, signal=SIGNAL, law=LAW, step=H, x0=X0, plant=PLANT):
    return dt.simulate(plant, law, signal, x0, horizon, step=step, u0=u0, times=times)


# -- histories ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "forms",
    [
        [None, [0.0, 0.0], lambda t: [0.0, 0.0], np.zeros((2, 3))],
        [[0.3, -1.2], np.array([0.3, -1.2]), lambda t: [0.3, -1.2], np.tile([[0.3], [-1.2]], 3)],
        [HISTORY, HISTORY.tolist(), lambda t: HISTORY[:, int(np.floor((t + 1e-9) / H))]],
    ],
    ids=["zero", "constant", "held"],
)
def test_every_form_of_the_same_history_gives_the_same_run(forms):
    runs = [run(u0=u0) for u0 in forms]
    for other in runs[1:]:
        assert np.array_equal(other.states, runs[0].states)
        assert np.array_equal(other.inputs, runs[0].inputs)


def test_a_single_input_takes_scalars():
    plant = plants.paper(0.25)
    forms = [1.5, 3 / 2 + 0j.real, np.float64(1.5), [1.5], lambda t: 1.5, [[1.5] * 3]]
    runs = [
        run(
            u0=u0,
            plant=plant,
            law=plants.LAWS["mean"](plant),
            x0=[1.0, 0.0],
            signal=plants.off_grid(2),
        )
        for u0 in forms
    ]
    for other in runs[1:]:
        assert np.array_equal(other.states, runs[0].states)


@pytest.mark.parametrize(
    ("delay", "model_delay", "instants"),
    [
        (0.234, 0.234, [-0.234, -0.2, -0.1]),
        (0.3, 0.3, [-0.3, -0.2, -0.1]),
        (0.04, 0.04, [-0.04]),
        (0.234, 0.37, [-0.37, -0.3, -0.2, -0.1]),
        (0.37, 0.234, [-0.37, -0.3, -0.2, -0.1]),
    ],
)
def test_a_function_is_sampled_where_each_held_input_starts_within_the_longer_delay(
    delay, model_delay, instants
):
    asked = []

    def u0(t):
        asked.append(t)
        return [0.0, t]

    law = plants.LAWS["averaged"](plants.generic(model_delay))
    sampled = run(plant=plants.generic(delay), law=law, u0=u0)
    assert asked == pytest.approx(instants, rel=1e-14)
    held = run(plant=plants.generic(delay), law=law, u0=np.vstack([np.zeros(len(asked)), asked]))
    assert np.array_equal(sampled.states, held.states)


def test_only_the_delay_s_share_of_the_oldest_input_reaches_the_plant():
    # Integrator, D = 0.25, φ = 0.05: x(D) = x0 + 0.05 u_{−3} + 0.1 u_{−2} + 0.1 u_{−1}.
    plant = plants.scalar(0.0)
    law = dt.DelayedStateFeedback(plant, [[[-1.0]]])
    one = run(
        u0=[[7.0, 5.0, 3.0]],
        plant=plant,
        law=law,
        signal=dt.SwitchingSignal.constant(0),
        x0=[1.0],
        times=[0.05, 0.15, 0.25],
    )
    plants.close(one.states, [[1.35, 1.85, 2.15]], 1e-14)


def test_the_history_of_a_run_is_its_last_inputs_oldest_first():
    one = run()
    assert np.array_equal(one.history, one.inputs[:, -4:-1])
    one.history[:] = 0.0  # a copy
    assert one.history.any()
    assert np.array_equal(
        run(horizon=0.2).history, np.hstack([HISTORY[:, 2:], run().inputs[:, :2]])
    )


# -- instants and horizons ---------------------------------------------------------------------


@pytest.mark.parametrize("name", plants.LAWS)
def test_times_at_the_samples_are_the_samples(name):
    law = plants.LAWS[name](PLANT)
    one = run(law=law)
    other = run(law=law, times=np.arange(31) * H)
    assert np.array_equal(other.inputs, one.inputs)
    assert np.array_equal(other.mode, one.mode)
    plants.close(other.states, one.states, 1e-13)
    if one.mismatch is not None:
        plants.close(other.mismatch, one.mismatch, 1e-12, scale=np.abs(one.inputs).max())


def test_inputs_and_modes_are_right_continuous_and_states_are_continuous():
    one = run()
    for k in (1, 7, 29):
        before, at, after = run(times=[k * H - 1e-7, k * H, k * H + 1e-7]).inputs.T
        assert np.array_equal(before, one.inputs[:, k - 1])
        assert np.array_equal(at, one.inputs[:, k])
        assert np.array_equal(after, one.inputs[:, k])
    for switch, old, new in [(0.1718, 0, 1), (0.3727, 2, 0)]:
        around = run(times=[switch - 1e-7, switch, switch + 1e-7])
        assert around.mode.tolist() == [old, new, new]
        plants.close(around.states[:, 0], around.states[:, 2], 1e-5)


def test_between_samples_the_state_follows_the_plant():
    # From one instant to the next: held inputs, cut at switches, by SciPy's exponential.
    t = np.sort(
        np.concatenate([np.linspace(0.0, 3.0, 61), np.arange(-2, 28) * H + 0.234, SIGNAL.times])
    )
    one = run(times=t)
    inputs = np.hstack([HISTORY, run().inputs])
    for i in range(t.size - 1):
        middle = 0.5 * (t[i] + t[i + 1])
        mode = SIGNAL([middle])[0]
        u = inputs[:, int(np.floor((middle - 0.234) / H)) + 3]
        Phi, Gamma = plants.held(PLANT.A[mode], PLANT.B[mode], t[i + 1] - t[i])
        plants.close(one.states[:, i + 1], Phi @ one.states[:, i] + Gamma @ u, 1e-12)


@pytest.mark.parametrize("horizon", [1.034, 1.05, 1.0999, 0.03])
def test_a_horizon_between_samples_ends_in_a_partial_step(horizon):
    one = run(horizon=horizon)
    whole = int(horizon / H + 1e-9) + 1
    assert one.time.tolist() == [*(np.arange(whole) * H), horizon]
    plants.close(one.states, run(times=one.time).states, 1e-13)
    assert np.array_equal(one.inputs[:, -1], one.inputs[:, -2])
    assert one.mismatch is not None
    plants.close(one.mismatch, run(times=one.time).mismatch, 1e-11)


def test_a_horizon_within_round_off_of_a_sample_ends_there():
    for horizon in (0.3, 0.1 + 0.2, 3 * 0.1, 0.3 - 1e-12):
        assert run(horizon=horizon).time.size == 4


def test_two_switches_within_a_step_are_seen_by_the_plant_and_not_by_the_law():
    seen = dt.SwitchingSignal([0.0, 0.52, 0.58], [0, 1, 0])
    constant = dt.SwitchingSignal.constant(0)
    law = plants.LAWS["delayed"](PLANT)
    blip, plain = run(law=law, signal=seen), run(law=law, signal=constant)
    assert np.array_equal(blip.mode, plain.mode)
    assert np.array_equal(blip.inputs[:, :6], plain.inputs[:, :6])
    assert np.abs(blip.states[:, 6] - plain.states[:, 6]).max() > 1e-3


def test_a_signal_that_ends_early_is_continued_and_the_message_says_so():
    short = dt.SwitchingSignal([0.0, 0.3], [0, 1], end=0.5)
    endless = dt.SwitchingSignal([0.0, 0.3], [0, 1])
    assert run(signal=short).message == "the signal ends at 0.5 s and was continued in mode 1."
    assert np.array_equal(run(signal=short).states, run(signal=endless).states)
    assert run(signal=endless).message == run(signal=short, horizon=0.5).message == ""


def test_a_diverged_run_keeps_the_instants_before_its_end():
    plant = plants.scalar(50.0)
    law = dt.DelayedStateFeedback(plant, [[[0.1]]], allow_unstable=True)
    constant = dt.SwitchingSignal.constant(0)
    for times, kept in [([0.0, 0.55, 99.0], 2), ([99.0], 0)]:
        one = run(100.0, None, times, constant, law, H, [1.0], plant)
        assert one.diverged
        assert one.time.size == one.states.shape[1] == one.inputs.shape[1] == one.mode.size == kept
        assert "diverged" in repr(one)


@pytest.mark.parametrize("size", [1e101, 1e200])
def test_a_run_that_would_start_beyond_the_limit_is_refused(size):
    with pytest.raises(dt.ArgumentError, match="x0 must be below 1e100, where a run counts"):
        run(x0=[size, 0.0, 0.0], u0=None)
