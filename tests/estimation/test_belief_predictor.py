"""Laws on a belief: the compiled run, that no mode is read, and the limits of noise."""

import numpy as np
import pytest
from scipy import stats

import deadtime as dt
import plants
from by_period import MODEL, PLANT, SIGNAL, require_same
from deadtime.feedback.belief import BeliefFilter
from deadtime.imperfections import (
    Dropout,
    ModeDelay,
    Noise,
    RateLimit,
    Saturation,
    WhiteDisturbance,
    WrongMode,
)

SEMI = dt.SemiMarkov(stats.expon(loc=0.2, scale=0.3), modes=3)
FILTERS = {
    "markov": lambda **options: dt.ModeFilter(MODEL, plants.markov(3), 0.1, **options),
    "semi-markov": lambda **options: dt.ModeFilter(MODEL, SEMI, 0.1, **options),
}
LAWS = {
    "mode": dt.ExpectedPredictor(MODEL, plants.gains(MODEL), plants.markov(3)),
    "ages": dt.ExpectedPredictor(MODEL, plants.gains(MODEL), SEMI),
    "dwell": dt.AveragedPredictor(MODEL, plants.gains(MODEL), None, 0.31),
}


@pytest.mark.parametrize("chain", FILTERS)
@pytest.mark.parametrize("name", LAWS)
def test_a_law_on_a_belief_runs_as_by_periods(name, chain):
    filt = FILTERS[chain](disturbance=0.5, noise=0.1)
    for kinds in (
        [Noise(0.05)],
        [Dropout(0.3), RateLimit(30.0), Saturation(-4.0, 3.0)],
        [WhiteDisturbance(0.1), Noise(0.0)],
    ):
        require_same(dt.BeliefPredictor(LAWS[name], filt), kinds, 1.54)


def test_no_mode_is_read():
    law = dt.BeliefPredictor(LAWS["ages"], FILTERS["semi-markov"](disturbance=0.2))
    args = PLANT, law, SIGNAL, [1.0, -1.0, 0.5], 2.0, 0.1
    run = dt.simulate(*args)
    for kinds in ([ModeDelay(3)], [WrongMode(1.0)]):
        other = dt.simulate(*args, imperfections=kinds)
        assert (other.states == run.states).all()
        assert (other.belief == run.belief).all()


def test_a_rule_may_decide_the_mode_that_is_not_told():
    plant, model = plants.paper(), plants.markov(2)
    law = dt.ExpectedPredictor(plant, plants.gains(plant), model)
    on_belief = dt.BeliefPredictor(law, dt.ModeFilter(plant, model, 0.02))
    rule = dt.HalfSpace([1.0, 0.4], 0.0)
    run = dt.simulate(plant, on_belief, rule, [-1.0, 1.0], 4.0, 0.02)
    assert run.belief.shape == (2, 201)
    assert run.signal.switches > 0
    assert (run.belief.argmax(axis=0) == run.mode).mean() > 0.95


def test_with_little_noise_the_cost_is_that_of_the_measured_mode():
    """Switches fall anywhere, so that most are seen in the next state, as a sensor sees them."""
    plant, model, costs = plants.paper(), dt.Markov([[0.0, 1.25], [1.25, 0.0]]), []
    law = dt.ExpectedPredictor(plant, plants.gains(plant), model)
    on_belief = dt.BeliefPredictor(law, dt.ModeFilter(plant, model, 0.02, initial=[0.5, 0.5]))
    for seed in range(12):
        signal = model.sample(15.0, seed=seed)
        runs = (dt.simulate(plant, one, signal, [-1, 1], 15.0, 0.02) for one in (law, on_belief))
        costs.append([run.metrics()["cost"] for run in runs])
    measured, believed = np.array(costs).T
    assert abs(believed.sum() / measured.sum() - 1.0) < 0.01


def test_with_little_noise_and_switches_at_samples_it_is_the_mode_told_a_period_late():
    """x_k shows the mode up to t_k: one that begins there is told by x_{k+1}."""
    plant, model = plants.paper(), dt.Markov([[0.0, 1.25], [1.25, 0.0]])
    law = dt.ExpectedPredictor(plant, plants.gains(plant), model)
    filt = dt.ModeFilter(plant, model, 0.02, switches="samples", initial=[1.0, 0.0])
    signal = dt.SwitchingSignal(0.02 * np.array([0, 40, 75, 140, 260]), [0, 1, 0, 1, 0])
    args = signal, [-1.0, 1.0], 8.0, 0.02
    run = dt.simulate(plant, dt.BeliefPredictor(law, filt), *args)
    late = dt.simulate(plant, law, *args, imperfections=[ModeDelay(1)])
    # Rows are those of the mode of a period ago, carried over it: within a share of P of its.
    assert (run.belief[:, 1:].argmax(axis=0) == run.mode[:-1]).all()
    assert abs(run.metrics()["cost"] / late.metrics()["cost"] - 1.0) < 0.03


def test_with_endless_noise_it_is_the_averaged_law_weighted_by_how_often_modes_occur():
    plant = plants.generic([[0.234, 0.1], [0.15, 0.31], [0.05, 0.27]])
    K, rates = plants.gains(plant), plants.markov(3).rates
    held = dt.ExpectedPredictor(plant, K, dt.Markov(np.zeros((3, 3))))  # row i: K_i P_i
    generator = rates - np.diag(rates.sum(axis=1))
    system = np.vstack([generator.T, np.ones(3)])
    often = np.linalg.lstsq(system, [0.0, 0.0, 0.0, 1.0], rcond=None)[0]
    filt = dt.ModeFilter(plant, dt.Markov(rates), 0.1, noise=1e100, forgetting=1e-15, initial=often)
    args = SIGNAL, [1.0, -1.0, 0.5], 3.0, 0.1
    run = dt.simulate(plant, dt.BeliefPredictor(held, filt), *args)
    averaged = dt.simulate(plant, dt.AveragedPredictor(plant, K, often / often.sum()), *args)
    plants.close(run.belief, np.tile(often[:, None], run.time.size), 1e-12)
    plants.close(run.inputs, averaged.inputs, 1e-12)


def test_a_run_lays_its_belief_on_the_times_asked_for():
    law = dt.BeliefPredictor(LAWS["mode"], FILTERS["markov"](disturbance=0.2))
    args = PLANT, law, SIGNAL, [1.0, -1.0, 0.5], 2.0, 0.1
    run, asked = dt.simulate(*args), dt.simulate(*args, times=[0.05, 0.1, 1.99])
    assert (asked.belief == run.belief[:, [0, 1, 19]]).all()
    plants.close(run.belief.sum(axis=0), np.ones(21), 1e-12)
    assert (run.to_pandas()["belief[2]"].to_numpy() == run.belief[2]).all()
    assert (run.to_xarray()["belief"].to_numpy() == run.belief).all()
    assert dt.simulate(PLANT, LAWS["mode"], *args[2:]).belief is None


class SlowToForget(BeliefFilter):
    """A filter of one's own: another one with less forgetting."""

    def __init__(self, filt):
        own = {name: getattr(filt, name) for name in ("plant", "step", "disturbance", "outputs")}
        vars(self).update(**own, filt=filt)

    def form(self, ages=1):
        form = self.filt.form(ages)
        return form._replace(forgetting=1e-12)


def test_a_filter_of_ones_own_runs_as_the_filter_that_has_its_data():
    model = plants.markov(3)
    law = dt.ExpectedPredictor(PLANT, plants.gains(PLANT), model)
    own = {"disturbance": 0.1, "noise": 0.01}
    same, other = (dt.ModeFilter(PLANT, model, 0.05, **own, forgetting=f) for f in (1e-12, 1e-3))
    wanted, found = (
        dt.Controller(dt.BeliefPredictor(law, filt), 0.05) for filt in (same, SlowToForget(other))
    )
    for x in np.random.default_rng(0).normal(size=(20, PLANT.states)):
        assert np.array_equal(found.update(x), wanted.update(x))
        assert np.array_equal(found.belief, wanted.belief)
