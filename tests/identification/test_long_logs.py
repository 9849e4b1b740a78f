"""A long log with noisy sensors begins from stretches of it, and ends at the same estimate."""

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.identification.log.recording import Part, Recording
from synthetic_logs import Plant

H = 0.05


def test_stretches_lie_all_over_a_long_log_and_a_short_one_is_left_whole():
    def part(count):
        column = np.arange(float(count))
        return Part(column, column[:, None], column[:, None], np.zeros(count, int))

    record = Recording((part(900), part(100)), 1.0, True, ("x",), ("u",), ("0",), False)
    assert record.stretches(500, 0) is record
    some = record.stretches(200, 0)
    assert 200 <= some.samples <= 211
    assert len(some.parts) == 10
    assert [p.time[0] for p in some.parts] == [*range(0, 900, 100), 0.0]
    assert all((np.diff(p.time) == 1.0).all() for p in some.parts)
    longer = record.stretches(200, 7)
    assert [p.time.size for p in longer.parts] == [p.time.size + 7 for p in some.parts]


@pytest.mark.parametrize("delay", [0.162, 0.812])
def test_where_a_long_log_begins_does_not_move_its_estimate(monkeypatch, delay):
    """The second delay is longer than a stretch of ten rows, of which no period would be known.

    What is taken off the noise for the matrices is seen on the stretches alone; of ten rows, badly.
    """
    plant = Plant([[[-0.5]]], [[[1.0]]], delay, 1e-3 * np.eye(1))
    rng, t = np.random.default_rng(0), H * np.arange(400)
    y, u = plant.log(t, rng.standard_normal((400, 1)), rng, sensor=0.03)
    log = pd.DataFrame({"t": t, "x": y[:, 0], "u": u[:, 0]})
    found = []
    for most in (10_000, 100):
        monkeypatch.setattr("deadtime.identification.noisy_estimate._ENOUGH", most)
        found.append(dt.identify(log, modes=None, delay=(delay - 0.15, delay + 0.3), noise=True))
    whole, some = found
    for name in whole.names:
        low, high = whole.interval(name)
        share = 1e-4 if name == "delay" else 1e-2 if name[0] in "AB" else 0.1
        off = share * (high - low)
        assert some.estimate(name) == pytest.approx(whole.estimate(name), abs=off)
    assert some.log_likelihood == pytest.approx(whole.log_likelihood, abs=1e-6)
