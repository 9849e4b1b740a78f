"""What knowing the switching brings: the laws over many signals, on three plants."""

import numpy as np
import pytest
from scipy import stats

import deadtime as dt
from deadtime.scenarios import scenario_seed

PAPER = dt.problems.paper()
THREE = dt.problems.three_mode()
START = float(np.linalg.norm(PAPER.x0))

# Sojourns τ_d + Exp(τ_d): medians of ∫|x|² that an earlier study found on 400 other signals,
# ± 10 %.
EARLIER = {
    0.1: {"averaged": 128, "mean": 116, "expected": 115, "oracle": 107},
    0.2: {"averaged": 147, "mean": 132, "expected": 125, "oracle": 107},
    0.4: {"averaged": 308, "mean": 244, "expected": 134, "oracle": 105},
    0.8: {"averaged": 1330, "mean": 1400, "expected": 141, "oracle": 92},
    1.6: {"averaged": 5000, "mean": 8200, "expected": 105, "oracle": 81},
}
OF_THE_PAPER = ("averaged", "mean", "mode 0 only", "mode 1 only")


def shifted(dwell_time):
    return dt.SemiMarkov(stats.expon(loc=dwell_time, scale=dwell_time))


def expected(model):
    return dt.ExpectedPredictor(PAPER.plant, PAPER.gains, model)


@pytest.fixture(scope="module")
def table():
    """Metrics on 400 paired signals at every dwell time of the table."""
    result = {}
    for dwell_time in EARLIER:
        model = shifted(dwell_time)
        laws = {name: PAPER.laws[name] for name in (*OF_THE_PAPER, "oracle")}
        laws["expected"] = expected(model)
        result[dwell_time] = dt.monte_carlo(PAPER.plant, laws, model, PAPER.x0, 15.0, scenarios=400)
    return result


def median_interval(values, confidence=0.99):
    """Distribution-free confidence interval of a median."""
    ordered = np.sort(values)
    low, high = stats.binom(values.size, 0.5).interval(confidence)
    return ordered[int(low)], ordered[int(high)]


@pytest.mark.parametrize("dwell_time", EARLIER)
@pytest.mark.parametrize("law", ["averaged", "mean", "expected", "oracle"])
def test_the_medians_of_an_earlier_study_are_found_again(table, dwell_time, law):
    low, high = median_interval(table[dwell_time].ise.sel(law=law).values)
    assert low / 1.1 <= EARLIER[dwell_time][law] <= high * 1.1


@pytest.mark.parametrize("dwell_time", EARLIER)
def test_the_expected_law_has_the_least_median_of_all_causal_laws(table, dwell_time):
    median = table[dwell_time].ise.median("scenario")
    for law in OF_THE_PAPER:
        assert median.sel(law="expected") <= median.sel(law=law)


def test_where_both_laws_of_the_paper_grow_the_expected_law_decays(table):
    data = table[0.8]
    smaller = (data.final_norm < START).mean("scenario")
    growth = -data.decay_rate.median("scenario")
    assert growth.sel(law="averaged") > 0.0
    assert growth.sel(law="mean") > 0.0
    assert smaller.sel(law="expected") >= 0.98


def test_the_same_seed_gives_the_same_figures(table):
    again = dt.monte_carlo(
        PAPER.plant,
        {"expected": expected(shifted(0.4))},
        shifted(0.4),
        PAPER.x0,
        15.0,
        scenarios=20,
    )
    first = table[0.4].sel(law=["expected"], scenario=slice(0, 19))
    assert np.array_equal(again.ise.values, first.ise.values)


# -- models fitted from logs, and wrong ones ---------------------------------------------------


@pytest.fixture(scope="module")
def models():
    """Cost on 300 paired signals, dwell time 0.4 s, of laws with several models."""
    truth = shifted(0.4)
    # One log each, of about 200 sojourns.
    fitted = {f"fitted {s}": dt.SemiMarkov.fit(truth.sample(164.0, seed=s)) for s in (1, 2, 3)}
    for model in fitted.values():
        assert 180 <= sum(mode.complete for mode in model.goodness) <= 220
    wrong = {
        "thrice as fast": dt.SemiMarkov(stats.expon(loc=0.4 / 3, scale=0.4 / 3)),
        "thrice as slow": dt.SemiMarkov(stats.expon(loc=1.2, scale=1.2)),
    }
    laws = {
        name: expected(model) for name, model in (("true", truth), *fitted.items(), *wrong.items())
    }
    laws["mean"] = PAPER.laws["mean"]
    return dt.monte_carlo(PAPER.plant, laws, truth, PAPER.x0, 15.0, scenarios=300).cost


@pytest.mark.parametrize("log", [1, 2, 3])
def test_a_model_fitted_from_200_sojourns_loses_at_most_5_percent(models, log):
    ratio = models.sel(law=f"fitted {log}") / models.sel(law="true")
    assert ratio.median() <= 1.05
    assert models.sel(law=f"fitted {log}").median() <= 1.05 * models.sel(law="true").median()


@pytest.mark.parametrize(
    ("wrong", "low", "high"), [("thrice as fast", 1.3, 1.9), ("thrice as slow", 2.0, 3.2)]
)
def test_a_model_whose_rate_is_off_by_three_costs_that_much_more(models, wrong, low, high):
    assert low <= (models.sel(law=wrong) / models.sel(law="true")).median() <= high


# -- dwell time ---------------------------------------------------------------------------------


class ThreeModes:
    """Signals of the three-mode plant: sojourns 0.9 + Exp(0.9)."""

    def sample(self, horizon, seed=0):
        return dt.SwitchingSignal.random(3, horizon, dwell_time=0.9, seed=seed)


def test_knowing_the_dwell_time_wins_on_80_percent_of_signals_of_the_three_mode_plant():
    plant, K, plain = THREE.plant, THREE.gains, THREE.laws["mean"]
    laws = {
        "averaged": THREE.laws["averaged"],
        "averaged, dwell-aware": dt.AveragedPredictor(plant, K, None, 0.9),
        "mean": plain,
        "mean, dwell-aware": dt.MeanPredictor(plant, plain.gain, K, 0.9, plain.mean),
    }
    data = dt.monte_carlo(plant, laws, ThreeModes(), THREE.x0, 15.0, scenarios=1000)
    for law in ("averaged", "mean"):
        for metric, most in (("ise", 0.7), ("cost", 0.8)):
            values = data[metric]
            ratio = values.sel(law=f"{law}, dwell-aware") / values.sel(law=law)
            assert (ratio < 1.0).mean() >= 0.8
            assert ratio.median() <= most


def test_a_law_that_relies_on_a_dwell_time_that_is_not_kept_loses_its_advantage():
    signals = [
        dt.SwitchingSignal.random(3, 16.0, dwell_time=0.1, seed=scenario_seed(0, i))
        for i in range(200)
    ]
    K = THREE.gains
    laws = {
        "plain": THREE.laws["averaged"],
        "believes 0.9 s": dt.AveragedPredictor(THREE.plant, K, None, 0.9),
        "knows 0.1 s": dt.AveragedPredictor(THREE.plant, K, None, 0.1),
    }
    median = dt.monte_carlo(THREE.plant, laws, signals, THREE.x0, 15.0).ise.median("scenario")
    assert median.sel(law="believes 0.9 s") > 1.2 * median.sel(law="plain")
    assert median.sel(law="knows 0.1 s") <= median.sel(law="plain")
