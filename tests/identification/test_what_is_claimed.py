"""What an identification claims no more than: joint delays, sensors, few rows, faint inputs."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t as t_of

import deadtime as dt
from deadtime.identification.estimate import variance_ends
from deadtime.identification.intervals import fresh_rise
from deadtime.identification.problem_text import problem_text
from deadtime.identification.sentences import delays_beside, failure_of
from synthetic_logs import Plant, oscillator

H = 0.05


def table(t, y, u, mode=None):
    columns = {"t": t} | {f"x{i + 1}": x for i, x in enumerate(y.T)}
    columns |= {f"u{j + 1}": one for j, one in enumerate(u.T)}
    return pd.DataFrame(columns if mode is None else {**columns, "mode": mode})


OPPOSED = dt.SwitchedSystem([[[1.0]]], [[[1.0, 1.0]]], [0.2, 0.2])
LAW = dt.AveragedPredictor(OPPOSED, [[[-8.0], [6.0]]])
MARGIN: Any = dt.delay_margin(OPPOSED, LAW, H)


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
    said = delays_beside(OPPOSED.delays, box(0.09), MARGIN)
    assert "enough if all err alike; nothing is said of errors that differ" in said
    failure = failure_of(OPPOSED, box(0.09), LAW, H)
    assert failure
    assert "not enough" in delays_beside(OPPOSED.delays, box(0.09), MARGIN, failure)


def test_corners_find_what_no_delay_alone_shows():
    alone: Any = [dt.delay_margin(OPPOSED, LAW, H, input=j) for j in (0, 1)]
    borne = min(min(m.shorter, m.longer) for m in alone)
    said = failure_of(OPPOSED, box(0.95 * borne), LAW, H)
    assert "does not decay" in said
    assert failure_of(OPPOSED, box(0.02), LAW, H) == ""
    end = delays_beside(OPPOSED.delays, box(0.02), MARGIN, "")
    assert "every corner of the box of intervals: enough" in end


def saved(C, noise, W):
    """The text of a file, from what its writer reads."""
    fit: Any = SimpleNamespace(
        plant=dt.SwitchedSystem([-np.eye(2)] * 2, [[[1.0], [0.0]]] * 2, 0.2),
        delays=np.full((2, 1), 0.2),
        delay_interval=np.tile([0.19, 0.21], (2, 1, 1)),
        delays_not_found=(),
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
        uncertain=SimpleNamespace(covariance=np.eye(2)),
        operating_point=None,
        processes=(),
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
    assert scaled.count("[[1.0, 0.0], [0.0, 1.0]]\n") == 2  # the one W of both modes
    assert "left out" not in saved(np.diag([100.0, 1.0]), 0.0 * noise, W)


def test_a_mode_of_few_rows_has_intervals_of_as_few():
    """11 rows are 10 periods, and 2 states, an input and a delay cost 4 of them."""
    rng, mode = np.random.default_rng(3), np.zeros(300, int)
    mode[150:161] = 1
    t = H * np.arange(300)
    y, u = oscillator().log(t, rng.standard_normal((300, 1)), rng, mode)
    fit = dt.identify(table(t, y, u, mode), delay=(0.0, 0.4), per_mode=True, noise=False)
    names = list(fit.names)
    variance = np.diagonal(np.linalg.inv(fit._estimate.best.information))
    for name, periods in (("A[1][1,0]", 10), ("B[1][0,0]", 10)):
        low, high = fit.interval(name)
        spare = periods - 4
        wide = t_of.ppf(0.975, spare) * np.sqrt(periods / spare)
        plain = np.sqrt(variance[names.index(name)])
        assert 0.5 * (high - low) == pytest.approx(wide * plain, rel=1e-4)
    low, high = fit.interval("A[0][1,0]")
    plain = np.sqrt(variance[names.index("A[0][1,0]")])
    assert 0.5 * (high - low) == pytest.approx(1.97 * plain, rel=0.02)


FAINT = Plant([[[-1.0]]], [[[1.0]]], 0.512, np.eye(1))


def faint(seed, count=120):
    """A log whose noise hides what the input does."""
    rng, t = np.random.default_rng(seed), H * np.arange(count)
    u = np.repeat(rng.choice([-1.0, 1.0], (count // 4, 1)), 4, axis=0)
    y, u = FAINT.log(t, u, rng)
    return dt.identify(table(t, y, u), modes=None, delay=(0.0, 1.0), noise=False)


def test_a_log_that_hardly_tells_a_delay_says_so_and_its_interval_is_wide():
    fit = faint(0)
    low, high = fit.interval("delay")
    assert low < 0.512 < high
    assert high - low > 0.3  # three periods on either side at least, where the log starts to tell
    assert "hardly tells the delay" in fit.message
    assert "widen" not in fit.message


def test_an_interval_that_ends_where_the_search_did_says_that_nothing_longer_was_tried():
    rng, t = np.random.default_rng(0), H * np.arange(120)
    y, u = FAINT.log(t, rng.choice([-1.0, 1.0], (120, 1)), rng)
    fit = dt.identify(table(t, y, u), modes=None, delay=(0.0, 0.3), noise=False)
    assert fit.interval("delay")[1] == pytest.approx(0.3)
    assert "longer than 0.3 s, widen delay=(low, high), --delay LOW HIGH." in fit.message


def test_a_noise_that_the_log_does_not_tell_may_be_none_or_any():
    assert variance_ends(1e-12, 1e-3) == (0.0, pytest.approx(1.96e-3, rel=1e-4))
    assert variance_ends(1e-12, np.inf) == (0.0, np.inf)
    low, high = variance_ends(1.0, 0.1)
    assert low * high == pytest.approx(1.0)


def test_modes_that_have_numbers_only_are_called_what_they_are_without_names(tmp_path):
    from deadtime.problems import load_problem

    fit = faint(0)
    fit.save(tmp_path / "mine.toml")
    assert load_problem(tmp_path / "mine.toml").modes == ("mode 0",)


@pytest.mark.long
def test_intervals_of_a_delay_that_noise_hides_hold_it():
    found = [faint(seed) for seed in range(24)]
    inside = [low < 0.512 < high for low, high in (fit.interval("delay") for fit in found)]
    assert sum(inside) >= 21


def test_only_what_rises_again_beyond_an_interval_is_another_peak():
    assert fresh_rise(np.array([9.0, 8.0, 6.0, 5.0]), 4.0) is None
    assert fresh_rise(np.array([9.0, 3.0, 6.0, 2.0]), 4.0) == 2
    assert fresh_rise(np.array([9.0, 3.0, 3.5, 2.0]), 4.0) is None
