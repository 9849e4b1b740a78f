"""How often the intervals of printed tables hold the truth: by counting, and by simulation."""

from fractions import Fraction
from math import comb

import numpy as np
import pytest

from deadtime.scenarios.paired_statistics import Proportion, mean_interval, median_interval

RUNS = 4000
# Two standard errors of a share near 95 % of so many runs, and then some.
ERROR = 3.0 * np.sqrt(0.05 * 0.95 / RUNS)

# Distributions with their medians: light and heavy tails, skew, runs that diverge.
DRAWN = {
    "normal": (lambda rng, size: rng.normal(size=size), 0.0),
    "exponential": (lambda rng, size: rng.exponential(size=size), np.log(2.0)),
    "Cauchy": (lambda rng, size: rng.standard_cauchy(size), 0.0),
    "log-normal, heavy": (lambda rng, size: np.exp(3.0 * rng.normal(size=size)), 1.0),
    "Pareto, 30 % diverged": (
        lambda rng, size: np.where(rng.random(size) < 0.3, np.inf, rng.pareto(1.0, size)),
        # P(X ≤ m) = 0.7 (1 − 1/(1 + m)) = ½
        0.5 / 0.2,
    ),
}


def counted(n):
    """The largest k for which the k-th smallest and k-th largest of n draws hold the median with a
    probability of 95 %, and that probability, 1 − 2 P(B < k), B ~ Bin(n, ½): in fractions."""
    k, below, held = 0, Fraction(0), Fraction(1)
    while True:
        below += Fraction(comb(n, k), 2**n)
        if 1 - 2 * below < Fraction(95, 100):
            return k, held
        k, held = k + 1, 1 - 2 * below


@pytest.mark.parametrize("n", [6, 7, 20, 101, 1000])
def test_the_interval_of_a_median_has_the_innermost_order_statistics_that_hold_it_at_95_percent(n):
    k, held = counted(n)
    _, low, high = median_interval(np.arange(1.0, n + 1.0))
    assert (low, high) == (k, n + 1 - k)
    assert Fraction(95, 100) <= held
    if n == 1000:
        assert held < Fraction(955, 1000)


@pytest.mark.parametrize("name", DRAWN)
@pytest.mark.parametrize("n", [10, 40, 201])
def test_the_interval_of_a_median_holds_it_as_often_as_counted_whatever_the_distribution(name, n):
    draw, median = DRAWN[name]
    _, low, high = median_interval(draw(np.random.default_rng(n), (RUNS, n)))
    share = ((low <= median) & (median <= high)).mean()
    _, held = counted(n)
    assert abs(share - float(held)) < ERROR


def test_ties_and_few_draws_only_widen_the_interval_of_a_median():
    rng = np.random.default_rng(0)
    _, low, high = median_interval(rng.integers(0, 3, (RUNS, 25)).astype(float))
    assert ((low <= 1.0) & (high >= 1.0)).mean() >= 0.95
    assert median_interval(np.arange(5.0))[1:] == (-np.inf, np.inf)


@pytest.mark.parametrize("n", [5, 20, 200])
@pytest.mark.parametrize("spread", [0.1, 2.0])
def test_the_interval_of_a_geometric_mean_holds_it_at_95_percent_for_log_normal_ratios(n, spread):
    rng = np.random.default_rng(n)
    _, low, high = mean_interval(np.exp(spread * rng.normal(size=(RUNS, n))))
    assert abs(((low <= 1.0) & (high >= 1.0)).mean() - 0.95) < ERROR


@pytest.mark.parametrize("skew", ["exponential", "uniform", "two values"])
def test_with_some_dozens_of_signals_it_holds_for_other_ratios_within_two_percent(skew):
    rng = np.random.default_rng(1)
    logs = {
        "exponential": rng.exponential(size=(RUNS, 60)) - 1.0,
        "uniform": rng.random((RUNS, 60)) - 0.5,
        "two values": rng.choice([-1.0, 1.0], (RUNS, 60)),
    }[skew]
    _, low, high = mean_interval(np.exp(logs))
    assert abs(((low <= 1.0) & (high >= 1.0)).mean() - 0.95) < 0.02


@pytest.mark.parametrize("truth", [0.1, 0.5, 0.97])
def test_the_interval_of_a_share_holds_it_at_about_95_percent(truth):
    counts = np.random.default_rng(2).binomial(100, truth, RUNS)
    intervals = {int(count): Proportion(int(count), 100).interval for count in np.unique(counts)}
    held = [intervals[count][0] <= truth <= intervals[count][1] for count in counts.tolist()]
    assert 0.93 < np.mean(held) < 0.985
