"""The search by runs against that by tables: the same laws, with their table hidden."""

from dataclasses import dataclass

import numpy as np
import pytest

import deadtime as dt
import plants
import worst_case_laws as laws
from deadtime.feedback import Law

QUICK = 8000  # 20 runs


@dataclass(frozen=True, eq=False, repr=False)
class Hidden(Law):
    """A law that is called once a period and shows no table."""

    law: Law

    @property
    def label(self):
        return "hidden"

    def digital(self, step, signal=None, steps=None):
        raise dt.ArgumentError("hidden has no table.")

    def ideal(self, signal, horizon):
        raise dt.ArgumentError("step must be given.")

    def online(self, step, signal=None, steps=None):
        return self.law.online(step, signal, steps)


def hide(law):
    return Hidden(law.plant, law.gains, law=law)


def paper(alpha=1.0):
    plant = dt.problems.paper().plant.apart(alpha)
    gains = dt.place(plant, [-1.0, -2.0])
    return plant, gains


def averaged():
    plant, gains = paper()
    return plant, dt.AveragedPredictor(plant, gains)


def expected(delay=1.0):
    plant, gains = paper()
    plant = dt.SwitchedSystem(plant.A, plant.B, delay)
    return plant, dt.ExpectedPredictor(plant, gains, dt.Markov([[0.0, 1.0], [1.0, 0.0]]))


def turning():
    return laws.free(laws.TURNING)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("loop", "dwell_time", "lag", "budget"),
    [
        (averaged, 0.2, 0, QUICK),  # a constant mode
        (turning, 0.2, 0, 20_000),  # two modes that alternate
        (laws.drifting, 0.2, 0, 20_000),  # a sojourn between dwell time and clock
        # Told late; so is a loop that decays, below, at every change.
        pytest.param(expected, 0.4, 3, 80_000, marks=pytest.mark.long),
    ],
)
def test_runs_find_the_growth_that_the_table_search_finds(loop, dwell_time, lag, budget):
    plant, law = loop()
    known = dt.falsify(plant, law, dwell_time, laws.H, mode_lag=lag, budget=laws.QUICK)
    found = dt.falsify(plant, hide(law), dwell_time, laws.H, mode_lag=lag, budget=budget)
    assert known.proven
    assert found.growth_rate == pytest.approx(known.growth_rate, abs=5e-3)
    assert len(found.modes) == len(known.modes)
    assert not found.proven
    assert found.proof.rate is None
    assert "the law is no table, and growth was measured in a run" in found.message
    shortest = dwell_time * (1.0 - 1e-5)
    assert min(found.sojourns) >= shortest


def test_runs_that_all_decay_refute_nothing():
    plant, law = expected(delay=0.3)
    known = dt.falsify(plant, law, 0.4, laws.H, mode_lag=3, budget=laws.QUICK)
    found = dt.falsify(plant, hide(law), 0.4, laws.H, mode_lag=3, budget=QUICK)
    assert found.growth_rate < 0.0
    assert found.growth_rate == pytest.approx(known.growth_rate, abs=5e-3)
    assert len(found.modes) == len(known.modes) == 2
    assert not found.proven
    assert found.message.startswith(
        "No admissible switching signal was found that grows; the worst decays"
    )


def test_a_law_by_a_rule_is_searched():
    plant = plants.paper()
    ruled = dt.StateDependentPredictor(plant, plants.gains(plant), dt.HalfSpace([1.0, 0.0]))
    found = dt.falsify(plant, ruled, 0.4, 0.1, budget=4000)
    assert found.growth_rate > 0.1
    assert not found.proven
    run = found.simulate(cycles=30)
    assert np.abs(run.states[:, -10:]).max() > np.abs(run.states[:, :10]).max()


def test_a_maximum_dwell_time_keeps_sojourns_below_it():
    plant, law = expected()
    found = dt.falsify(plant, hide(law), 0.4, laws.H, maximum_dwell=0.7, budget=QUICK)
    assert len(found.modes) >= 2
    assert max(found.sojourns) <= 0.7 * (1.0 + 1e-5)
