"""Imperfect sensors and actuators: the law sees and does what they allow, the plant stays exact."""

import itertools
import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest

import deadtime as dt
import plants
import reference
from deadtime.imperfections import (
    Dropout,
    LateSamples,
    ModeDelay,
    Noise,
    RateLimit,
    Saturation,
    SensorImperfection,
    WrongMode,
)

MODEL = plants.generic()
# Not what the law believes: N = 3, φ = 0.051 and other matrices.
PLANT = dt.SwitchedSystem(1.03 * MODEL.A, 0.98 * MODEL.B, 0.251)
SIGNAL = plants.off_grid()
STEP, X0 = 0.1, np.array([1.0, -1.0, 0.5])
ALL = [
    Noise([0.1, 0.0, 0.3]),
    LateSamples(2, 0.3),
    Dropout(0.2),
    RateLimit(30.0),
    Saturation(-4, 5),
]


def run(law="averaged", imperfections=(), horizon=3.0, step=STEP, **options):
    return dt.simulate(
        PLANT, plants.LAWS[law](MODEL), SIGNAL, X0, horizon, step,
        imperfections=imperfections, **options,
    )  # fmt: skip


@pytest.mark.parametrize("law", plants.LAWS)
def test_imperfections_of_no_size_change_nothing(law):
    nothing = [Noise(0.0), Dropout(0.0), LateSamples(1, 0.0), WrongMode(0.0), Saturation(-1e9, 1e9)]
    plain, loop = run(law), run(law, nothing)
    plants.close(loop.states, plain.states, 1e-12)
    plants.close(loop.inputs, plain.inputs, 1e-12)
    plants.close(loop.measured, plain.states, 1e-12)
    assert (loop.commanded == loop.inputs).all()
    assert plain.measured is plain.commanded is None


def test_the_plant_follows_the_applied_inputs_exactly():
    loop, held = run(imperfections=ALL, seed=3), Fraction("0.1")
    model = reference.Model(PLANT.A.astype(reference.LONG), PLANT.B, Fraction("0.251"))
    times = [Fraction(str(t)) for t in SIGNAL.times.tolist()]
    mode = reference.Signal(times, SIGNAL.modes.tolist())

    def applied(j):
        return loop.inputs[:, j] if j >= 0 else np.zeros(2)

    x = X0.astype(reference.LONG)
    for k in range(loop.time.size - 1):
        x = reference.run_model(model, mode, times, applied, held, x, k * held, (k + 1) * held)
        assert np.abs(loop.states[:, k + 1] - x).max() <= 1e-12 * np.abs(x).max()


def test_the_oracle_keeps_its_place_in_the_future_where_samples_are_lost():
    loop = run("exact", [Dropout(0.3)], seed=2)
    table = plants.LAWS["exact"](MODEL).digital(STEP, SIGNAL, loop.time.size)
    seen = np.isfinite(loop.measured).all(axis=0)
    u, scale = plants.expected_inputs(
        table, np.nan_to_num(loop.measured.T), loop.mode, loop.inputs.T
    )
    assert (~seen).sum() > 5
    assert (np.abs(loop.inputs.T - u)[seen] <= 1e-12 * scale[seen]).all()


@pytest.mark.parametrize("predict", ["applied", "commanded"])
@pytest.mark.parametrize("law", ["averaged", "averaged, dwell-aware", "expected"])
def test_the_law_reads_its_table_for_what_it_was_told(law, predict):
    loop = run(law, ALL, seed=4, predict=predict)
    table = plants.LAWS[law](MODEL).digital(STEP)
    history = loop.inputs if predict == "applied" else loop.commanded
    seen = np.isfinite(loop.measured).all(axis=0)
    assert 5 < (~seen).sum() < 20
    if law == "averaged":  # the rows of the others depend on the mode of late samples
        told = np.nan_to_num(loop.measured.T)
        u, scale = plants.expected_inputs(table, told, loop.mode, history.T)
        assert (np.abs(loop.commanded.T - u)[seen] <= 1e-12 * scale[seen]).all()
    lost = np.flatnonzero(~seen)
    lost = lost[lost > 0]
    assert (loop.commanded[:, lost] == loop.commanded[:, lost - 1]).all()
    assert (loop.inputs >= -4.0).all()
    assert (loop.inputs <= 5.0).all()
    assert np.abs(np.diff(loop.inputs, axis=1)).max() <= 3.0 * (1.0 + 1e-12)
    assert (loop.inputs != loop.commanded).any()


def test_a_controller_that_is_told_the_same_gives_the_same():
    law = plants.LAWS["averaged, dwell-aware"](MODEL)
    loop = run("averaged, dwell-aware", [ModeDelay(2), Saturation(-4.0, 5.0)], step=0.05)
    controller = dt.Controller(law, 0.05, limits=(-4.0, 5.0))
    told = np.concatenate((np.full(2, loop.mode[0]), loop.mode[:-2]))
    for k, mode in enumerate(told.tolist()):
        u = controller.update(loop.states[:, k], mode)
        plants.close(u, loop.inputs[:, k], 1e-11, 5.0)


def test_noise_has_its_standard_deviation_and_a_stream_of_its_own():
    std = np.array([0.1, 0.0, 0.3])
    loop = run(imperfections=[Noise(std)], step=0.002)
    noise = loop.measured - loop.states
    np.testing.assert_allclose(noise.std(axis=1), std, rtol=0.08)
    assert np.abs(noise.mean(axis=1)).max() <= 4.0 * 0.3 / math.sqrt(noise.shape[1])
    assert abs(np.corrcoef(noise[0], noise[2])[0, 1]) < 0.1
    other = run(imperfections=[Dropout(0.3), Noise(std), Noise(0.0)], step=0.002)
    arrived = np.isfinite(other.measured).all(axis=0)
    difference = (other.measured - other.states) - noise
    np.testing.assert_allclose(difference[:, arrived], 0.0, atol=1e-12)
    assert abs(arrived.mean() - 0.7) < 0.05
    again, changed = run(imperfections=ALL), run(imperfections=ALL, seed=1)
    assert (again.states == run(imperfections=ALL).states).all()
    assert (again.states != changed.states).any()


def test_late_samples_are_those_of_before_and_the_newest_counts():
    loop = run(imperfections=[LateSamples(3)])
    assert np.isnan(loop.measured[:, :3]).all()
    assert (loop.inputs[:, :3] == 0.0).all()  # held from before time 0
    assert (loop.measured[:, 3:] == loop.states[:, :-3]).all()
    some = run(imperfections=[LateSamples(4, 0.5)], step=0.01)
    age = []
    for k in range(some.time.size):
        same = [(some.states[:, k - a] == some.measured[:, k]).all() for a in range(min(k, 4) + 1)]
        age.append(same.index(True) if any(same) else 5)
    assert set(age[4:]) == {0, 1, 2, 3, 4}
    assert all(later <= before + 1 for before, later in itertools.pairwise(age[4:]))


@dataclass(frozen=True)
class Listen(SensorImperfection):
    """Changes nothing, and notes the modes."""

    told: list

    def sensor(self, sizes, rng):
        def sense(seen):
            self.told.append(seen.mode)
            return seen

        return sense


def test_wrong_modes_are_other_modes_as_often_as_said():
    told, law = [], plants.LAWS["expected"](MODEL)
    kinds = [WrongMode(0.25), Listen(told)]
    loop = dt.simulate(PLANT, law, SIGNAL, X0, 30.0, 0.01, imperfections=kinds)
    wrong = np.array(told) != loop.mode
    assert abs(wrong.mean() - 0.25) < 0.03
    assert set(told) == {0, 1, 2}
    last = loop.mode == SIGNAL.modes[-1]
    others = np.array(told)[wrong & last]
    assert 0.4 < (others == others.max()).mean() < 0.6


def test_with_no_sample_at_all_the_last_input_is_held():
    u0 = np.array([0.3, -0.2])
    loop = run(imperfections=[Dropout(1.0)], u0=u0)
    assert (loop.inputs == u0[:, None]).all()
    assert np.isnan(loop.measured).all()


@pytest.mark.parametrize(
    ("size", "reported", "unreported"),
    [(1.6, 1097.0, 1538.0), (2.0, 1555.0, math.inf), (2.4, *[math.inf] * 2)],
)
def test_a_law_that_is_told_of_saturation_survives_more_of_it(size, reported, unreported):
    problem = dt.problems.paper()
    for predict, cost in (("applied", reported), ("commanded", unreported)):
        loop = dt.simulate(
            problem.plant, problem.laws["averaged"], problem.signal, [-size, size], 10.0, 0.01,
            imperfections=[Saturation(-25.0, 25.0)], predict=predict,
        )  # fmt: skip
        assert np.abs(loop.commanded).max() > 25.0
        found = loop.metrics()["cost"]
        assert found > 1e9 if cost == math.inf else found == pytest.approx(cost, abs=1.0)


def test_every_law_of_a_scenario_meets_the_same_imperfections():
    # Two laws of one shape, for which a loop is compiled once.
    laws = {name: plants.LAWS[name](MODEL) for name in ("averaged", "weighted")}
    model, kinds = dt.SemiMarkov([0.37, 0.41, 0.33]), [Noise(0.2), Dropout(0.1)]
    options = {"x0": X0, "horizon": 1.5, "step": 0.05, "seed": 5}
    few, more = (
        dt.monte_carlo(PLANT, laws, model, scenarios=n, imperfections=kinds, **options)
        for n in (2, 4)
    )
    assert (more.cost.isel(scenario=slice(2)) == few.cost).all()
    alone = dt.monte_carlo(
        PLANT, {"weighted": laws["weighted"]}, model, scenarios=4, imperfections=kinds, **options
    )
    assert (alone.cost.sel(law="weighted") == more.cost.sel(law="weighted")).all()
    plain = dt.monte_carlo(PLANT, laws, model, scenarios=4, **options)
    assert (plain.cost != more.cost).all()
    assert more.attrs["imperfections"] == [repr(kind) for kind in kinds]


def test_a_plant_that_switches_by_its_state_takes_imperfections_too():
    rule = dt.HalfSpace([1.0, 0.0], 0.0)
    plant = dt.problems.paper().plant
    law = dt.StateDependentPredictor(plant, dt.place(plant, [-1.0, -2.0]), rule)
    options = {"x0": [-1.0, 1.0], "horizon": 3.0, "step": 0.05}
    plain = dt.simulate(plant, law, rule, **options)
    loop = dt.simulate(plant, law, rule, imperfections=[Noise(0.0)], **options)
    plants.close(loop.states, plain.states, 1e-12)
    noisy = dt.simulate(plant, law, rule, imperfections=[Noise(0.01)], **options)
    assert noisy.measured.shape == noisy.states.shape
    assert (noisy.states != plain.states).any()


@pytest.mark.parametrize(
    ("imperfections", "message"),
    [
        ([Noise(-1.0)], r"Noise.std must be ≥ 0"),
        ([Noise([1.0, 2.0])], r"Noise.std must have shape \(size,\) = \(3,\)"),
        ([Noise(math.nan)], r"Noise.std\[0\] must be finite"),
        ([Dropout(1.2)], r"Dropout.probability must be in \[0, 1\], got 1.2"),
        ([LateSamples(0)], "LateSamples.periods must be an integer of at least 1"),
        ([ModeDelay(0)], "ModeDelay.periods must be"),
        ([ModeDelay(10**30)], "ModeDelay.periods must be at most 1,000,000,000"),
        ([Noise("loud")], "Noise.std must hold real numbers, one or"),
        ([Noise([[1.0], [1.0, 2.0]])], "Noise.std must hold real numbers"),
        (Noise(0.1), "imperfections must be a list of imperfections, got Noise"),
        ([WrongMode(-0.1)], "WrongMode.probability must be in"),
        ([RateLimit(0.0)], "RateLimit.rate must be positive"),
    ],
)
def test_malformed_imperfections_are_refused_by_name(imperfections, message):
    with pytest.raises(dt.ArgumentError, match=message):
        run(imperfections=imperfections)


@pytest.mark.parametrize(
    ("low", "high", "message"),
    [
        (12.0, -12.0, r"Saturation must have low < high, got 12.0 and -12.0\."),
        (1.0, 1.0, "Saturation must have low < high"),
        (0.0, [1.0, -1.0], "Saturation must have low < high"),
        ([-1.0, 2.0], np.ones(2), "Saturation must have low < high"),
        ([0.0, 0.0], [1.0, 1.0, 1.0], r"low and high of one length, got shapes \(2,\) and \(3,\)"),
        ("low", 1.0, "Saturation.low must hold real numbers"),
        (math.nan, 1.0, "Saturation.low must not be NaN"),
        (0.0, [1.0, math.nan], "Saturation.high must not be NaN"),
    ],
)
def test_malformed_limits_are_refused_when_they_are_made(low, high, message):
    with pytest.raises(dt.ArgumentError, match=message):
        Saturation(low, high)


def test_a_saturation_may_have_one_side():
    loop = run(imperfections=[Saturation(-math.inf, 1.0)])
    assert loop.inputs.max() == 1.0
    assert loop.inputs.min() < -1.0


def test_what_goes_with_imperfections_is_checked():
    with pytest.raises(dt.ArgumentError, match='predict must be "applied" or "commanded"'):
        run(imperfections=ALL, predict="both")
    with pytest.raises(dt.ArgumentError, match="the ideal loop has no samples"):
        run(imperfections=ALL, step=None)
    with pytest.raises(dt.ArgumentError, match="seed must be"):
        run(imperfections=ALL, seed=-1)
    rule = dt.HalfSpace([1.0, 0.0, 0.0], 0.0)
    with pytest.raises(dt.ArgumentError, match="future"):
        dt.simulate(PLANT, plants.LAWS["exact"](MODEL), rule, X0, 1.0, STEP, imperfections=ALL)
