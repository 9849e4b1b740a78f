"""Growth and decay: laws against the baseline, rates of the lifted loop, divergence as a result."""

import warnings

import numpy as np
import pytest

import deadtime as dt
import plants

H = 0.1


@pytest.mark.parametrize("seed", range(3))
def test_ignoring_the_delay_fails_where_the_averaged_predictor_does_not(seed):
    plant = plants.paper()
    signal = dt.SwitchingSignal.random(2, 15.0, dwell_time=0.2, seed=seed)
    averaged, delayed = (
        dt.simulate(plant, plants.LAWS[name](plant), signal, [-1.0, 1.0], 15.0)
        for name in ("averaged", "delayed")
    )
    assert averaged.metrics()["final_norm"] < 0.2 * averaged.metrics()["peak"]
    assert delayed.metrics()["final_norm"] > 1e4 * averaged.metrics()["peak"]
    assert delayed.metrics()["decay_rate"] < -0.5


def growth(name, mode, step):
    """Growth rate of a constant mode: the spectral radius of the loop lifted over the window."""
    plant = plants.paper()
    law = plants.LAWS[name](plant) if isinstance(name, str) else name(plant)
    table = law.digital(step)
    N, n = table.taps, 2
    Phi, Gamma = plants.held(plant.A[mode], plant.B[mode], step)  # D = N h: the plant sees u_{k−N}
    lifted = np.zeros((n + N, n + N))
    lifted[:n, :n], lifted[:n, -1:] = Phi, Gamma
    lifted[n, :n], lifted[n, n:] = table.state_gain[0, 0], table.input_gain[0, :, 0, 0]
    lifted[n + 1 :, n:-1] = np.eye(N - 1)
    return np.log(np.abs(np.linalg.eigvals(lifted)).max()) / step


@pytest.mark.parametrize(
    ("name", "mode", "rate"),
    [("averaged", 0, 0.128), ("averaged", 1, 0.282), ("mean", 0, 0.090), ("mean", 1, 0.368)],
)
def test_without_switching_the_paper_s_laws_are_unstable_at_the_known_rates(name, mode, rate):
    # The known rates are the ideal loop's; the digital loop at h = 0.01 has the same digits.
    assert growth(name, mode, 0.01) == pytest.approx(rate, abs=5e-4)


@pytest.mark.parametrize(("step", "rate"), [(0.1, -0.83), (0.05, -0.90), (0.01, -0.97)])
def test_exact_weights_keep_the_exact_law_stable_at_any_period(step, rate):
    def single(plant):
        return dt.SingleModePredictor(plant, plants.gains(plant), 0)

    assert growth(single, 0, step) == pytest.approx(rate, abs=5e-3)


def test_a_long_run_grows_at_the_rate_of_the_lifted_loop():
    plant = plants.paper()
    signal = dt.SwitchingSignal.constant(1)
    one = dt.simulate(plant, plants.LAWS["averaged"](plant), signal, [-1.0, 1.0], 150.0)
    # The dominant pair oscillates, so the slope of log|x| is averaged over many periods.
    assert -one.metrics()["decay_rate"] == pytest.approx(growth("averaged", 1, 0.01), abs=0.01)


# -- divergence is a result --------------------------------------------------------------------


@pytest.mark.parametrize("a", [50.0, 3000.0])
@pytest.mark.parametrize("delay", [0.25, 0.04])
def test_a_diverged_run_ends_early_and_says_when(a, delay):
    plant = plants.scalar(a, delay=delay)
    law = dt.DelayedStateFeedback(plant, [[[0.1]]], allow_unstable=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        one = dt.simulate(plant, law, dt.SwitchingSignal.constant(0), [1e-3], 100.0, step=H)
        metrics = one.metrics()
    assert one.diverged
    assert one.time[-1] < 100.0
    assert (
        one.message == f"diverged: |x| left 1e100 after t = {one.time[-1]:g} s, where the run ends."
    )
    assert np.isfinite(one.states).all()
    assert np.isfinite(one.inputs).all()
    assert np.linalg.norm(one.states[:, -1]) <= 1e100
    assert not np.isnan(one.mismatch).any()
    assert not any(np.isnan(value) for value in metrics.values())
    assert "diverged" in repr(one)


def test_the_paper_s_example_without_compensation_diverges_in_the_end():
    plant = plants.paper()
    signal = dt.SwitchingSignal.random(2, 400.0, dwell_time=0.2, seed=0)
    one = dt.simulate(plant, plants.LAWS["delayed"](plant), signal, [-1.0, 1.0], 400.0, step=0.05)
    assert one.diverged
    assert np.isfinite(one.states).all()
    assert one.time.size == one.states.shape[1] == one.inputs.shape[1] == one.mode.size < 8000
