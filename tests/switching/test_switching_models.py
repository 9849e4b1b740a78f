"""Switching models: what they draw, and what they refuse."""

import re

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import expm

from deadtime import ArgumentError, Markov, SemiMarkov
from deadtime.switching.models import jump_process

RATES = np.array([[0.0, 2.0, 1.0], [0.5, 0.0, 1.5], [4.0, 1.0, 0.0]])
JUMPS = np.array([[0.0, 0.8, 0.2], [0.5, 0.0, 0.5], [1.0, 0.0, 0.0]])


class Hyperexponential:
    """No scipy distribution: an equal mixture of two exponentials, with the fewest methods."""

    def cdf(self, t):
        return 1.0 - np.exp(self.logsf(t))

    def logsf(self, t):
        return np.log((np.exp(-np.asarray(t)) + np.exp(-np.asarray(t) / 3.0)) / 2.0)


def lengths(signal, mode):
    return np.diff(signal.times)[signal.modes[:-1] == mode]


def z_score(sample, mean, deviation):
    return (sample.mean() - mean) / (deviation / np.sqrt(sample.size))


def assert_jumps(signal, transition):
    """The jumps out of every mode pass a chi-square test against their probabilities."""
    for mode, row in enumerate(transition):
        after = signal.modes[1:][signal.modes[:-1] == mode]
        found = np.bincount(after, minlength=row.size)
        assert (found[row == 0.0] == 0).all()
        if (row > 0.0).sum() > 1:
            expected = row[row > 0.0] * after.size
            assert stats.chisquare(found[row > 0.0], expected).pvalue > 0.01


# -- drawing -------------------------------------------------------------------------------


def test_markov_sojourns_are_exponential_and_jumps_follow_the_rates():
    model = Markov(RATES)
    signal = model.sample(4000.0, seed=1)
    exits = RATES.sum(axis=1)
    assert model.mean == pytest.approx(1.0 / exits, rel=1e-15)
    for mode, rate in enumerate(exits):
        drawn = lengths(signal, mode)
        assert abs(z_score(drawn, 1.0 / rate, 1.0 / rate)) < 3.0
        assert stats.kstest(drawn, stats.expon(scale=1.0 / rate).cdf).pvalue > 0.01
    assert_jumps(signal, RATES / exits[:, None])


def test_markov_occupation_follows_the_exponential_of_the_generator():
    model, time, count = Markov(RATES), 0.4, 2000
    assert model.generator.sum(axis=1) == pytest.approx(np.zeros(3), abs=1e-15)
    modes = [model.sample(0.5, seed=seed)(time) for seed in range(count)]
    expected = np.full(3, 1.0 / 3.0) @ expm(model.generator * time)
    assert stats.chisquare(np.bincount(modes), expected * count).pvalue > 0.01


def test_a_mode_that_no_rate_leaves_is_kept_for_ever():
    model = Markov([[0.0, 1.0], [0.0, 0.0]])
    signals = [model.sample(100.0, seed=seed) for seed in range(20)]
    assert {signal.switches for signal in signals} == {0, 1}
    assert all(signal.modes[-1] == 1 for signal in signals)
    assert model.mean.tolist() == [1.0, np.inf]
    single = Markov([[0.0]]).sample(3.0)
    assert (single.switches, single.end) == (0, 3.0)


def test_the_diagonal_of_the_rates_may_be_that_of_the_generator():
    generator = RATES - np.diag(RATES.sum(axis=1) * (1.0 + 1e-12))
    assert np.array_equal(Markov(generator).rates, RATES)
    assert Markov(generator).sample(9.0).times.tolist() == Markov(RATES).sample(9.0).times.tolist()


def test_semi_markov_sojourns_follow_their_distributions_and_jumps_their_probabilities():
    sojourn = [stats.gamma(3.0, scale=0.2), 0.4, stats.expon(loc=0.3, scale=0.5)]
    model = SemiMarkov(sojourn, JUMPS)
    signal = model.sample(3000.0, seed=2)
    assert model.mean == pytest.approx([0.6, 0.4, 0.8], rel=1e-12)
    for mode in (0, 2):
        drawn = lengths(signal, mode)
        assert abs(z_score(drawn, sojourn[mode].mean(), sojourn[mode].std())) < 3.0
        assert stats.kstest(drawn, sojourn[mode].cdf).pvalue > 0.01
    assert lengths(signal, 1) == pytest.approx(0.4, rel=1e-9)
    assert_jumps(signal, JUMPS)


def test_the_first_mode_is_uniform_and_its_sojourn_whole():
    model = SemiMarkov([0.2, 0.3, 0.4])
    firsts = [model.sample(1.0, seed=seed) for seed in range(600)]
    starts = [int(signal.modes[0]) for signal in firsts]
    assert stats.chisquare(np.bincount(starts)).pvalue > 0.01
    assert all(s.times[1] == [0.2, 0.3, 0.4][i] for s, i in zip(firsts, starts, strict=True))


@pytest.mark.parametrize(
    "model",
    [
        Markov(RATES),
        SemiMarkov(stats.lognorm(0.5), modes=3),
        SemiMarkov([Hyperexponential(), 0.3]),
        SemiMarkov([stats.invgauss(0.5), stats.geom(0.4), 0.3], JUMPS),
    ],
    ids=["markov", "lognormal", "duck", "mixed"],
)
def test_a_seed_fixes_the_signal_and_a_longer_horizon_continues_it(model):
    short, again, long, other = (
        model.sample(horizon, seed=seed) for horizon, seed in [(9, 7), (9, 7), (200, 7), (9, 8)]
    )
    count = short.times.size
    assert long.switches > 64 * model.modes / 2
    assert np.array_equal(short.times, again.times)
    assert np.array_equal(short.times, long.times[:count])
    assert np.array_equal(short.modes, long.modes[:count])
    assert long.times[count] >= short.end == 9.0
    assert not np.array_equal(short.times, other.times)


def test_sojourns_too_short_for_doubles_are_left_out():
    """Most sojourns in mode 1 are below 1e-17 s, and their neighbours in mode 0 become one."""
    signal = SemiMarkov([stats.gamma(2.0), stats.gamma(0.01)]).sample(500.0, seed=1)
    assert signal.dwell_time > 0.0
    assert lengths(signal, 0).mean() > 4.0


def test_the_number_of_modes_comes_from_the_list_the_jumps_or_the_argument():
    assert SemiMarkov(1.0).modes == 2
    assert SemiMarkov(1.0, modes=4).modes == 4
    assert SemiMarkov(1.0, JUMPS).modes == 3
    assert SemiMarkov([1.0, 2.0, 3.0], JUMPS, modes=3).modes == 3
    assert SemiMarkov(np.array([1.0, 2.0])).transition.tolist() == [[0.0, 1.0], [1.0, 0.0]]
    assert SemiMarkov(1.0, modes=3).transition[1].tolist() == [0.5, 0.0, 0.5]


def test_any_object_with_the_methods_is_a_distribution():
    model = SemiMarkov(Hyperexponential())
    assert model.mean == pytest.approx([2.0, 2.0], rel=1e-8)
    drawn = np.diff(model.sample(2000.0, seed=4).times)
    assert stats.kstest(drawn, Hyperexponential().cdf).pvalue > 0.01


def test_models_are_immutable_and_say_what_they_are():
    model = SemiMarkov([stats.gamma(2.0, scale=0.5), 0.3])
    assert repr(model) == "SemiMarkov(modes=2, sojourn=[gamma(2, scale=0.5), 0.3])"
    assert repr(Markov(RATES)) == "Markov(modes=3, mean sojourns 0.333, 0.5, 0.2 s)"
    for array in (model.transition, model.mean, Markov(RATES).rates):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(AttributeError):
        model.transition = JUMPS


# -- refusals ------------------------------------------------------------------------------


def test_a_signal_that_memory_cannot_hold_is_refused_while_it_is_drawn(monkeypatch):
    monkeypatch.setattr(jump_process, "MOST_SWITCHES", 1000.0)
    model = SemiMarkov([1e-4, 1e-4, 1e6], [[0, 1, 0], [1, 0, 0], [1, 0, 0]])
    with pytest.raises(ArgumentError, match=re.escape("would hold about 1e+04 switches")):
        model.sample(1.0, seed=0)


semi = SemiMarkov


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Markov([[0.0, 1.0]]), "rates must have shape (modes, modes), got (1, 2): give"),
        (lambda: Markov([[0, -1], [1, 0]]), "rates[0, 1] must be ≥ 0, in 1/s, got -1."),
        (lambda: Markov([[0, np.nan], [1, 0]]), "rates[0, 1] must be finite, got nan."),
        (
            lambda: Markov([[-2, 1.5], [1, 0]]),
            "rates[0, 0] must be 0 or minus the sum of the other rates in its row, -1.5, got -2: "
            "give the rates off the diagonal only.",
        ),
        (lambda: Markov(RATES).sample(0.0), "horizon must be positive, in s, got 0."),
        (lambda: Markov(RATES).sample(1.0, seed=-1), "seed must be an integer of at least 0"),
        (
            lambda: Markov(1e9 * RATES).sample(1.0),
            "horizon = 1 s would hold about 2e+09 switches, more than 1e+07: shorten it",
        ),
        (lambda: semi(1e-9).sample(1.0), "would hold about 1e+09 switches"),
        (lambda: semi(1.0).sample(-1.0), "horizon must be positive, in s, got -1."),
        (lambda: semi(1.0).sample(1.0, seed=-1), "seed must be an integer of at least 0"),
        (lambda: semi(0.0), "sojourn must be positive, in s, got 0."),
        (lambda: semi([1.0, -1.0]), "sojourn[1] must be positive, in s, got -1."),
        (lambda: semi([1.0, np.nan]), "sojourn[1] must be finite, got nan."),
        (
            lambda: semi([stats.expon, 1.0]),
            "sojourn[0] must be a frozen distribution, got expon without its parameters: freeze "
            "it: expon(scale=…).",
        ),
        (lambda: semi(stats.gamma), "sojourn must be a frozen distribution, got gamma without"),
        (lambda: semi(stats.gamma), "freeze it: gamma(a=…, scale=…)."),
        (lambda: semi(stats.geom), "freeze it: geom(p=…)."),
        (
            lambda: semi([stats.rv_discrete(values=([1, 2], [0.5, 0.5])), 1.0]),
            "sojourn[0] must be a frozen distribution, got one that is not: call it, …().",
        ),
        (
            lambda: semi([stats.norm(1.0, 0.5), 1.0]),
            "sojourn[0] must be positive with probability 1, got norm(1, 0.5) with "
            "P(sojourn ≤ 0) = 0.0228: use a distribution on (0, ∞) such as gamma",
        ),
        (
            lambda: semi(stats.expon(scale=np.nan)),
            "sojourn must have valid parameters, got expon(scale=nan) with cdf(0) = nan.",
        ),
        (
            lambda: semi(stats.expon(scale=[1.0, 2.0])),
            "sojourn must be one distribution, got expon(scale=[1.0, 2.0]), an array of 2: give",
        ),
        (
            lambda: semi([1.0, "expon"]),
            "sojourn[1] must be a positive number of seconds or a frozen scipy.stats distribution "
            "(an object with cdf, and sf or logsf), got str.",
        ),
        (lambda: semi(None), "sojourn must be a positive number of seconds or a frozen"),
        (lambda: semi(stats.multivariate_normal([0, 0])), "got multivariate_normal_frozen."),
        (lambda: semi([1.0]), "sojourn must be given for at least two modes, got 1: a signal"),
        (lambda: semi(1.0, [[0.0]]), "transition must be given for at least two modes, got 1"),
        (lambda: semi(1.0, modes=1), "modes must be an integer of at least 2, got 1."),
        (
            lambda: semi([1.0, 2.0], JUMPS),
            "sojourn must have one entry per mode, 3, got 2: a single distribution, not in a "
            "list, holds for all modes.",
        ),
        (lambda: semi([1.0, 2.0], modes=3), "sojourn must have one entry per mode, 3, got 2"),
        (
            lambda: semi(1.0, JUMPS, modes=2),
            "modes = 2 and transition with 3 rows disagree: give one of them.",
        ),
        (lambda: semi(1.0, [[0, 1]]), "transition must have shape (modes, modes) = (1, 1), got"),
        (
            lambda: semi(1.0, [[0.0, 1.0], [0.9, 0.1]]),
            "transition[1, 1] must be 0, got 0.1: a jump leads to another mode",
        ),
        (
            lambda: semi(1.0, [[0.0, 1.0], [0.9, 0.0]]),
            "transition[1] must be probabilities, ≥ 0 with sum 1, got [0.9, 0.0] with sum 0.9: "
            "if none is negative, divide them by their sum.",
        ),
        (lambda: semi(1.0, [[0, 2, -1], *JUMPS[1:]]), "transition[0] must be probabilities"),
    ],
)
def test_a_malformed_model_is_refused_by_name(call, message):
    with pytest.raises(ArgumentError, match=re.escape(message)):
        call()
