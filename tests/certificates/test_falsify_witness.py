"""A witness is admissible and grows as it says, in another simulation too, and if seen late."""

import itertools
from fractions import Fraction

import numpy as np
import pytest

import deadtime as dt
import plants
import reference
from deadtime.certificates.worst_case.cycle_growth import SampledLoop
from deadtime.certificates.worst_case.cycles import Cycle, Dwell
from deadtime.certificates.worst_case.witness import repeat
from shares import mostly_long
from worst_case_laws import QUICK, H, drifting, measured

# -- switches that are seen late ---------------------------------------------------------------


def test_a_mode_that_begins_after_a_sample_may_end_at_one_as_clocks_drift():
    plant, law = drifting()
    worst = dt.falsify(plant, law, 2.0 * H, H)
    assert worst.proven
    assert worst.growth_rate == pytest.approx(0.364, abs=1e-3)
    assert measured(worst) == pytest.approx(worst.growth_rate, abs=1e-6)
    assert min(worst.sojourns) < 2.0 * H
    assert worst.signal.dwell_time >= 2.0 * H * (1.0 - 1e-5)
    assert "mode 0 for 0.199999 s" in worst.message  # not rounded to the dwell time
    assert 1e-9 < worst.phase / H < 1e-3  # more than what counts as at the sample


@pytest.mark.parametrize("tolerance", mostly_long([1e-6, 1e-4, 0.01], 0.01))
def test_any_tolerance_of_the_clock_lets_it_grow(tolerance):
    worst = dt.falsify(*drifting(), 2.0 * H, H, clock_tolerance=tolerance, budget=QUICK)
    assert worst.growth_rate > 0.36
    assert worst.signal.dwell_time >= 2.0 * H * (1.0 - tolerance)


def test_without_a_tolerance_it_decays():
    worst = dt.falsify(*drifting(), 2.0 * H, H, clock_tolerance=0.0, budget=QUICK)
    assert worst.growth_rate == pytest.approx(-0.352, abs=2e-3)
    assert worst.signal.dwell_time >= 2.0 * H


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "most"),
    mostly_long(
        [("delayed", 6), ("delayed", 12), ("expected", 12), ("mean, dwell-aware", 12)],
        ("delayed", 6),
    ),
)
def test_no_cycle_of_two_is_worse_whatever_is_seen_late(name, most):
    plant = plants.generic()
    law = plants.LAWS[name](plant)
    worst = dt.falsify(plant, law, 2.0 * H, H)
    late, loop = 5e-6, SampledLoop.of(plant, law.digital(H), 0.0)
    best = max(
        loop.growth(Cycle.on_grid([(i, a, s), (j, b, e)], late)).rate
        for i, j in itertools.combinations(range(3), 2)
        for a, b in itertools.product(range(2, most), repeat=2)
        for s, e in itertools.product((False, True), repeat=2)
    )
    assert worst.growth_rate >= best - 1e-4


# -- the witness -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    mostly_long([n for n in plants.LAWS if n != "exact"], "expected", "mean, dwell-aware"),
)
def test_every_witness_is_admissible_and_grows_as_it_says(name):
    plant = plants.generic()
    law = plants.LAWS[name](plant)
    worst = dt.falsify(plant, law, dwell_time=0.25, step=H, budget=QUICK)
    assert worst.signal.dwell_time >= 0.25 * (1.0 - 1e-5)
    assert min(worst.sojourns) >= 0.25 * (1.0 - 1e-5)
    assert worst.growth_rate >= max(dt.growth_rate(plant, law, i, H) for i in range(3)) - 1e-12
    assert measured(worst) == pytest.approx(worst.growth_rate, abs=2e-6)
    assert worst.u0.shape == (2, law.digital(H).taps)


@pytest.mark.parametrize(
    "name",
    mostly_long(["averaged", "delayed", "averaged, dwell-aware"], "averaged, dwell-aware"),
)
def test_the_witness_grows_in_an_independent_simulation_of_another_plant(name):
    delay, model_delay, dwell = Fraction(31, 100), Fraction(234, 1000), Fraction(1634, 10000)
    model = plants.generic(float(model_delay))
    plant = plants.generic(float(delay), seed=5)
    plant = dt.SwitchedSystem(0.5 * (model.A + plant.A), model.B, float(delay))
    law = plants.LAWS[name](model)
    worst = dt.falsify(plant, law, 0.17, H, maximum_dwell=0.63, budget=QUICK)
    assert len(worst.modes) > 1
    signal = repeat(worst.cycle, 2, (0.17,) * plant.modes, H)
    near = [round(t / H) for t in signal.times]  # within 1e-9 periods of a sample is at it
    cuts = [
        Fraction(k, 10) if abs(t / H - k) < 1e-9 else Fraction(t)
        for k, t in zip(near, signal.times, strict=True)
    ]
    true = reference.Model(plant.A, plant.B, delay)
    believed = reference.Model(model.A, model.B, model_delay)
    K, third = law.gains, np.full(3, 1.0 / 3.0)
    age = int(signal.initial_age / H + 1e-9)
    control = {
        "averaged": lambda: reference.averaged(believed, K, third),
        "delayed": lambda: reference.delayed(believed, K),
        "averaged, dwell-aware": lambda: reference.dwelling(believed, believed, K / 3, dwell, age),
    }[name]()
    loop = reference.Loop(
        true, reference.Signal(cuts, signal.modes.tolist()), Fraction(1, 10), worst.u0.T
    )
    samples = worst.cycle.periods + 1
    states, inputs, _ = loop.run(control, worst.x0, samples)
    run = worst.simulate(2)
    plants.close(run.states[:, :samples].T, states.astype(float), 1e-6)
    plants.close(run.inputs[:, :samples].T, inputs.astype(float), 1e-6)
    assert measured(worst) == pytest.approx(worst.growth_rate, abs=2e-6)


def test_a_dwell_time_is_kept_to_the_last_digit():
    for dwell in (0.3, 0.7 / 3.0, 0.41):
        r = Dwell.of(dwell, np.inf, H).least
        for offset in (0.0, 0.3, 0.999):
            gaps = (r, r, np.ceil(4 * r) - 2 * r)
            signal = repeat(Cycle((0, 1, 2), gaps, offset), 200, (dwell,) * 3, H)
            assert dwell <= signal.dwell_time <= dwell * (1.0 + 1e-12)
