"""The switching model of modes that were logged, where rows are lost."""

import numpy as np
import pandas as pd
import pytest

from deadtime.identification.log.logged_states import fit_switching, signals_of
from deadtime.identification.log.read_recording import read_recording


def recording(lost, mode=None):
    rng = np.random.default_rng(0)
    mode = np.repeat(np.arange(20) % 2, 10) if mode is None else mode
    x, u = rng.standard_normal((2, mode.size))
    table = pd.DataFrame({"t": 0.5 * np.arange(mode.size), "x1": x, "u1": u, "mode": mode})
    return read_recording(table.drop(index=lost), "mode")


@pytest.mark.parametrize(
    "lost", [[11], [31, 61], [9, 11], [21, 22, 23]], ids=["one", "two", "about it", "three in turn"]
)
def test_rows_that_are_lost_after_a_switch_leave_a_switching_model(lost):
    record = recording(lost)
    assert record.samples == 200 - len(lost)
    assert [k for k, i in enumerate(record.parts[0].mode) if i < 0] == lost
    model, why = fit_switching(record)
    assert model is not None, why
    assert all(4.0 < one.mean() < 6.5 for one in model.sojourn)


def test_a_log_that_ends_with_a_switch_has_a_model_too():
    model, why = fit_switching(recording([], np.repeat(np.arange(20) % 2, 10)[:191]))
    assert model is not None, why


def test_a_mode_that_begins_in_the_last_row_lasts_its_period():
    (first, *_) = signals_of(recording([11]))
    assert first.times.tolist() == [0.0, 5.0]
    assert first.end == 5.5
