"""Metrics against hand-derived integrals and quadrature; names and shapes of what is handed on."""

import control
import numpy as np
import pytest

import deadtime as dt
import plants

H = 0.1
PLANT = plants.generic()  # D = 0.234, φ = 0.034
HISTORY = np.random.default_rng(5).normal(size=(2, 3))
FOREVER = dt.SwitchingSignal.constant(0)


def run(name="averaged", horizon=2.05, signal=None, times=None, plant=PLANT, x0=(1.0, -0.5, 0.8)):
    law, signal = plants.LAWS[name](plant), plants.off_grid() if signal is None else signal
    history = HISTORY[:, : law.window(H).count]
    return dt.simulate(plant, law, signal, list(x0), horizon, step=H, u0=history, times=times)


def free(a, x0, horizon):
    """dx/dt = a x, no input."""
    law = dt.DelayedStateFeedback(plants.scalar(a), [[[0.0]]], allow_unstable=True)
    return dt.simulate(law.plant, law, FOREVER, [x0], horizon, step=H)


# -- integrals ---------------------------------------------------------------------------------


def quadrature(horizon, signal, plant, name):
    """(∫|x|², ∫|u|²) by Gauss-Legendre between samples, arrivals and switches."""
    k = np.arange(-10, 60) * H
    breaks = np.concatenate([k, k + plant.delay, signal.times, [0.0, horizon]])
    breaks = np.unique(breaks[(breaks >= 0.0) & (breaks <= horizon)])
    s, w = np.polynomial.legendre.leggauss(10)
    length = np.diff(breaks)[:, None] / 2
    times, weights = (breaks[:-1, None] + length * (s + 1)).ravel(), (length * w).ravel()
    dense = run(name, horizon, signal, times, plant)
    return [float(np.sum(values**2 @ weights)) for values in (dense.states, dense.inputs)]


SIGNALS = {
    "off the grid": plants.off_grid(),
    "none": FOREVER,
    "at arrivals": dt.SwitchingSignal([0, 0.134, 0.234, 1.034, 1.9 + 0.034], [0, 1, 2, 0, 1]),
    "several in the last step": dt.SwitchingSignal([0, 2.011, 2.02, 2.041], [0, 1, 2, 0]),
    "in the last step, past the end": dt.SwitchingSignal([0, 2.06, 2.09], [0, 1, 2]),
    "in the last step, in φ": dt.SwitchingSignal([0, 2.01, 2.028], [0, 1, 2]),
}


@pytest.mark.few(20)
@pytest.mark.parametrize("signal", SIGNALS.values(), ids=SIGNALS)
@pytest.mark.parametrize("horizon", [2.0, 2.02, 2.034, 2.05, 2.0999])
@pytest.mark.parametrize("delay", [0.234, 0.3, 0.04])
def test_ise_and_energy_are_the_integrals_between_samples_too(signal, horizon, delay):
    plant = plants.generic(delay)
    ise, energy = quadrature(horizon, signal, plant, "averaged")
    metrics = run("averaged", horizon, signal, plant=plant).metrics()
    assert metrics["ise"] == pytest.approx(ise, rel=1e-12)
    assert metrics["energy"] == pytest.approx(energy, rel=1e-12)
    assert metrics["cost"] == metrics["ise"] + metrics["energy"]


@pytest.mark.parametrize("horizon", [3.0, 2.97, 2.931])
@pytest.mark.parametrize("delay", [0.25, 0.3, 0.04])
def test_ise_of_an_integrator_that_spends_its_history_is_the_integral_by_hand(horizon, delay):
    # x = x0 + c t until D, then constant: ∫x² = ((x0 + cD)³ − x0³)/(3c) + (x0 + cD)² (T − D).
    x0, c = 0.7, -1.3
    law = dt.DelayedStateFeedback(plants.scalar(0.0, delay=delay), [[[0.0]]], allow_unstable=True)
    one = dt.simulate(law.plant, law, FOREVER, [x0], horizon, step=H, u0=[c])
    end = x0 + c * delay
    by_hand = (end**3 - x0**3) / (3 * c) + end**2 * (horizon - delay)
    assert one.metrics()["ise"] == pytest.approx(by_hand, rel=1e-12)
    assert one.metrics()["energy"] == 0.0


@pytest.mark.parametrize("horizon", [3.0, 2.97, 2.931, 0.04])
@pytest.mark.parametrize("a", [-0.5, 0.8])
def test_ise_of_an_exponential_is_the_integral_by_hand(a, horizon):
    metrics = free(a, 2.0, horizon).metrics()
    assert metrics["ise"] == pytest.approx(4.0 * np.expm1(2 * a * horizon) / (2 * a), rel=1e-12)


@pytest.mark.parametrize("horizon", [2.0, 1.97])
def test_energy_of_held_inputs_is_the_sum_by_hand(horizon):
    # The delay is longer than the run, so x = x0 + c t and u_k = K x(t_k) is known.
    x0, c, K = 0.7, -1.3, -0.4
    law = dt.DelayedStateFeedback(plants.scalar(0.0, delay=5.0), [[[K]]])
    one = dt.simulate(law.plant, law, FOREVER, [x0], horizon, step=H, u0=[c])
    lengths = np.array([H] * 19 + [horizon - 1.9])
    by_hand = np.sum(lengths * (K * (x0 + c * H * np.arange(20))) ** 2)
    assert one.metrics()["energy"] == pytest.approx(by_hand, rel=1e-12)


def test_metrics_are_of_the_whole_run_whatever_times_were_asked_for():
    assert run(times=[0.3, 0.4]).metrics() == run().metrics()


def test_splitting_a_run_adds_up_its_integrals():
    law, signal = plants.LAWS["averaged"](PLANT), plants.off_grid()
    whole = run().metrics()
    first = run(horizon=0.8)
    rest = dt.simulate(
        PLANT, law, signal.after(0.8), first.states[:, -1], 1.25, step=H, u0=first.history
    )
    for name in ("ise", "energy", "cost"):
        assert first.metrics()[name] + rest.metrics()[name] == pytest.approx(whole[name], rel=1e-12)


# -- shape of the response ---------------------------------------------------------------------


@pytest.mark.parametrize("horizon", [10.0, 9.97])
def test_the_metrics_of_a_decaying_exponential_are_those_by_hand(horizon):
    metrics = free(-0.5, -3.0, horizon).metrics()
    settled = np.ceil(np.log(50.0) / 0.5 / H) * H
    assert metrics["peak"] == 3.0
    assert metrics["settling_time"] == pytest.approx(settled, rel=1e-12)
    assert metrics["decay_rate"] == pytest.approx(0.5, rel=1e-12)
    assert metrics["final_norm"] == pytest.approx(3.0 * np.exp(-0.5 * horizon), rel=1e-12)


def test_a_run_that_does_not_settle_says_infinity():
    metrics = free(0.3, 1.0, 10.0).metrics()
    assert metrics["settling_time"] == np.inf
    assert metrics["decay_rate"] == pytest.approx(-0.3, rel=1e-12)
    assert metrics["peak"] == metrics["final_norm"] == pytest.approx(np.exp(3.0), rel=1e-12)


def test_nothing_happens_from_zero_and_no_metric_is_nan():
    law = plants.LAWS["exact"](PLANT)
    one = dt.simulate(PLANT, law, plants.off_grid(), np.zeros(3), 2.05, step=H)
    metrics = one.metrics()
    assert not one.states.any()
    assert not one.inputs.any()
    assert not one.mismatch.any()
    assert metrics.pop("decay_rate") == np.inf
    assert set(metrics.values()) == {0.0}


def test_the_final_norm_and_the_peak_are_those_of_the_states():
    one = run()
    norms = np.linalg.norm(one.states, axis=0)
    assert one.metrics()["final_norm"] == pytest.approx(norms[-1], rel=1e-14)
    assert one.metrics()["peak"] == pytest.approx(norms.max(), rel=1e-14)


def test_a_run_that_diverges_at_once_does_not_decay():
    law = dt.DelayedStateFeedback(plants.scalar(3000.0), [[[0.0]]], allow_unstable=True)
    one = dt.simulate(law.plant, law, FOREVER, [1.0], 1.0, step=H)
    assert one.diverged
    assert not one.metrics()["decay_rate"] > 0.0


# -- handing on --------------------------------------------------------------------------------

COLUMNS = ["x[0]", "x[1]", "x[2]", "u[0]", "u[1]", "mode", "w[0]", "w[1]"]


@pytest.mark.parametrize(("name", "columns"), [("averaged", COLUMNS), ("mean", COLUMNS[:6])])
def test_a_data_frame_has_a_column_per_signal(name, columns):
    one = run(name)
    frame = one.to_pandas()
    assert list(frame.columns) == columns
    assert frame.index.name == "time"
    assert np.array_equal(frame.index, one.time)
    assert np.array_equal(frame["x[1]"], one.states[1])
    assert np.array_equal(frame["u[1]"], one.inputs[1])
    assert np.array_equal(frame["mode"], one.mode)
    if name == "averaged":
        assert np.array_equal(frame["w[1]"], one.mismatch[1])


@pytest.mark.parametrize(
    ("name", "names"), [("averaged", {"x", "u", "mode", "w"}), ("mean", {"x", "u", "mode"})]
)
def test_a_dataset_has_named_dimensions(name, names):
    one = run(name)
    data = one.to_xarray()
    assert set(data.data_vars) == names
    assert dict(data.sizes) == {"state": 3, "input": 2, "time": one.time.size}
    assert data["x"].dims == ("state", "time")
    assert data["u"].dims == ("input", "time")
    assert data["time"].attrs == {"units": "s"}
    assert data.attrs == {"diverged": 0, "message": ""}
    assert np.array_equal(data["x"], one.states)


def test_a_control_response_has_the_states_as_outputs():
    one = run()
    response = one.to_control()
    assert isinstance(response, control.TimeResponseData)
    assert response.output_labels == response.state_labels == ["x[0]", "x[1]", "x[2]"]
    assert response.input_labels == ["u[0]", "u[1]"]
    assert np.array_equal(response.time, one.time)
    assert np.array_equal(response.outputs, one.states)
    assert np.array_equal(response.states, one.states)
    assert np.array_equal(response.inputs, one.inputs)


def test_the_repr_says_where_the_run_ended():
    assert repr(free(-0.5, 1.0, 2.0)) == "Trajectory(end=2 s, samples=21, |x| = 0.368)"
