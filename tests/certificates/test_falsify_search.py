"""The search finds the same in other units and by its parts, and refuses what it cannot search."""

import itertools

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.certificates.worst_case.candidates import _without_grid
from deadtime.certificates.worst_case.cycle_growth import SampledLoop
from deadtime.certificates.worst_case.cycles import Admissible, Cycle, Dwell, mode_cycles
from deadtime.certificates.worst_case.products import Kinds, compress
from deadtime.certificates.worst_case.run_search import _drawn
from deadtime.certificates.worst_case.word_search import Word, _apart
from deadtime.switching import SignalClass
from worst_case_laws import QUICK, TURNING, H, free

# -- relations ---------------------------------------------------------------------------------


def test_the_same_search_finds_the_same_signal():
    plant = plants.generic()
    law = plants.LAWS["expected"](plant)
    runs = [dt.falsify(plant, law, 0.4, H, budget=QUICK) for _ in range(2)]
    assert runs[0].growth_rate == runs[1].growth_rate
    assert runs[0].sojourns == runs[1].sojourns


@pytest.mark.long
def test_another_unit_of_time_changes_the_rate_alone():
    plant = plants.generic()
    c = 4.0
    slow, law = plants.in_other_units("delayed", np.eye(3), c)
    worst = dt.falsify(plant, plants.LAWS["delayed"](plant), 0.2, H, budget=QUICK)
    other = dt.falsify(slow, law, c * 0.2, c * H, budget=QUICK)
    assert c * other.growth_rate == pytest.approx(worst.growth_rate, rel=1e-9)
    assert np.array(other.sojourns) == pytest.approx(c * np.array(worst.sojourns))


def test_identical_modes_leave_nothing_to_switch():
    plant = plants.identical()
    worst = dt.falsify(plant, plants.LAWS["averaged"](plant), 0.3, H, budget=QUICK)
    assert len(worst.modes) == 1


@pytest.mark.long
def test_a_longer_dwell_time_never_makes_it_worse():
    rates = [
        dt.falsify(*free(TURNING), tau, H, budget=QUICK).growth_rate for tau in (0.2, 0.7, 1.4)
    ]
    assert np.all(np.diff(rates) < 1e-9)
    assert rates[0] > 0.8
    assert rates[-1] < rates[1]


def test_a_loop_that_explodes_has_a_finite_rate():
    plant = plants.scalar([60.0, 50.0], delay=1.0)
    law = dt.DelayedStateFeedback(plant, [[[-61.0]], [[-51.0]]])
    worst = dt.falsify(plant, law, 0.2, 0.05, budget=QUICK)
    assert worst.growth_rate == pytest.approx(60.0, abs=1e-6)
    assert worst.simulate().diverged


def _kind(kinds, mode, late):
    return np.flatnonzero((kinds.mode == mode) & (kinds.late == late))[0]


# -- the parts ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["averaged", "expected", "mean, dwell-aware"])
def test_a_functional_carried_back_reads_the_state_that_is_carried_on(name):
    plant = plants.generic()
    loop = SampledLoop.of(plant, plants.LAWS[name](plant).digital(H), 0.7)
    rng = np.random.default_rng(0)
    z, y = rng.normal(size=(2, loop.order))
    table = loop.table(Cycle((0, 1, 2), (2.3, 4.0, 2.7), 0.4))
    assert y @ loop.after(table, 1, z) == pytest.approx(loop.before(table, y) @ z, rel=1e-12)


def test_the_compressed_loop_ranks_cycles_as_the_loop_does_whatever_is_late():
    plant = plants.paper()
    law = dt.ExpectedPredictor(plant, plants.gains(plant), plants.markov(2))
    loop = SampledLoop.of(plant, law.digital(0.02), 0.0)
    lengths = np.arange(10, 120)
    signals = Admissible((Dwell(9.9, np.inf),) * 2, ((1,), (0,)), (0, 1))
    kinds = Kinds.of(loop.feedback, signals)
    sojourns = compress(loop, lengths, kinds, signals)
    assert sojourns.matrix.shape[2] < loop.order / 3
    rng = np.random.default_rng(1)
    for count in (2, 4, 6):
        for late in itertools.product((False, True), repeat=count):
            modes, index = np.arange(count) % 2, rng.integers(lengths.size, size=count)
            word = np.array([_kind(kinds, i, after) for i, after in zip(modes, late, strict=True)])
            sojourns_in_turn = zip(modes.tolist(), lengths[index].tolist(), late, strict=True)
            cycle = Cycle.on_grid(list(sojourns_in_turn), 1e-7)
            rate = sojourns.rates(word, index[None])[0] / 0.02
            off = 3e-3 if len(set(late)) == 1 else 2e-2
            assert rate == pytest.approx(loop.growth(cycle).rate, abs=off)


# -- what is refused ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"plant": plants.paper()}, "law must be made for a plant with 2 modes"),
        (
            {"law": plants.LAWS["exact"](plants.generic())},
            "law must not .* future, got ExactPredictor",
        ),
        ({"mode_lag": -1}, "mode_lag must be an integer of at least 0, got -1"),
        ({"mode_lag": 10**6}, "mode_lag must be at most 100,000 periods, got 1,000,000"),
        ({"dwell_time": 0.0}, "dwell_time must be positive"),
        ({"dwell_time": 0.05}, "dwell_time must be at least one period, got 0.05 s .* shorten"),
        ({"step": -0.1}, "step must be positive"),
        ({"maximum_dwell": 0.1}, "maximum_dwell must be at least dwell_time = 0.2 s"),
        (
            {"dwell_time": 0.1 * 5**0.5, "maximum_dwell": 0.1 * 5**0.5},
            "maximum_dwell leaves no cycle of a whole number of periods",
        ),
        ({"clock_tolerance": -1e-9}, "clock_tolerance must be a part from 0 to 0.1, got -1e-09"),
        (
            {"clock_tolerance": 0.2},
            "clock_tolerance must be a part from 0 to 0.1, .* relative difference of the clock",
        ),
        ({"clock_tolerance": "much"}, "clock_tolerance must be a"),
        ({"budget": 0}, "budget must be an integer of at least 1"),
    ],
)
def test_what_cannot_be_searched_is_refused_by_name(changes, message):
    plant = plants.generic()
    arguments = {"plant": plant, "law": plants.LAWS["mean"](plant), "dwell_time": 0.2, "step": H}
    with pytest.raises(dt.ArgumentError, match=message):
        dt.falsify(**(arguments | changes))


@pytest.mark.parametrize("seed", range(4))
def test_words_are_as_far_apart_as_the_nearest_of_their_turns(seed):
    rng = np.random.default_rng(seed)
    size = int(rng.integers(1, 7))
    one, other = (
        Word(rng.integers(0, 2, size) * rng.integers(0, 2), rng.integers(0, 30, size), 0.0)
        for _ in range(2)
    )
    found = [
        int(np.abs(np.roll(one.index, i) - other.index).max())
        for i in range(size)
        if np.array_equal(np.roll(one.kinds, i), other.kinds)
    ]
    assert _apart(one, other) == (min(found) if found else None)
    longer = Word(np.append(other.kinds, 0), np.append(other.index, 3), 0.0)
    assert _apart(one, longer) is None


# -- which mode may follow which ---------------------------------------------------------------


def ring(modes: int, dwell: float, longest: float | None) -> Admissible:
    return Admissible.of(SignalClass(dwell, longest, np.roll(np.eye(modes), 1, 1)), modes, H)


@pytest.mark.parametrize("modes", [2, 3, 4])
def test_cycles_are_all_sequences_that_come_back_one_of_each_rotation(modes):
    allowed = np.random.default_rng(modes).random((modes, modes)) < 0.7
    following = [
        tuple(j for j in np.flatnonzero(row).tolist() if j != i) for i, row in enumerate(allowed)
    ]
    for count in range(2, 7):
        expected = [
            word
            for word in itertools.product(range(modes), repeat=count)
            if word == min(word[i:] + word[:i] for i in range(count))
            and all(word[k] in following[word[k - 1]] for k in range(count))
        ]
        assert list(mode_cycles(following, count)) == expected


def test_a_ring_of_many_modes_is_gone_round():
    (whole,) = _without_grid(ring(7, 2.5 * H, 2.5 * H))  # twice, so that 35 periods are whole
    assert (whole.modes, whole.periods) == ((0, 1, 2, 3, 4, 5, 6) * 2, 35)
    assert {cycle.modes for cycle in _drawn(ring(5, 3 * H, None), 10.0, 5)} == {(0, 1, 2, 3, 4)}
