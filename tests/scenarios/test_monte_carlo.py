"""`monte_carlo`: paired signals, plain runs, and what it refuses."""

import re
import warnings

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.scenarios import monte_carlo, scenario_seed

H = 0.05
X0 = [-1.0, 1.0]
PLANT = plants.paper()
LAWS = {name: plants.LAWS[name](PLANT) for name in ("averaged", "mean with gains", "exact")}
METRICS = ("ise", "energy", "cost", "peak", "settling_time", "decay_rate", "final_norm")


class Random:
    """A switching model; it remembers what it was asked for."""

    def __init__(self, dwell_time=0.2, modes=2):
        self.dwell_time, self.modes, self.asked = dwell_time, modes, []

    def sample(self, horizon, seed=0):
        self.asked.append((horizon, seed))
        return dt.SwitchingSignal.random(self.modes, horizon, dwell_time=self.dwell_time, seed=seed)


def data(plant=PLANT, laws=LAWS, model=None, x0=X0, horizon=4.0, step=H, scenarios=4, **options):
    model = Random() if model is None else model
    return monte_carlo(plant, laws, model, x0, horizon, step, scenarios, **options)


# -- what it returns ---------------------------------------------------------------------------


def test_every_entry_is_the_metric_of_a_plain_run_on_the_scenario_s_signal():
    found = data(seed=3)
    for i in range(4):
        signal = Random().sample(5.0, scenario_seed(3, i))
        for name, law in LAWS.items():
            run = dt.simulate(PLANT, law, signal, X0, 4.0, H)
            entry = found.sel(law=name, scenario=i)
            measured = {key: entry[key].item() for key in METRICS}
            assert measured == pytest.approx(run.metrics(), rel=1e-10)
            assert entry["diverged"].item() is run.diverged


def test_dataset_is_labelled_with_names_units_and_its_setting():
    found = data(seed=3, scenarios=2)
    assert dict(found.sizes) == {"law": 3, "scenario": 2}
    assert found["law"].values.tolist() == list(LAWS)
    assert found["scenario"].values.tolist() == [0, 1]
    assert tuple(found.data_vars) == (*METRICS, "diverged")
    for name in METRICS:
        assert found[name].dims == ("law", "scenario")
        assert found[name].dtype == np.float64
        assert found[name].attrs.keys() == {"units", "long_name"}
    assert found["decay_rate"].attrs["units"] == "1/s"
    assert found["diverged"].dtype == bool
    assert "up to that end" in found["diverged"].attrs["long_name"]
    assert found.attrs == {
        "seed": 3,
        "step": H,
        "horizon": 4.0,
        "modes": 2,
        "states": 2,
        "inputs": 1,
        "delay": 1.0,
        "backend": "numba",
        "imperfections": [],
        "one_by_one": [],
        "one_by_one_because": [],
        "interrupted": 0,
        "grows_above": np.sqrt(2.0),
        "message": "",
        "version": dt.__version__,
    }


def test_a_list_of_laws_is_named_by_their_labels():
    assert data(laws=list(LAWS.values()), scenarios=1)["law"].values.tolist() == [
        "averaged",
        "mean",
        "oracle",
    ]


# -- signals -----------------------------------------------------------------------------------


def test_every_law_sees_the_same_signals():
    law = LAWS["averaged"]
    found = data(laws={"one": law, "other": law}, scenarios=5)
    assert np.array_equal(found.sel(law="one")["ise"], found.sel(law="other")["ise"])
    assert np.unique(found.sel(law="one")["ise"]).size == 5


def test_a_scenario_does_not_depend_on_how_many_there_are_or_on_the_other_laws():
    many, few = data(scenarios=6), data(scenarios=2)
    assert few.equals(many.isel(scenario=slice(2)))
    assert data(laws={"mean with gains": LAWS["mean with gains"]}, scenarios=6).equals(
        many.sel(law=["mean with gains"])
    )


def test_a_list_of_signals_in_another_order_gives_the_same_figures_in_that_order():
    signals = [Random().sample(5.0, seed) for seed in range(4)]
    forwards, backwards = data(model=signals), data(model=signals[::-1])
    for name in METRICS:
        assert np.array_equal(forwards[name].values, backwards[name].values[:, ::-1])


def test_a_model_and_the_list_of_its_signals_give_the_same_dataset():
    model = Random()
    drawn = data(model=model, seed=7)
    signals = [Random().sample(horizon, seed) for horizon, seed in model.asked]
    assert data(model=signals, seed=7, scenarios=1).identical(drawn)


def test_seeds_of_scenarios_are_words_of_philox():
    key = np.random.SeedSequence(11).generate_state(2, np.uint64)
    words = np.random.Philox(key=key).random_raw(9).tolist()
    assert [scenario_seed(11, i) for i in range(9)] == words
    assert not data(seed=1)["ise"].equals(data(seed=2)["ise"])


@pytest.mark.parametrize(("true", "believed", "longest"), [(1.0, 1.0, 1.0), (1.0, 1.2, 1.2)])
def test_signals_reach_the_horizon_plus_the_longest_delay(true, believed, longest):
    model = Random()
    laws = [plants.LAWS["exact"](plants.paper(believed)), plants.LAWS["mean"](plants.paper())]
    data(plant=plants.paper(true), laws=laws, model=model, scenarios=2)
    assert [horizon for horizon, _ in model.asked] == pytest.approx([4.0 + longest] * 2)


def test_signals_that_end_before_the_horizon_are_counted_in_the_message():
    signals = [dt.SwitchingSignal([0, 1], [0, 1], end) for end in (2.0, 4.0, np.inf, 3.0)]
    found = data(laws=[LAWS["averaged"]], model=signals)
    assert found.attrs["message"] == (
        "2 of 4 signals end before the horizon and were continued in their last mode."
    )
    assert np.unique(found["ise"]).size == 1


@pytest.mark.long  # as every one of `test_imperfect_batches.py`, for a plant of other sizes
def test_a_noisy_scenario_can_be_run_alone():
    noise, law = [dt.imperfections.Noise(0.1)], LAWS["averaged"]
    found = data(laws={"law": law}, seed=5, scenarios=3, imperfections=noise)
    assert found.attrs["one_by_one"] == []
    signal = Random().sample(5.0, scenario_seed(5, 2))
    drawn = scenario_seed(5, 2)
    run = dt.simulate(PLANT, law, signal, X0, 4.0, H, imperfections=noise, seed=drawn)
    assert found.ise.values[0, 2] == pytest.approx(run.metrics()["ise"], rel=1e-11)


def test_modes_that_a_model_does_not_know_of_are_mentioned():
    plant = plants.scalar([-1.0, -2.0, 0.1])
    law = dt.DelayedStateFeedback(plant, [[[-0.2]]] * 3)
    found = data(plant, [law], dt.Markov([[0.0, 1.0], [1.0, 0.0]]), [1.0])
    assert found.attrs["message"] == "the model has 2 modes, the plant 3: the others never occur."


# -- divergence --------------------------------------------------------------------------------


def test_a_diverging_law_is_counted_and_leaves_the_others_untouched():
    laws = {"delayed": plants.LAWS["delayed"](PLANT), "averaged": LAWS["averaged"]}
    model = Random()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = data(laws=laws, model=model, horizon=300.0, scenarios=2)
        alone = data(laws={"averaged": LAWS["averaged"]}, horizon=300.0, scenarios=2)
    assert found["diverged"].values.tolist() == [[True, True], [False, False]]
    assert found.sel(law=["averaged"]).equals(alone)
    for name in METRICS:
        assert not np.isnan(found[name]).any()
    run = dt.simulate(PLANT, laws["delayed"], Random().sample(*model.asked[0]), X0, 300.0, H)
    assert found["final_norm"].values[0, 0] == run.metrics()["final_norm"] <= 1e100
    assert np.isfinite(found["ise"]).all()


def test_divergence_depends_on_the_signal_only():
    # Mode 0 for ever grows too slowly to leave the limit, mode 1 does not; mode 2, which never
    # acts, makes the sizes those of the test above.
    plant = plants.scalar([0.1, 60.0, -1.0])
    law = dt.DelayedStateFeedback(plant, [[[-0.2]], [[-61.0]], [[-0.2]]])
    signals = [dt.SwitchingSignal.constant(mode) for mode in (0, 1, 0)]
    found = data(plant, [law], signals, [1.0], 20.0)
    assert found["diverged"].values.tolist() == [[False, True, False]]
    assert found["ise"].values[0, 0] == found["ise"].values[0, 2] < 100.0


# -- progress and refusals ---------------------------------------------------------------------


def test_progress_is_reported_after_each_block():
    seen = []
    model = dt.Markov([[0.0, 5.0], [4.0, 0.0]])
    data(model=model, scenarios=5000, progress=lambda done, total: seen.append((done, total)))
    counts = [done for done, _ in seen]
    assert counts == sorted(counts)
    assert len(counts) >= 3
    assert seen[-1] == (5000, 5000)


class Short:
    def sample(self, horizon, seed=0):
        return dt.SwitchingSignal([0.0], [0], end=horizon / 2)


class Nothing:
    def sample(self, horizon, seed=0):
        return None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"laws": []}, "laws must hold at least one law, got none."),
        ({"laws": {}}, "laws must hold at least one law, got none."),
        (
            {"laws": LAWS["mean with gains"]},
            "laws must be a list of laws, or a dict of names to laws, got MeanPredictor: "
            "for one law, write [law].",
        ),
        ({"laws": ["averaged"]}, "laws must hold laws only, got str."),
        ({"laws": {1: LAWS["exact"]}}, "laws must have names that are strings, got 1."),
        (
            {"laws": [LAWS["exact"], LAWS["exact"]]},
            "laws must have different labels, got 'oracle' twice: name them yourself, with a dict",
        ),
        (
            {"laws": [plants.LAWS["mean"](plants.generic())]},
            "law must be made for a plant with 2 modes, got a law for 3",
        ),
        ({"scenarios": 0}, "scenarios must be an integer of at least 1, got 0."),
        ({"scenarios": True}, "scenarios must be an integer of at least 1, got True."),
        ({"seed": -1}, "seed must be an integer of at least 0, got -1."),
        ({"horizon": 0.0}, "horizon must be positive, in s, got 0."),
        ({"step": 0.0}, "step must be positive, in s, got 0."),
        ({"horizon": 1e12}, "step = 0.05 s is too short: horizon and delay must hold at most"),
        ({"x0": [1.0]}, "x0 must have shape (n,) = (2,), got (1,)."),
        ({"backend": "gpu"}, "backend must be 'numba', the only engine there is, got 'gpu'."),
        ({"backend": "jax"}, "backend must be 'numba', the only engine there is, got 'jax'."),
        ({"threads": 0}, "threads must be an integer of at least 1, got 0."),
        ({"progress": "bar"}, "progress must be True, False or a function (done, total)"),
        (
            {"model": 0.2},
            "model must have a method sample(horizon, seed) that returns a SwitchingSignal, or "
            "be a list of signals, got float.",
        ),
        ({"model": Random}, "model must have a method sample(horizon, seed)"),
        (
            {"model": dt.SwitchingSignal.constant(0)},
            "model must be a switching model or a list of signals, got SwitchingSignal(",
        ),
        ({"model": []}, "model must hold at least one signal, got an empty list."),
        ({"model": [None]}, "model[0] must be a SwitchingSignal, got NoneType."),
        (
            {"model": [dt.SwitchingSignal.constant(mode) for mode in (0, 2)]},
            "model[1]: signal enters mode 2 at 0 s, but the plant's modes are 0..1",
        ),
        ({"model": Random(modes=5)}, "but the plant's modes are 0..1"),
        ({"model": Nothing()}, "must return a SwitchingSignal, got NoneType."),
        (
            {"model": Short()},
            "model.sample(horizon=5) must return a signal known up to its horizon, got one that "
            "ends at 2.5 s.",
        ),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(options, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        data(**options)
