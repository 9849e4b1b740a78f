"""What a mode filter and a law on a belief refuse, each by name."""

import numpy as np
import pytest

import deadtime as dt
import plants

PLANT, MODEL = plants.paper(), plants.markov(2)
LAW = dt.ExpectedPredictor(PLANT, plants.gains(PLANT), MODEL)
FILTER = dt.ModeFilter(PLANT, MODEL, 0.1, disturbance=0.01)
THREE = plants.generic()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": plants.markov(3)}, "model must have the plant's 2 modes, got 3"),
        ({"step": 0.0}, "step must be positive"),
        ({"disturbance": -1.0}, "disturbance must be positive semidefinite"),
        ({"disturbance": [[1.0, 2.0], [0.0, 1.0]]}, "disturbance must be symmetric"),
        ({"disturbance": [1.0, 1.0, 1.0]}, r"disturbance must have shape \(n, n\) = \(2, 2\)"),
        ({"disturbance": np.nan}, "disturbance.* must be finite"),
        ({"noise": -0.1}, "noise must be ≥ 0, a standard deviation"),
        ({"noise": [0.1] * 3}, r"noise must have shape \(n,\) = \(2,\), got \(3,\)"),
        ({"switches": "never"}, 'switches must be "anywhere" or "samples", got \'never\''),
        ({"forgetting": 0.0}, r"forgetting must be above 0 and below 1, got 0"),
        ({"forgetting": 1.0}, r"forgetting must be above 0 and below 1, got 1"),
        ({"initial": [0.5, 0.6]}, "initial must be probabilities, ≥ 0 with sum 1"),
        ({"disturbance": [1e10, -1]}, r"disturbance must be positive semidefinite, got -1"),
        ({"initial": [1.5, -0.5]}, "initial must be probabilities, ≥ 0 with sum 1"),
        ({"initial": [1.0]}, r"initial must have shape \(modes,\) or \(modes, ages\)"),
        ({"ages": 3}, "ages must be left out of a Markov model"),
        ({"model": dt.SemiMarkov(1.0), "ages": 0}, "ages must be an integer of at least 1"),
        ({"model": dt.SemiMarkov(0.15)}, "step = 0.1 s is too long for the sojourns"),
    ],
)
def test_a_filter_refuses(options, message):
    given = {"plant": PLANT, "model": MODEL, "step": 0.1} | options
    with pytest.raises(dt.ArgumentError, match=message):
        dt.ModeFilter(**given)


def test_modes_that_nothing_tells_apart_are_refused_by_name_or_share_what_the_model_says():
    plant = dt.SwitchedSystem(THREE.A[[0, 1, 0]], THREE.B[[0, 1, 0]], 0.234)
    with pytest.raises(dt.ArgumentError, match="modes 0 and 2 cannot be distinguished"):
        dt.ModeFilter(plant, plants.markov(3), 0.1)
    later = dt.SwitchedSystem(plant.A, plant.B, [[0.2], [0.2], [0.3]])
    dt.ModeFilter(later, plants.markov(3), 0.1)  # the delay tells
    filt = dt.ModeFilter(plant, plants.markov(3), 0.1, allow_alike=True)
    alone = filt.start()
    ratio = [found[0] / found[2] for found in (alone.update(np.ones(3) * k) for k in range(4))]
    assert np.isfinite(ratio).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"x": [1.0]}, r"x must have shape \(n,\) = \(2,\), got \(1,\)"),
        ({"u": [1.0, 2.0]}, r"u must have shape \(m,\) = \(1,\), got \(2,\)"),
        ({"u": [np.nan]}, r"u\[0\] must be finite"),
        ({"belief": [0.5, 0.4]}, "belief must be probabilities, ≥ 0 with sum 1, got .* sum 0.9"),
        ({"belief": [1.2, -0.2]}, "belief must be probabilities"),
        ({"belief": [1.0, 0.0, 0.0]}, r"belief must have shape \(modes,\) or \(modes, ages\)"),
    ],
)
def test_a_filter_that_runs_refuses_and_stays_as_it_was(options, message):
    running = FILTER.start()
    running.update([1.0, 1.0])
    before = running.belief.copy()
    with pytest.raises(dt.ArgumentError, match=message):
        running.update(**({"x": [1.0, 1.0]} | options))
    assert (running.belief == before).all()
    with pytest.raises(dt.ArgumentError, match=r"u0 must have shape \(m, N\) = \(1, 10\)"):
        FILTER.start([[0.0]])


@pytest.mark.parametrize(
    ("law", "filt", "message"),
    [
        (1.0, FILTER, "law must be a Law, got float"),
        (
            LAW,
            1.0,
            "filter must be a ModeFilter, an OutputModeFilter or another BeliefFilter, got float",
        ),
        (
            dt.AveragedPredictor(PLANT, plants.gains(PLANT)),
            FILTER,
            r"AveragedPredictor \(averaged\) does not read the mode",
        ),
        (dt.ExactPredictor(PLANT, plants.gains(PLANT)), FILTER, "ExactPredictor needs a preview"),
        (
            dt.StateDependentPredictor(PLANT, plants.gains(PLANT), dt.HalfSpace([1.0, 0.0], 0.0)),
            FILTER,
            "StateDependentPredictor is no table",
        ),
        (dt.BeliefPredictor(LAW, FILTER), FILTER, "BeliefPredictor is no table"),
        (
            LAW,
            dt.ModeFilter(THREE, plants.markov(3), 0.1),
            "filter must be of a plant with the law's 2 modes, got 3",
        ),
        (
            LAW,
            dt.ModeFilter(plants.paper(1.3), MODEL, 0.1),
            "filter must read inputs of the last 10 periods, as the law does, got 13",
        ),
    ],
)
def test_a_law_on_a_belief_refuses(law, filt, message):
    with pytest.raises(dt.ArgumentError, match=message):
        dt.BeliefPredictor(law, filt)


def test_a_law_on_a_belief_is_no_table_and_has_the_period_of_its_filter():
    law, signal = dt.BeliefPredictor(LAW, FILTER), dt.SwitchingSignal.constant(0)
    with pytest.raises(dt.ArgumentError, match="BeliefPredictor has no table"):
        dt.growth_rate(PLANT, law, 0, 0.1)
    with pytest.raises(dt.ArgumentError, match="step must be given for BeliefPredictor"):
        dt.simulate(PLANT, law, signal, [1.0, 1.0], 1.0, step=None)
    with pytest.raises(dt.ArgumentError, match=r"step must be the filter's, 0\.1 s, got 0\.05"):
        dt.simulate(PLANT, law, signal, [1.0, 1.0], 1.0, step=0.05)
    assert dt.certify(PLANT, law, 1.0, step=0.1).stable is None
    assert not dt.falsify(PLANT, law, 1.0, step=0.1, budget=4000).proven  # a search in runs
