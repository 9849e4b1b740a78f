"""A batch gives back the signals it was made of, and refuses what it does not hold."""

import re

import numpy as np
import pytest

from batches import equal
from deadtime import ArgumentError
from deadtime.switching import SignalBatch, SwitchingSignal

SIGNALS = [
    SwitchingSignal([0.0, 0.5, 2.0], [1, 0, 2], 3.0, initial_age=0.25),
    SwitchingSignal.constant(4),
    SwitchingSignal([0.0, 0.1], [0, 3], 0.2),
]


def test_a_batch_gives_back_the_signals_it_was_made_of():
    batch = SignalBatch.of(SIGNALS)
    assert len(batch) == 3
    for signal, given in zip(batch, SIGNALS, strict=True):
        assert signal.times.tolist() == given.times.tolist()
        assert signal.modes.tolist() == given.modes.tolist()
        assert (signal.end, signal.initial_age) == (given.end, given.initial_age)
    assert equal(batch.slice(1, 3), SignalBatch.of(SIGNALS[1:]))
    assert equal(batch.slice(0, 3), batch)
    for some in ([2, 0], [1], [1, 1, 2, 0]):
        assert equal(batch.take(np.array(some)), SignalBatch.of([SIGNALS[i] for i in some]))
    assert batch.require_modes(5) is batch


def test_the_arrays_of_a_batch_are_contiguous_its_own_and_read_only():
    first, times, modes = np.array([0, 2]), np.array([0.0, 1.0]), np.array([0, 1])
    batch = SignalBatch(first, times, modes, np.array([2.0]), np.array([0.0]))
    times[1] = -1.0
    assert batch.times.tolist() == [0.0, 1.0]
    for array in vars(batch).values():
        assert array.flags.c_contiguous
        assert not array.flags.writeable


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"first": np.array([0, 2])}, "first must have shape (signals + 1,) = (3,), got (2,)"),
        ({"first": np.array([0, 4, 4])}, "first must start at 0 and increase"),
        ({"first": np.array([0.0, 2.0, 4.0])}, "first must hold integers, got an array of float64"),
        ({"modes": np.array([0, 1])}, "modes must have shape (first[-1],) = (4,), got (2,)"),
        (
            {"times": np.array([0.0, 1.0, 0.5, 1.0])},
            "times must start at 0, but not so in signal 1",
        ),
        ({"times": np.array([0.0, 1.0, 0.0, 0.0])}, "strictly increase, but not so in signal 1"),
        ({"times": np.array([0.0, np.nan, 0.0, 1.0])}, "strictly increase, but not so in signal 0"),
        ({"modes": np.array([2, 2, 0, 1])}, "modes must differ, but not so in signal 0"),
        (
            {"modes": np.array([0, 1, 0, -1])},
            "modes must be counted from 0, but not so in signal 1",
        ),
        ({"end": np.array([2.0, 1.0])}, "later than the last switch, but not so in signal 1"),
        ({"end": np.array([])}, "end must hold one time per signal, got shape (0,)"),
        ({"initial_age": np.array([0.0, -1.0])}, "initial_age must be ≥ 0 and finite, in s, but"),
    ],
)
def test_arrays_that_are_no_signals_are_refused(changed, message):
    arrays = {
        "first": np.array([0, 2, 4]),
        "times": np.array([0.0, 1.0, 0.0, 1.0]),
        "modes": np.array([0, 1, 1, 0]),
        "end": np.array([2.0, np.inf]),
        "initial_age": np.zeros(2),
    }
    assert len(SignalBatch(**arrays)) == 2
    with pytest.raises(ArgumentError, match=re.escape(message)):
        SignalBatch(**(arrays | changed))


def test_what_a_batch_does_not_hold_is_refused():
    batch = SignalBatch.of(SIGNALS)
    with pytest.raises(ArgumentError, match="signal 1 enters mode 4 at 0 s, but the plant's modes"):
        batch.require_modes(4)
    with pytest.raises(ArgumentError, match=r"signal must be in 0\.\.2, got 3"):
        batch[3]
    with pytest.raises(ArgumentError, match="0 ≤ start < stop ≤ 3, got 2, 2"):
        batch.slice(2, 2)
    with pytest.raises(ArgumentError, match="signals must hold at least one signal, got none"):
        SignalBatch.of([])
