"""Runs of one to thirty periods go in the batch, and are those of `simulate`."""

import numpy as np
import pytest

import deadtime as dt
import plants
from batches import X0, H, require_single_runs
from deadtime.imperfections import (
    Dropout,
    Jitter,
    MeasurementDelay,
    Noise,
    Saturation,
    WhiteDisturbance,
)
from deadtime.imperfections.base import Sizes
from deadtime.imperfections.received import ReceivedData
from deadtime.scenarios import scenario_seed
from shares import mostly_long

# In periods: within the first one, and below, at and above eleven samples in the second half.
PERIODS = 0.3, 1.0, 1.4, 2.0, 4.7, 9.0, 13.2, 19.5, 20.0, 21.0, 30.0
TRUTH, BELIEVED = plants.generic(0.234), plants.generic(0.3, seed=5)
FORCED = [
    WhiteDisturbance(0.05), Noise(0.02), Dropout(0.1), Saturation(-1.0, 1.2), Jitter(0.05),
    MeasurementDelay(0.12),
]  # fmt: skip
START = list(X0)


# Other laws and imperfections run for a few periods beside their long runs: `batches`.
@pytest.mark.parametrize("given", [[], FORCED], ids=["perfect", "forced"])
@pytest.mark.parametrize("name", mostly_long(plants.LAWS, "averaged"))
def test_every_law_is_the_single_run_whatever_the_number_of_periods(name, given):
    laws, short = {name: plants.LAWS[name](BELIEVED)}, [count * H for count in PERIODS]
    require_single_runs(TRUTH, laws, given, rows=(0, 3, 10), short=short)


def test_what_tracks_is_run_one_by_one_within_a_first_period_alone():
    servo = dt.Servo(BELIEVED, plants.OUTPUTS)
    K = servo.place([-1.0, -1.5, -2.0, -2.5, -3.0], step=H)
    observer = dt.kalman(servo.model, servo.C, np.eye(3), 0.01 * np.eye(2), step=H)
    law = dt.AveragedPredictor(servo.plant, K, allow_unstable=True)
    law = dt.OutputFeedback(law, observer, servo=servo, reference=[0.5, -0.2])
    signal = dt.SwitchingSignal.constant(1)
    for horizon, alone in ((0.03, ["law"]), (0.1, []), (0.14, [])):
        data = dt.monte_carlo(TRUTH, {"law": law}, [signal] * 2, START, horizon, H)
        assert data.attrs["one_by_one"] == alone
        run = dt.simulate(TRUTH, law, signal, START, horizon, H).metrics()
        found = {name: data[name][0, 1].item() for name in run}
        assert found == pytest.approx(run, rel=1e-10), horizon


def test_runs_of_one_sample_are_each_told_their_own_wrong_mode():
    names = np.array([[1, 2, 0], [2, 0, 1], [2, 0, 0]])
    heard = ReceivedData.perfect(1, Sizes(3, 3, 2, H))._replace(named=names[:, None])
    true = np.array([[0], [0], [2]])
    np.testing.assert_array_equal(heard.modes(true), [[1], [2], [0]])
    for run, own in enumerate(heard.each(3)):
        np.testing.assert_array_equal(own.modes(true[run]), heard.modes(true)[run])


@pytest.mark.parametrize("horizon", [0.03, 0.1, 0.5, 1.17, 1.9])
def test_decay_rates_are_slopes_of_the_known_logarithm_at_eleven_instants(horizon):
    # No input acts: log|x| grows by a_σ, whatever the samples see.
    a = np.array([-0.7, 0.4, -2.0])
    plant = plants.scalar(a)
    law = dt.DelayedStateFeedback(plant, np.zeros((3, 1, 1)), allow_unstable=True)
    signal = plants.off_grid()
    data = dt.monte_carlo(plant, {"law": law}, [signal] * 9, [2.0], horizon, H)
    assert data.attrs["one_by_one"] == []
    times = np.linspace(horizon / 2, horizon, 11)
    ends = np.append(signal.times[1:], np.inf)
    spent = np.clip(times[:, None] - signal.times, 0.0, ends - signal.times)
    logs = np.log(2.0) + spent @ a[signal.modes]
    centred = times - times.mean()
    slope = centred @ logs / (centred @ centred)
    np.testing.assert_allclose(data.decay_rate.values, -slope, rtol=1e-11)


@pytest.mark.parametrize(("rate", "x0", "decay"), [(700.0, 1.0, None), (0.0, 0.0, np.inf)])
def test_what_diverges_or_vanishes_within_a_few_periods_is_the_single_run(rate, x0, decay):
    plant = plants.scalar([rate, -1.0])
    law = dt.DelayedStateFeedback(plant, np.zeros((2, 1, 1)), allow_unstable=True)
    signals = [dt.SwitchingSignal.constant(0), dt.SwitchingSignal.constant(1)] * 2
    data = dt.monte_carlo(plant, {"law": law}, signals, [x0], 0.7, H)
    for i, signal in enumerate(signals):
        run = dt.simulate(plant, law, signal, [x0], 0.7, H)
        assert data.diverged[0, i].item() == run.diverged == (i % 2 == 0 and rate > 0.0)
        for name, value in run.metrics().items():
            assert data[name][0, i].item() == pytest.approx(value, rel=1e-9), name
    assert decay is None or (data.decay_rate == decay).all()


def test_short_runs_do_not_depend_on_how_many_go_at_a_time(monkeypatch):
    laws = {"averaged": plants.LAWS["averaged"](BELIEVED)}
    model = dt.Markov(2.0 * (1.0 - np.eye(3)))

    def run(**options):
        return dt.monte_carlo(
            TRUTH, laws, model, START, 0.73, H, 27, imperfections=FORCED, **options
        )

    whole = run()
    monkeypatch.setattr("deadtime.scenarios.block._ROOM", 1)
    assert run().identical(whole)
    monkeypatch.setattr("deadtime.scenarios.batch_run._BLOCK", 8)
    assert run(threads=3).identical(whole)


@pytest.mark.parametrize("given", [Jitter(0.05), MeasurementDelay(0.133), MeasurementDelay(0.02)])
@pytest.mark.parametrize("horizon", [0.4, 6.0])
def test_measurements_within_periods_that_no_switch_cuts(given, horizon):
    law, signal = plants.LAWS["averaged"](BELIEVED), dt.SwitchingSignal.constant(1)
    data = dt.monte_carlo(
        TRUTH, {"law": law}, [signal] * 3, START, horizon, H, imperfections=[given]
    )
    assert data.attrs["one_by_one"] == []
    for i in range(3):
        seed = scenario_seed(0, i)
        run = dt.simulate(TRUTH, law, signal, START, horizon, H, imperfections=[given], seed=seed)
        for name, value in run.metrics().items():
            assert data[name][0, i].item() == pytest.approx(value, rel=1e-9), name
