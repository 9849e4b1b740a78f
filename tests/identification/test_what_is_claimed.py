"""What an identification claims no more than: joint delays, sensors, few rows, faint inputs."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.identification.problem_text import problem_text
from deadtime.identification.sentences import verdict_of
from deadtime.identification.separate_errors import failure_of
from synthetic_logs import Plant, oscillator

H = 0.05


def table(t, y, u, mode=None):
    columns = {"t": t} | {f"x{i + 1}": x for i, x in enumerate(y.T)}
    columns |= {f"u{j + 1}": one for j, one in enumerate(u.T)}
    return pd.DataFrame(columns if mode is None else {**columns, "mode": mode})


OPPOSED = dt.SwitchedSystem([[[1.0]]], [[[1.0, 1.0]]], [0.2, 0.2])
LAW = dt.AveragedPredictor(OPPOSED, [[[-8.0], [6.0]]])
MARGIN = dt.delay_margin(OPPOSED, LAW, H)


def box(error):
    return np.array([[[0.2 - error, 0.2 + error]] * 2])


def test_delays_that_err_against_each_other_are_no_common_shift():
    """Both 0.09 s longer or shorter are borne; one longer and the other shorter are not."""
    assert MARGIN.longer > 0.09
    for shift in (0.09, -0.09):
        truth = dt.SwitchedSystem(OPPOSED.A, OPPOSED.B, [0.2 + shift, 0.2 + shift])
        assert dt.growth_rate(truth, LAW, 0, H) < 0.0
    run = dt.simulate(
        dt.SwitchedSystem(OPPOSED.A, OPPOSED.B, [0.29, 0.11]),
        LAW,
        dt.SwitchingSignal.constant(0),
        [1.0],
        20.0,
        H,
    )
    assert np.abs(run.states[:, -1]).max() > 1e3
    said = verdict_of(OPPOSED.delays, box(0.09), MARGIN)
    assert "enough if all err alike; nothing is said of errors that differ" in said
    failure = failure_of(OPPOSED, box(0.09), LAW, H)
    assert failure
    assert "not enough" in verdict_of(OPPOSED.delays, box(0.09), MARGIN, failure)


def test_corners_find_what_no_delay_alone_shows():
    alone = dt.delay_margin(OPPOSED, LAW, H, input=0), dt.delay_margin(OPPOSED, LAW, H, input=1)
    borne = min(min(m.shorter, m.longer) for m in alone)
    said = failure_of(OPPOSED, box(0.95 * borne), LAW, H)
    assert "does not decay" in said
    assert failure_of(OPPOSED, box(0.02), LAW, H) == ""
    end = verdict_of(OPPOSED.delays, box(0.02), MARGIN, "")
    assert "every corner of the box of intervals: enough" in end


def saved(C, noise, W):
    """The text of a file, from what its writer reads."""
    fit = SimpleNamespace(
        plant=dt.SwitchedSystem([-np.eye(2)] * 2, [[[1.0], [0.0]]] * 2, 0.2),
        delays=np.full((2, 1), 0.2),
        delay_interval=np.tile([0.19, 0.21], (2, 1, 1)),
        sentences=("Found.",),
        samples=100,
        step=H,
        states=("x1", "x2"),
        inputs=("u",),
        modes=("a", "b"),
        model=dt.SemiMarkov([2.0, 3.0], [[0.0, 1.0], [1.0, 0.0]]),
        largest_states=np.ones(2),
        disturbance=W,
        noise=noise,
        C=C,
    )
    return problem_text(fit)


def test_noise_of_other_outputs_is_not_saved_as_noise_of_states():
    W, noise = np.tile(np.eye(2), (2, 1, 1)), np.array([2.0, 0.02])
    plain = saved(np.eye(2), noise, W)
    assert "std = [2.0, 0.02]" in plain
    assert "noise = [2.0, 0.02]" in plain
    scaled = saved(np.diag([100.0, 1.0]), noise, W)
    assert "0.02]" not in scaled
    assert scaled.count("is left out: it is of y = C x") == 2
    assert "the mean of the modes'" not in scaled
    assert "the mean of the modes'" in saved(np.eye(2), noise, W * [[[1.0]], [[2.0]]])
    assert "left out" not in saved(np.diag([100.0, 1.0]), 0.0 * noise, W)
