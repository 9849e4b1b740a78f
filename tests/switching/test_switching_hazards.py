"""Hazards of sojourns on a grid of samples: what a controller that counts samples works with."""

import re

import numpy as np
import pytest
from scipy import stats

from deadtime import ArgumentError, SemiMarkov

STEP, AGES = 0.07, np.arange(200)


class Erlang:
    """No scipy distribution: the sum of two exponentials, with the fewest methods."""

    def cdf(self, t):
        return 1.0 - self.sf(t)

    def sf(self, t):
        return (1.0 + 3.0 * np.asarray(t)) * np.exp(-3.0 * np.asarray(t))


@pytest.mark.parametrize(
    ("sojourn", "survival"),
    [
        (stats.expon(scale=0.5), lambda t: np.exp(-t / 0.5)),
        (stats.expon(loc=0.25, scale=2.0), lambda t: np.exp(-np.maximum(t - 0.25, 0.0) / 2.0)),
        (stats.weibull_min(2.0, scale=3.0), lambda t: np.exp(-((t / 3.0) ** 2))),
        (stats.uniform(0.2, 20.0), lambda t: np.clip((20.2 - t) / 20.0, 0.0, 1.0)),
        (Erlang(), lambda t: (1.0 + 3.0 * t) * np.exp(-3.0 * t)),
        (stats.pareto(3.0, scale=0.2), lambda t: np.maximum(t / 0.2, 1.0) ** -3.0),
    ],
    ids=["exponential", "shifted", "weibull", "uniform", "duck", "pareto"],
)
def test_hazards_have_their_closed_form(sojourn, survival):
    haz = SemiMarkov([sojourn, 5.0]).hazard(STEP, AGES.size)
    expected = 1.0 - survival((AGES + 1) * STEP) / survival(AGES * STEP)
    assert haz.shape == (2, AGES.size)
    assert haz[0] == pytest.approx(expected, rel=1e-11, abs=1e-13)


def test_hazards_multiply_up_to_the_survival():
    for dist in (stats.gamma(3.0, scale=0.4), stats.lognorm(0.7), stats.geom(0.3)):
        haz = SemiMarkov(dist).hazard(STEP, 150)[0]
        reached = np.cumprod(1.0 - haz)
        assert reached == pytest.approx(dist.sf((AGES[:150] + 1) * STEP), rel=1e-10)


@pytest.mark.parametrize("count", [2, 3, 6, 7, 11, 55, 999])
@pytest.mark.parametrize("step", [0.1, 0.01, 0.07, 1 / 3, 1e-6])
@pytest.mark.parametrize("off", [0.0, -9e-10, 9e-10])
def test_a_sojourn_of_k_steps_ends_at_the_kth_sample(count, step, off):
    """Also where floats disagree, such as 0.3/0.1 < 3, and up to 1e-9 steps beside it."""
    for length in ((count + off) * step, float(f"{count * step:.12g}") + off * step):
        model = SemiMarkov(length)
        haz = model.hazard(step, count + 2)
        assert haz.tolist() == [[0.0] * (count - 1) + [1.0] * 3] * 2
        assert model.ages(step) == count


def test_a_sojourn_off_the_grid_by_more_than_the_tolerance_ends_a_sample_later():
    assert SemiMarkov(0.3 * (1 + 1e-8)).hazard(0.1, 5)[0].tolist() == [0, 0, 0, 1, 1]
    assert SemiMarkov(0.35).hazard(0.1, 5)[0].tolist() == [0, 0, 0, 1, 1]


@pytest.mark.parametrize("end", [0.7, 0.1 + 0.6, 0.7 + 5e-11, 0.7 - 5e-11])
def test_the_end_of_a_support_counts_as_the_sample_beside_it(end):
    model = SemiMarkov(stats.uniform(0.1, end - 0.1))
    assert model.hazard(0.1, 9)[0] == pytest.approx([0, 1 / 6, 1 / 5, 1 / 4, 1 / 3, 1 / 2, 1, 1, 1])
    assert model.hazard(0.1, 9)[0, 6:].tolist() == [1.0, 1.0, 1.0]
    assert model.ages(0.1) == 7


@pytest.mark.parametrize(
    ("sojourn", "step", "ages"),
    [
        (stats.expon(scale=0.5), 0.1, 1),
        (stats.expon(scale=3600.0), 0.01, 1),
        (stats.expon(loc=0.3, scale=0.5), 0.1, 4),
        (stats.expon(loc=0.07, scale=0.5), 0.01, 8),
        (stats.expon(loc=0.35, scale=0.5), 0.1, 5),
        (stats.uniform(0.2, 0.8), 0.1, 10),
        (stats.uniform(0.2, 0.85), 0.1, 11),
        ([0.3, 0.5], 0.1, 5),
        (stats.weibull_min(2.0), 0.1, int(np.ceil(np.sqrt(6.0 * np.log(10.0)) / 0.1))),
    ],
)
def test_ages_end_where_hazards_stay_or_survival_is_below_a_millionth(sojourn, step, ages):
    assert SemiMarkov(sojourn).ages(step) == ages


@pytest.mark.few(1)
@pytest.mark.parametrize("most", [1, 7, 500, 99_999, 250_000])
def test_the_count_of_ages_stops_where_it_is_told_to(most):
    """However long or heavy the tail; what needs fewer ages is counted as before."""
    for tail in (
        3600.0,
        stats.lomax(1.0),
        stats.levy(scale=1.0),
        stats.pareto(1.5),
        stats.lognorm(2.0, scale=0.8),
    ):
        assert SemiMarkov([1.0, tail]).ages(0.01, most=most) == most
    assert SemiMarkov(stats.expon(scale=3600.0)).ages(0.01, most=most) == 1
    assert SemiMarkov(stats.expon(loc=0.3, scale=0.5)).ages(0.1, most=most) == min(4, most)
    assert SemiMarkov(1500.0).ages(0.01, most=most) == min(150_000, most)


def test_those_that_outlive_a_time_are_the_survival_of_every_mode():
    dists = [stats.gamma(2.0, scale=0.3), stats.lomax(1.0)]
    model = SemiMarkov([*dists, Erlang(), 0.3])
    for time in (0.0, 0.1, 0.3, 7.0):
        expected = [*(dist.sf(time) for dist in dists), Erlang().sf(time), float(time < 0.3)]
        assert model.outlives(time) == pytest.approx(expected, rel=1e-12)


def test_a_table_of_values_has_its_hazards():
    model = SemiMarkov(stats.rv_discrete(values=([1, 2, 4], [0.25, 0.25, 0.5]))())
    assert model.hazard(0.5, 9)[0] == pytest.approx([0, 0.25, 0, 1 / 3, 0, 0, 0, 1, 1], rel=1e-12)
    assert model.ages(0.5) == 8


def test_beyond_the_ages_nothing_is_left_to_know():
    for dist in (stats.gamma(2.0, scale=0.3), stats.lognorm(0.5), Erlang()):
        model = SemiMarkov(dist)
        ages = model.ages(0.05)
        assert np.exp(np.log1p(-model.hazard(0.05, ages)[0]).sum()) < 1e-6
        assert np.exp(np.log1p(-model.hazard(0.05, ages - 1)[0]).sum()) >= 0.99e-6


def test_the_longest_step_that_the_message_names_is_admissible():
    for dist in (stats.gamma(2.0, scale=0.3), stats.uniform(0.1, 0.4), 0.3, stats.expon()):
        model = SemiMarkov(dist)
        with pytest.raises(ArgumentError) as refused:
            model.ages(0.9)
        longest = float(re.search(r"at most (\S+) s\.", str(refused.value))[1])
        assert model.ages(longest) >= 1
        with pytest.raises(ArgumentError, match="too long"):
            model.hazard(1.001 * longest, 3)


semi = SemiMarkov


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: semi(1.0).hazard(0.0, 3), "step must be positive, in s, got 0."),
        (lambda: semi(1.0).hazard(0.1, 0), "ages must be an integer of at least 1, got 0."),
        (
            lambda: semi([1.0, stats.expon(scale=0.5)]).hazard(0.2, 3),
            "step = 0.2 s is too long for the sojourns: half of those in mode 1 last at most "
            "0.3466 s, less than two steps; take at most 0.1732 s.",
        ),
        (lambda: semi(0.3).ages(0.16), "half of those in mode 0 last at most 0.3 s"),
        (
            lambda: semi([1.0, stats.lomax(1.0)]).ages(0.01),
            "step = 0.01 s is too short for sojourn[1] = lomax(1): its hazard still changes after "
            "100,000 steps, which it outlives with probability 0.001; lengthen the step, or "
            "limit the number of ages by `most`.",
        ),
        (lambda: semi(1.0).ages(0.01, most=0), "most must be an integer of at least 1, got 0."),
        (lambda: semi(1.0).outlives(np.nan), "time must be finite, got nan."),
        (lambda: semi(3600.0).ages(0.01), "step = 0.01 s is too short for sojourn[0] = 3600"),
    ],
)
def test_a_step_that_does_not_suit_the_sojourns_is_refused_by_name(call, message):
    with pytest.raises(ArgumentError, match=re.escape(message)):
        call()
