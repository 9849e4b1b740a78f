"""What a user's own imperfections answer: refused where it would not fit, and none of it lost."""

from dataclasses import dataclass

import numpy as np
import pytest

import deadtime as dt
import plants
from by_period import MODEL, PLANT, SIGNAL, X0, require_same
from by_sample import by_sample
from deadtime.base.errors import ArgumentError
from deadtime.imperfections import (
    ActuatorImperfection,
    Additive,
    Dropout,
    Noise,
    Relaying,
    Saturation,
    SensorImperfection,
    Sizes,
    StepDisturbance,
    TimingImperfection,
)
from deadtime.loop.received_samples import DrawnImperfections
from deadtime.scenarios import scenario_seed
from deadtime.scenarios.sweeps.blocks import _ALONE, _of_law
from deadtime.scenarios.sweeps.study import Loop
from shares import mostly_long

LAW = plants.LAWS["averaged"](MODEL)
SIZES = Sizes.of(PLANT, 0.1)


class Own(Relaying, SensorImperfection):
    """Answers as it is told to."""

    def __init__(self, **changes):
        vars(self)["changes"] = changes

    def relay(self, heard, sizes, rng):
        changes = {field: change(getattr(heard, field)) for field, change in self.changes.items()}
        return heard._replace(**changes)


class Nothing(Relaying, SensorImperfection):
    def relay(self, heard, sizes, rng):
        return None


class Waiting(TimingImperfection):
    waits = False

    def __init__(self, answer):
        vars(self)["answer"] = answer

    def lags(self, sizes, samples, rng):
        return self.answer(samples)


@dataclass(frozen=True)
class Burst(Dropout):
    """Loses the samples that it counts, and asks for no random number."""

    def sensor(self, sizes, rng):
        count = 0

        def sense(seen):
            nonlocal count
            count += 1
            return seen._replace(x=seen.x * np.nan, mode=-1) if count % 3 == 0 else seen

        return sense


@dataclass(frozen=True)
class Wide(Saturation):
    """Half of what is asked for."""

    def actuator(self, sizes):
        return lambda asked, before: 0.5 * asked


@dataclass(frozen=True)
class Both(Noise, ActuatorImperfection):
    """A sensor that is noisy, and an actuator that gives half."""

    def actuator(self, sizes):
        return lambda asked, before: 0.5 * asked


class Within(Saturation, Additive, SensorImperfection):
    """Noise and limits in one, both known."""

    def sampler(self, sizes, rng):
        return lambda count: 0.02 * rng.standard_normal((count, sizes.states))


class PushedAndNoisy(StepDisturbance, Additive, SensorImperfection):
    """A force, and an offset of the sensors."""

    def sampler(self, sizes, rng):
        return lambda count: np.ones((count, sizes.states))


def changed(k, value):
    def change(array):
        array = array.copy()
        array[k] = value
        return array

    return change


WRONG = [
    (Nothing(), r"Nothing\.relay must return ReceivedData, got NoneType"),
    (Own(sample=list), r"Own\.relay must return arrays, got sample"),
    (Own(sample=lambda a: a.astype(float)), r"sample as integers of shape \(21,\), got float64"),
    (Own(sample=lambda a: a[1:]), r"sample as integers of shape \(21,\), got int64 .*\(20,\)"),
    (Own(sample=changed(4, 5)), r"−1 ≤ sample\[k\] ≤ k, got sample\[4\] = 5"),
    (Own(sample=changed(0, -2)), r"sample\[0\] = -2"),
    (Own(mode_of=changed(3, 10**9)), r"−1 ≤ mode_of\[k\] ≤ k, got mode_of\[3\]"),
    (Own(mode_of=lambda a: a > 0), "mode_of as integers"),
    (Own(named=changed(2, 3)), r"0 ≤ named < modes = 3, got numbers from 0 to 3"),
    (Own(named=changed(2, -1)), r"got numbers from -1"),
    (Own(named=lambda a: a.T), r"named as integers of shape \(21, 3\)"),
    (Own(noise=lambda a: a.astype(int)), r"noise as floats of shape \(21, 3\), got int64"),
    (Own(noise=lambda a: a[:, :1]), r"noise as floats of shape \(21, 3\)"),
    (Waiting(lambda n: np.full(n, np.nan)), r"lags must return finite seconds ≥ 0, got nan"),
    (Waiting(lambda n: np.full(n, -0.1)), r"got -0\.1 at sample 0"),
    (Waiting(lambda n: np.full(n, np.inf)), "finite seconds ≥ 0, got inf"),
    (Waiting(lambda n: np.zeros(n + 1)), r"seconds of shape \(samples,\) = \(21,\), got .*\(22,\)"),
    (Waiting(lambda n: 0.1), r"seconds of shape \(samples,\)"),
    (Waiting(lambda n: np.full(n, "a")), r"Waiting\.lags must return seconds"),
]  # fmt: skip


@pytest.mark.parametrize(("own", "message"), WRONG)
def test_an_answer_that_does_not_fit_is_refused_by_its_name(own, message):
    with pytest.raises(ArgumentError, match=message):
        DrawnImperfections.of([(own, np.random.default_rng(0))], SIZES, 21, "applied")


@pytest.mark.parametrize("own", [own for own, _ in WRONG[:-6]])
def test_called_once_a_sample_the_same_is_refused(own):
    with pytest.raises(ArgumentError, match=r"relay must return"):
        own.sensor(SIZES, np.random.default_rng(0))


def test_a_wrong_answer_is_refused_before_many_runs():
    own = Own(sample=changed(4, 10**12))
    with pytest.raises(ArgumentError, match="sample"):
        dt.monte_carlo(PLANT, [LAW], [SIGNAL], X0, 6.0, 0.1, imperfections=[own])


def test_small_and_unsigned_integers_fit():
    own = Own(sample=lambda a: a.astype(np.uint64), mode_of=lambda a: a.astype(np.int32))
    run = require_same(LAW, [own])
    assert (run.measured == run.states[:, : run.measured.shape[1]]).all()
    received = DrawnImperfections.of(
        [(own, np.random.default_rng(0))], SIZES, 5, "applied"
    ).received
    assert {part.dtype.str[1:] for part in received} == {"i8", "f8"}


def simulated(own, **options):
    return dt.simulate(PLANT, LAW, SIGNAL, X0, 3.0, 0.1, imperfections=[own], **options)


def test_a_sensor_written_anew_is_the_one_that_senses():
    lost = np.isnan(simulated(Burst(0.9)).measured[0])
    assert (lost == (np.arange(lost.size) % 3 == 2)).all()


def test_an_actuator_written_anew_is_the_one_that_acts():
    run = simulated(Wide(-1.0, 1.0))
    past = run.record.past
    np.testing.assert_array_equal(run.record.inputs[past:], 0.5 * run.commanded.T)


def test_both_parts_of_one_class_act():
    run = simulated(Both(0.1))
    past = run.record.past
    assert (run.measured != run.states).all()
    np.testing.assert_array_equal(run.record.inputs[past:], 0.5 * run.commanded.T)


def test_the_noise_of_what_also_pushes_is_heard():
    run = simulated(PushedAndNoisy([0.4, -1.0, 0.7]))
    np.testing.assert_allclose(run.measured, run.states + 1.0)
    assert np.isfinite(run.states).all()
    other = dt.simulate(PLANT, LAW, SIGNAL, X0, 3.0, 0.1)
    assert (run.states[:, 1] != other.states[:, 1]).any()


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("own", "at_once"),
    [
        (Burst(0.2), False),
        (Wide(-1.0, 1.0), False),
        (Both(0.1), False),
        (PushedAndNoisy([0.4, -1.0, 0.7]), False),
        (Within(-0.5, 0.5), True),
    ],
)
def test_many_runs_are_those_of_simulate_whatever_parts_a_class_plays(own, at_once):
    data = dt.monte_carlo(PLANT, [LAW], [SIGNAL], X0, 6.0, 0.1, seed=3, imperfections=[own])
    assert data.attrs["one_by_one"] == ([] if at_once else ["averaged"])
    run = dt.simulate(
        PLANT, LAW, SIGNAL, X0, 6.0, 0.1, imperfections=[own], seed=scenario_seed(3, 0)
    )
    assert data.cost.values[0, 0] == pytest.approx(run.metrics()["cost"], rel=1e-10)


@pytest.mark.parametrize("own", [Burst(0.2), Wide(-1.0, 1.0), Both(0.1)])
def test_a_sweep_counts_on_what_runs_one_by_one(own):
    loop = Loop(PLANT, {"law": LAW}, None, X0, 6.0, 0.1, (own,))
    assert _of_law(loop, LAW) == _ALONE


@pytest.mark.parametrize("law", ["averaged, dwell-aware", "expected"])
@pytest.mark.parametrize("kind", [Noise(0.01), Dropout(0.2)])
def test_a_mode_as_old_as_can_be_is_as_one_that_is_very_old(law, kind):
    ages = 1e18, 1e300, 1e6  # 1e19 samples need all 64 bits
    first, largest, old = (
        dt.simulate(
            PLANT, plants.LAWS[law](MODEL), dt.SwitchingSignal(SIGNAL.times, SIGNAL.modes,
            initial_age=age), X0, 3.0, 0.1, imperfections=[kind],
        )
        for age in ages
    )  # fmt: skip
    np.testing.assert_array_equal(first.states, old.states)
    np.testing.assert_array_equal(largest.states, old.states)


class LateStart(Relaying, SensorImperfection):
    """No mode is told before sample 7."""

    def relay(self, heard, sizes, rng):
        each = np.arange(heard.sample.size)
        return heard._replace(mode_of=np.where(each < 7, -1, heard.mode_of))


@pytest.mark.parametrize(
    "law", mostly_long(["averaged, dwell-aware", "exact", "expected"], "averaged, dwell-aware")
)
def test_before_any_mode_is_known_the_first_is_assumed(law):
    law = plants.LAWS[law](MODEL)
    signal = dt.SwitchingSignal([0.0, 1.33], [2, 1])
    require_same(law, [LateStart()], signal=signal)
    data = dt.monte_carlo(PLANT, [law], [signal], X0, 6.0, 0.1, imperfections=[LateStart()])
    assert data.attrs["one_by_one"] == []
    one = dt.simulate(PLANT, law, signal, X0, 6.0, 0.1, imperfections=[LateStart()])
    assert data.cost.values[0, 0] == pytest.approx(one.metrics()["cost"], rel=1e-10)


@pytest.mark.parametrize("online", [False, True])
def test_a_gain_for_each_mode_begins_with_that_of_the_first(online):
    plant = plants.scalar([0.1, 0.2, 0.3], delay=0.1)
    law = dt.DelayedStateFeedback(plant, [[[-1.0]], [[-2.0]], [[-4.0]]])
    kinds = [LateStart(), *([by_sample(Noise(0.0))] if online else [])]
    run = dt.simulate(
        plant, law, dt.SwitchingSignal.constant(1), [1.0], 2.0, 0.1, imperfections=kinds
    )
    gain = np.where(np.arange(run.states.shape[1]) < 7, -1.0, -2.0)
    np.testing.assert_allclose(run.commanded[0], gain * run.states[0], rtol=1e-14)
