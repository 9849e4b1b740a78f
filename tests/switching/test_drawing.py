"""Drawing many signals at once: the generator, the law of what is drawn, and what is refused."""

import re
import subprocess
import sys
from bisect import bisect_right
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import expm

from batches import equal
from deadtime import ArgumentError, Markov, SemiMarkov, SignalBatch, SwitchingSignal
from deadtime.numerics import streams
from deadtime.numerics.generators import block_words, uniform, uniforms
from deadtime.switching.models import jump_process
from deadtime.switching.models.jump_process import Quantiles
from shares import mostly_long

RATES = np.array([[0.0, 2.0, 1.0], [0.5, 0.0, 1.5], [4.0, 1.0, 0.0]])
JUMPS = np.array([[0.0, 0.8, 0.2], [0.5, 0.0, 0.5], [1.0, 0.0, 0.0]])
SOJOURNS = [stats.gamma(3.0, scale=0.2), stats.expon(loc=0.1, scale=0.4), 0.3]
MIXED = SemiMarkov(SOJOURNS, JUMPS)
MODELS = pytest.mark.parametrize(
    "model", [Markov(RATES), MIXED, SemiMarkov(stats.weibull_min(1.5))], ids=str
)


class Instant:
    """A sojourn is 1 s or too short for a double to tell its ends apart, by halves."""

    def cdf(self, t):
        return np.where(np.asarray(t) < 1e-300, 0.0, np.where(np.asarray(t) < 1.0, 0.5, 1.0))

    def sf(self, t):
        return 1.0 - self.cdf(t)

    def mean(self):
        return 0.5

    def isf(self, u):
        return np.where(u < 0.5, 1.0, 1e-300)


class Quantile(Instant):
    """No survival function to invert, but a quantile; and it counts its calls."""

    isf = None

    def __init__(self, quantile):
        self.quantile, self.calls = quantile, 0

    def ppf(self, p):
        self.calls += 1
        return self.quantile(p)


def numpy_words(key, block, scenario, stream, size):
    """What numpy.random.Philox gives from a counter on; it adds 1 before the first word."""
    counter = (block + (scenario << 64) + (stream << 128) - 1) % 2**256
    return np.random.Philox(key=key, counter=counter).random_raw(size)


def numpy_uniforms(key, scenario, stream, size):
    return ((numpy_words(key, 0, scenario, stream, size) >> np.uint64(12)) + 0.5) / 2.0**52


def read_by_hand(inverses, transition, horizon, seed, scenario, jumps=200):
    """A scenario's signal, number by number."""
    key = np.random.SeedSequence(seed).generate_state(2, np.uint64)
    mode = int(numpy_uniforms(key, scenario, 1, 1)[0] * len(inverses))
    sojourns, nexts = (numpy_uniforms(key, scenario, stream, jumps) for stream in (2, 3))
    time, times, modes = 0.0, [], []
    for u, v in zip(sojourns, nexts, strict=True):
        then = time + float(inverses[mode](u))
        if then > time:
            times.append(time)
            modes.append(mode)
        time = then
        if time >= horizon:
            return SwitchingSignal(times, modes, horizon)
        mode = bisect_right(np.cumsum(transition[mode]).tolist(), v)
    raise AssertionError("more jumps are needed")


# -- the generator -------------------------------------------------------------------------


def test_words_are_those_of_numpy_and_of_the_published_vectors():
    rng = np.random.default_rng(1)
    for _ in range(50):
        key = rng.integers(0, 2**64, 2, dtype=np.uint64)
        block, scenario = (int(n) for n in rng.integers(0, 2**63, 2))
        stream = int(rng.integers(0, 9))
        assert (
            list(block_words(key, block, scenario, stream))
            == numpy_words(key, block, scenario, stream, 4).tolist()
        )
    # kat_vectors of the authors' library Random123, philox4x64 with 10 rounds.
    published = "16554d9eca36314c db20fe9d672d0fdc d7e772cee186176b 7e68b68aec7ba23b"
    zeros = block_words(np.zeros(2, np.uint64), 0, 0, 0)
    assert [int(word) for word in zeros] == [int(word, 16) for word in published.split()]


def test_uniforms_are_the_words_in_order_and_lie_within_0_and_1():
    key = streams.key_of(7)
    scenarios = np.array([3, 2**40, 0], dtype=np.uint64)
    scenarios.flags.writeable = False
    found = uniforms(key, scenarios, 0, 5, 2)
    assert streams.uniforms(key, scenarios, 0, 5, 2).tolist() == found.tolist()
    for row, scenario in zip(found, scenarios, strict=True):
        assert row.tolist() == numpy_uniforms(key, int(scenario), 2, 20).tolist()
    assert uniforms(key, scenarios, 3, 2, 2).tolist() == found[:, 12:].tolist()
    assert uniform(np.uint64(0)) == 2.0**-53
    assert uniform(np.uint64(2**64 - 1)) == 1.0 - 2.0**-53


# -- a function of the scenario's number -----------------------------------------------------


@MODELS
def test_a_signal_does_not_depend_on_what_is_drawn_with_it(model):
    whole = model.draw(12.0, seed=3, first=5, count=300)
    assert len(whole) == 300
    for first, count in ((5, 1), (6, 13), (19, 286), (304, 1)):
        part = model.draw(12.0, seed=3, first=first, count=count)
        assert equal(part, whole.slice(first - 5, first - 5 + count))
    blocks = [(5 + 50 * k, 50) for k in (4, 1, 5, 0, 3, 2)]
    with ThreadPoolExecutor(2) as pool:
        drawn = list(pool.map(lambda block: model.draw(12.0, 3, *block), blocks))
    for (first, _), part in zip(blocks, drawn, strict=True):
        assert equal(part, whole.slice(first - 5, first + 45))


@MODELS
def test_a_longer_horizon_continues_the_signals(model):
    short, long = (model.draw(h, seed=2, count=40) for h in (4.0, 90.0))
    for one, other in zip(short, long, strict=True):
        before = other.times < 4.0
        assert one.times.tolist() == other.times[before].tolist()
        assert one.modes.tolist() == other.modes[before].tolist()
    assert (short.end == 4.0).all()
    assert (short.initial_age == 0.0).all()


def test_seeds_and_scenarios_differ():
    batch = Markov(RATES).draw(50.0, seed=0, count=200)
    other = Markov(RATES).draw(50.0, seed=1, count=200)
    firsts = np.concatenate([[signal.times[1] for signal in b] for b in (batch, other)])
    assert np.unique(firsts).size == 400
    one, other = (Markov(RATES).draw(50.0, first=2**62 + i) for i in (0, 1))  # not so as doubles
    assert one.times[1] != other.times[1]


@MODELS
def test_a_sample_is_the_first_signal_that_is_drawn(model):
    for seed in range(20):
        sample, batch = model.sample(30.0, seed), model.draw(30.0, seed, count=9)
        assert equal(SignalBatch.of([sample]), batch.slice(0, 1))


@MODELS
def test_few_signals_by_plain_loops_are_those_of_the_compiled_ones(model, monkeypatch):
    few = [model.draw(40.0, seed=6, first=first, count=8) for first in (0, 2**62)]
    monkeypatch.setattr(jump_process, "FEW_BLOCKS", 3)  # compiled from the second round on
    mixed = model.draw(40.0, seed=6, count=8)
    monkeypatch.setattr(jump_process, "FEW_SIGNALS", 0)
    many = [model.draw(40.0, seed=6, first=first, count=8) for first in (0, 2**62)]
    assert all(map(equal, few, many))
    assert equal(mixed, many[0])


def test_one_signal_needs_no_compiler():
    code = (
        "import sys, deadtime as dt; dt.SwitchingSignal.random(3, 90.0, dwell_time=0.1, seed=1); "
        "dt.Markov([[0, 2], [2, 0]]).sample(90.0); print('numba' in sys.modules)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.strip() == "False", result.stderr


def test_a_random_signal_is_a_sample_of_its_semi_markov_model():
    signal = SwitchingSignal.random(3, 60.0, dwell_time=0.3, mean_sojourn=0.5, seed=8)
    model = SemiMarkov(stats.expon(loc=0.3, scale=0.5 - 0.3), modes=3)
    assert equal(SignalBatch.of([signal]), model.draw(60.0, seed=8))


def test_signals_are_those_read_by_hand_from_numpys_generator():
    inverses = [SOJOURNS[0].isf, lambda u: 0.1 - 0.4 * np.log(u), lambda u: 0.3]
    batch = MIXED.draw(12.0, seed=9, first=1000, count=12)
    for i, signal in enumerate(batch):
        expected = read_by_hand(inverses, JUMPS, 12.0, 9, 1000 + i)
        assert signal.modes.tolist() == expected.modes.tolist()
        assert signal.times == pytest.approx(expected.times, rel=1e-14)


def test_instant_sojourns_are_left_out_and_equal_neighbours_are_one():
    batch = SemiMarkov([Instant()] * 3, JUMPS).draw(9.5, seed=4, count=100)
    merged = 0
    for i, signal in enumerate(batch):
        expected = read_by_hand([Instant().isf] * 3, JUMPS, 9.5, 4, i)
        assert signal.times.tolist() == expected.times.tolist()
        assert signal.modes.tolist() == expected.modes.tolist()
        merged += signal.dwell_time > 1.0 or signal.switches < 9
    assert merged > 50


# -- the law of what is drawn ----------------------------------------------------------------


@pytest.mark.parametrize("model", [Markov(RATES), MIXED], ids=str)
def test_sojourns_and_jumps_follow_the_model(model):
    batch = model.draw(60.0, seed=5, count=600)
    assert (np.diff(batch.first) > 21).all()  # so the first 20 of each are a fair choice
    times = np.stack([signal.times[:21] for signal in batch])
    modes = np.stack([signal.modes[:21] for signal in batch])
    lengths, before, after = np.diff(times), modes[:, :-1].ravel(), modes[:, 1:].ravel()
    table = JUMPS if model is MIXED else RATES / RATES.sum(axis=1)[:, None]
    for mode in range(3):
        drawn = lengths[modes[:, :-1] == mode]
        if model is MIXED and mode == 2:
            assert drawn == pytest.approx(np.full(drawn.size, 0.3), abs=1e-13)
        else:
            law = SOJOURNS[mode] if model is MIXED else stats.expon(scale=model.mean[mode])
            assert stats.kstest(drawn, law.cdf).pvalue > 0.01
        found = np.bincount(after[before == mode], minlength=3)
        likely = table[mode] > 0.0
        assert (found[~likely] == 0).all()
        if likely.sum() > 1:
            expected = table[mode][likely] * found.sum()
            assert stats.chisquare(found[likely], expected).pvalue > 0.01
    assert stats.chisquare(np.bincount(modes[:, 0])).pvalue > 0.01


def test_numbers_of_neighbouring_scenarios_blocks_and_streams_are_uncorrelated():
    numbers = np.arange(2000, dtype=np.uint64)
    numbers.flags.writeable = False
    u, v = (uniforms(streams.key_of(0), numbers, 0, 5, s) for s in (2, 3))
    pairs = ((u[1:], u[:-1]), (u[:, 1:], u[:, :-1]), (u[:, 4:], u[:, :-4]), (u, v))
    for one, other in pairs:
        correlation = np.corrcoef(one.ravel(), other.ravel())[0, 1]
        assert abs(correlation) * np.sqrt(one.size) < 3.0
    assert stats.kstest(u.ravel(), stats.uniform.cdf).pvalue > 0.01


def test_occupation_follows_the_exponential_of_the_generator():
    model, time, count = Markov(RATES), 0.4, 20000
    batch = model.draw(0.5, seed=1, count=count)
    active = np.add.reduceat(batch.times <= time, batch.first[:-1])
    modes = batch.modes[batch.first[:-1] + active - 1]
    expected = np.full(3, 1.0 / 3.0) @ expm(model.generator * time)
    assert stats.chisquare(np.bincount(modes), expected * count).pvalue > 0.01


def time_in_mode_0(batch):
    """How long each signal stays in mode 0, seconds."""
    lengths = np.diff(np.append(batch.times, 0.0))
    lengths[batch.first[1:] - 1] = batch.end - batch.times[batch.first[1:] - 1]
    return np.add.reduceat(lengths * (batch.modes == 0), batch.first[:-1])


@pytest.mark.parametrize(
    ("model", "seeds"),
    mostly_long([(Markov(RATES), 2500), (MIXED, 2500), (MIXED, 800)], (MIXED, 800)),
    ids=str,
)
def test_scenarios_of_a_seed_and_seeds_of_a_scenario_have_one_law(model, seeds):
    drawn = model.draw(8.0, seed=1, count=20000)
    sampled = SignalBatch.of([model.sample(8.0, seed=seed) for seed in range(seeds)])
    for of in (time_in_mode_0, lambda batch: np.diff(batch.first)):
        assert stats.ks_2samp(of(drawn), of(sampled)).pvalue > 0.01


def test_a_mode_that_no_rate_leaves_is_kept_for_ever():
    batch = Markov([[0.0, 1.0, 1.0], [0.0, 0.0, 0.0], [1.0, 1.0, 0.0]]).draw(500.0, count=300)
    assert (batch.modes[batch.first[1:] - 1] == 1).all()
    assert (batch.modes == 1).sum() == 300
    alone = Markov([[0.0]]).draw(5.0, count=3)
    assert alone.times.tolist() == [0.0] * 3
    assert alone.modes.tolist() == [0] * 3


# -- distributions ---------------------------------------------------------------------------


def test_one_distribution_of_all_modes_is_asked_once_and_through_ppf_if_need_be():
    shared = Quantile(lambda p: 0.2 + p)
    batch = SemiMarkov(shared, modes=3).draw(0.9, seed=2, count=50)
    assert shared.calls == 1
    key = streams.key_of(2)
    for i, signal in enumerate(batch):
        lengths = 1.2 - numpy_uniforms(key, i, 2, 6)
        assert signal.times[1:] == pytest.approx(np.cumsum(lengths)[: signal.switches], rel=1e-15)


@pytest.mark.parametrize(
    "sojourn",
    [stats.expon(0.3, 0.5), stats.expon(scale=0.5, loc=0.3), stats.expon(0.3, scale=0.5)],
)
def test_shifted_exponentials_are_read_however_they_are_written(sojourn):
    found = SemiMarkov(sojourn).draw(20.0, count=20)
    expected = SemiMarkov(Quantile(lambda p: sojourn.isf(1.0 - p))).draw(20.0, count=20)
    assert found.modes.tolist() == expected.modes.tolist()
    assert found.times == pytest.approx(expected.times, rel=1e-13)


class Bare:
    """A distribution of scipy's without its quantiles."""

    def __init__(self, of):
        self.cdf, self.logsf, self.mean = of.cdf, of.logsf, of.mean


@pytest.mark.parametrize(
    "sojourn", [stats.gamma(2.0), stats.lognorm(0.5, scale=1e3), stats.geom(0.4)]
)
def test_a_distribution_without_quantiles_is_drawn_by_a_search(sojourn):
    expected = SemiMarkov(sojourn).draw(40.0 * sojourn.mean(), seed=3, count=20)
    found = SemiMarkov(Bare(sojourn)).draw(40.0 * sojourn.mean(), seed=3, count=20)
    assert found.modes.tolist() == expected.modes.tolist()
    assert found.times == pytest.approx(expected.times, rel=1e-12)


def test_a_search_finds_the_sojourn_to_its_last_bit():
    sojourn, u = stats.foldnorm(1.0), np.array([1e-12, 0.3, 1.0 - 1e-9])
    found = Quantiles.of([sojourn])(np.zeros((1, 3), np.int64), u[None])[0]
    assert (sojourn.logsf(found) <= np.log(u)).all()
    assert (sojourn.logsf(np.nextafter(found, 0.0)) > np.log(u)).all()


@pytest.mark.parametrize(
    ("quantile", "message"),
    [
        (lambda p: p - 2.0, "sojourn[1].ppf must return numbers ≥ 0, in s, got -"),
        (lambda p: np.full(p.shape, np.nan), "≥ 0, in s, got nan"),
        (lambda p: 1.0, "sojourn[1].ppf must return shape "),
    ],
)
def test_quantiles_that_are_no_times_are_refused(quantile, message):
    model = SemiMarkov([stats.gamma(2.0), Quantile(quantile)])
    with pytest.raises(ArgumentError, match=re.escape(message)):
        model.draw(30.0, count=5)


# -- what is refused -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"horizon": 0.0}, "horizon must be positive"),
        ({"horizon": 1e8}, "horizon = 1e+08 s would hold about 2e+08 switches"),
        ({"horizon": 1e6, "count": 1000}, "count = 1000 signals of 1e+06 s would hold more than"),
        ({"horizon": 1.0, "seed": -1}, "seed must be an integer of at least 0"),
        ({"horizon": 1.0, "first": -1}, "first must be an integer of at least 0"),
        ({"horizon": 1.0, "count": 0}, "count must be an integer of at least 1"),
    ],
)
def test_what_cannot_be_drawn_is_refused(asked, message):
    for model in (Markov([[0.0, 2.0], [2.0, 0.0]]), SemiMarkov(0.5)):
        with pytest.raises(ArgumentError, match=re.escape(message)):
            model.draw(**asked)


def test_sojourns_shorter_than_their_mean_says_are_stopped(monkeypatch):
    monkeypatch.setattr(jump_process, "MOST_SWITCHES", 1e3)
    monkeypatch.setattr(jump_process, "MOST_JUMPS", 1e4)
    model = SemiMarkov(Quantile(lambda p: 1e-9 * p))
    with pytest.raises(ArgumentError, match=r"horizon = 5 s would hold about 1e\+10 switches"):
        model.draw(5.0)
    with pytest.raises(ArgumentError, match="count = 900 signals of 5 s would hold more than"):
        model.draw(5.0, count=900)
