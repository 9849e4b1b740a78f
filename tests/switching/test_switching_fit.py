"""Fitting a semi-Markov model to logs: censoring, recovery, goodness, refusals."""

import re

import numpy as np
import pytest
from scipy import stats

from deadtime import ArgumentError, SemiMarkov, SwitchingSignal
from deadtime.switching.models.fit import distance, kaplan_meier, sojourns_of
from deadtime.switching.models.sojourn_families import Observed, estimate
from shares import mostly_long

TRUTH = {
    "exponential": stats.expon(scale=0.7),
    "shifted exponential": stats.expon(loc=0.3, scale=0.5),
    "gamma": stats.gamma(a=3.0, scale=0.25),
    "weibull": stats.weibull_min(c=2.2, scale=0.8),
    "uniform": stats.uniform(loc=0.2, scale=0.8),
    "lognormal": stats.lognorm(s=0.5, scale=0.6),
}
SMOOTH = ["exponential", "gamma", "weibull", "lognormal"]
JUMPS = np.array([[0.0, 0.7, 0.3], [0.5, 0.0, 0.5], [1.0, 0.0, 0.0]])


def one_log(truth):
    """One log with 200 complete sojourns in each mode."""
    long = SemiMarkov(truth).sample(900.0 * truth.mean(), seed=0)
    return SwitchingSignal(long.times[:401], long.modes[:401])


def short_logs(truth, count=260):
    """Logs of 1.2 s, about two sojourns each: 4 in 10 are cut off."""
    return [SemiMarkov(truth).sample(1.2, seed=i) for i in range(count)]


def log_of(lengths, last=np.inf):
    """Alternating modes with these sojourns, and `last` seconds of one more."""
    times = np.concatenate(([0.0], np.cumsum(lengths)))
    return SwitchingSignal(times, np.arange(times.size) % 2, times[-1] + last)


def paired(complete, censored=()):
    """Logs in which both modes have the same sojourns."""
    whole = [log_of(np.repeat(complete, 2))]
    cut = [SwitchingSignal([0.0], [mode], c) for c in censored for mode in (0, 1)]
    return whole + cut


def log_likelihood(dist, observed):
    return dist.logpdf(observed.complete).sum() + dist.logsf(observed.censored).sum()


def slope_and_errors(family, parameters, observed):
    """Gradient of the log likelihood, and standard errors from its Hessian, by differences."""
    names, at = list(parameters), np.array(list(parameters.values()))
    move = 1e-3 * np.diag(at)

    def value(x):
        return log_likelihood(family(**dict(zip(names, x, strict=True))), observed)

    slope = np.array([value(at + d) - value(at - d) for d in move]) / (2e-3 * at)
    second = [
        [
            value(at + d + e) - value(at + d - e) - value(at - d + e) + value(at - d - e)
            for e in move
        ]
        for d in move
    ]
    information = -np.array(second) / (4e-6 * np.outer(at, at))
    return slope, np.sqrt(np.diag(np.linalg.inv(information)))


# -- what logs hold ------------------------------------------------------------------------


def test_the_last_sojourn_is_censored_and_says_nothing_without_an_end():
    times, modes = [0.0, 0.5, 0.75, 1.75], [0, 1, 0, 1]
    zero, one = sojourns_of(SwitchingSignal(times, modes, end=2.0))
    assert (zero.complete.tolist(), zero.censored.tolist()) == ([0.5, 1.0], [])
    assert (one.complete.tolist(), one.censored.tolist()) == ([0.25], [0.25])
    zero, one = sojourns_of(SwitchingSignal(times, modes))
    assert (one.complete.tolist(), one.censored.tolist()) == ([0.25], [])


def test_the_first_sojourn_is_dropped_on_request_or_when_the_signal_has_an_age():
    signal = SwitchingSignal([0.0, 0.5, 0.75], [0, 1, 0], end=2.0)
    aged = SwitchingSignal([0.0, 0.5, 0.75], [0, 1, 0], end=2.0, initial_age=0.1)
    for seen in (sojourns_of(signal, first="drop"), sojourns_of(aged)):
        assert [(s.complete.tolist(), s.censored.tolist()) for s in seen] == [
            ([], [1.25]),
            ([0.25], []),
        ]


def test_a_sojourn_that_is_first_and_last_is_censored_or_dropped():
    constant = SwitchingSignal([0.0], [1], end=3.0)
    assert sojourns_of(constant)[1].censored.tolist() == [3.0]
    assert sojourns_of(constant, first="drop")[1].censored.size == 0
    assert sojourns_of(SwitchingSignal.constant(1))[1].censored.size == 0


def test_kaplan_and_meier_and_the_distance_to_it_by_hand():
    observed = Observed(np.array([1.0, 3.0, 5.0]), np.array([2.0, 4.0]))
    times, survival = kaplan_meier(observed)
    assert times.tolist() == [1, 2, 3, 4, 5]
    assert survival == pytest.approx([4 / 5, 4 / 5, 8 / 15, 8 / 15, 0], rel=1e-12)
    assert distance(stats.uniform(0.0, 5.0), observed) == pytest.approx(1 - 7 / 15, rel=1e-8)


# -- estimates -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("family", "complete", "censored", "expected"),
    [
        ("exponential", [1, 2, 3, 4, 5], [10.0], {"scale": 5.0}),
        ("shifted exponential", [1, 2, 3, 4, 5], [], {"loc": 0.5, "scale": 2.5}),
        ("shifted exponential", [1, 2, 3, 4, 5], [10.0, 0.5], {"loc": 1 - 4.75 / 6, "scale": 4.75}),
        ("uniform", [2, 3, 4, 5, 6], [], {"loc": 1.0, "scale": 6.0}),
        ("uniform", [2, 3, 4, 5, 6], [1.0], {"loc": 1.0, "scale": 6.0}),
        ("uniform", [2, 3, 4, 5, 6], [11.0], {"loc": 0.2, "scale": 12.6}),
        ("uniform", [2, 3, 4, 5, 6], [5.9], {"loc": 1.22, "scale": 5.46}),
        ("fixed", [2, 2, 2, 2, 2], [1.0], {"length": 2.0}),
    ],
)
def test_closed_forms_by_hand(family, complete, censored, expected):
    model = SemiMarkov.fit(paired(complete, censored), family=family)
    assert model.goodness[0].parameters == pytest.approx(expected, rel=1e-6)
    assert model.goodness[1].censored == len(censored)


@pytest.mark.few(2)
@pytest.mark.parametrize("logs", [one_log, short_logs], ids=["complete", "censored"])
@pytest.mark.parametrize("family", SMOOTH)
def test_smooth_families_are_recovered_at_the_top_of_their_likelihood(family, logs):
    signals = logs(TRUTH[family])
    model = SemiMarkov.fit(signals, family=family)
    for mode, seen in enumerate(sojourns_of(signals)):
        dist, found = TRUTH[family].dist, model.goodness[mode].parameters
        slope, errors = slope_and_errors(dist, found, seen)
        true = np.array([TRUTH[family].kwds[name] for name in found])
        assert np.abs(slope * errors).max() < 0.02
        assert (np.abs(np.array(list(found.values())) - true) < 3.0 * errors).all()


@pytest.mark.parametrize("logs", [one_log, short_logs], ids=["complete", "censored"])
def test_starts_and_ends_of_supports_are_recovered(logs):
    """They err by about one in n of the width, far less than the scale does."""
    model = SemiMarkov.fit(logs(TRUTH["shifted exponential"]), family="shifted exponential")
    for fit in model.goodness:
        assert abs(fit.parameters["loc"] - 0.3) < 4.0 * 0.5 / fit.complete
        assert abs(fit.parameters["scale"] - 0.5) < 3.0 * 0.5 / np.sqrt(fit.complete)
    model = SemiMarkov.fit(logs(TRUTH["uniform"]), family="uniform")
    for fit in model.goodness:
        low, width = fit.parameters["loc"], fit.parameters["scale"]
        assert abs(low - 0.2) < 4.0 * 0.8 / fit.complete
        assert abs(low + width - 1.0) < 5.0 * 0.8 / fit.complete


@pytest.mark.few(1)
@pytest.mark.parametrize("family", [*SMOOTH, "shifted exponential"])
def test_ignoring_what_was_cut_off_makes_sojourns_too_short(family):
    logs, truth = short_logs(TRUTH[family]), TRUTH[family]
    complete_only = [SwitchingSignal(log.times, log.modes) for log in logs]
    honest = SemiMarkov.fit(logs, family=family)
    naive = SemiMarkov.fit(complete_only, family=family)
    error = truth.std() / np.sqrt(honest.goodness[0].complete)
    assert sum(fit.censored for fit in honest.goodness) > 0.3 * len(logs)
    assert np.abs(honest.mean - truth.mean()).max() < 3.5 * error
    assert (naive.mean - truth.mean()).max() < -4.0 * error


def drawn(truth, cut, rng, count):
    """Sojourns in ascending order, each cut off where a draw of `cut` is shorter."""
    lengths, limits = (dist.rvs(count, random_state=rng) for dist in (truth, cut))
    ended = lengths <= limits
    return Observed(np.sort(lengths[ended]), np.sort(limits[~ended]))


# Of a thousand logs each, of which one case of a family runs always.
STARTS = [
    ("shifted exponential", 0.3, stats.uniform(10.0, 1.0)),
    ("shifted exponential", 0.3, stats.uniform(0.2, 0.6)),  # 18 of 60 are complete
    ("shifted exponential", 0.3, stats.uniform(0.2, 0.3)),  # 8
    ("uniform", 0.2, stats.uniform(10.0, 1.0)),
    ("uniform", 0.2, stats.uniform(0.3, 0.6)),  # 30
    ("uniform", 0.2, stats.uniform(0.2, 0.25)),  # 10
]


@pytest.mark.long
@pytest.mark.parametrize(("family", "start", "cut"), mostly_long(STARTS, STARTS[1], STARTS[5]))
def test_the_start_of_a_support_is_less_biased_than_the_least_sojourn_by_nine_tenths(
    family, start, cut
):
    rng = np.random.default_rng(0)
    logs = (drawn(TRUTH[family], cut, rng, 60) for _ in range(1000))
    enough = [log for log in logs if log.complete.size >= 5]
    found = np.array([estimate(family, log)[1]["loc"] for log in enough]) - start
    least = np.array([log.complete[0] for log in enough]) - start
    error = found.std() / np.sqrt(found.size)
    assert abs(found.mean()) < 0.1 * least.mean() + 2.0 * error
    assert least.mean() > 20.0 * error


@pytest.mark.parametrize("family", ["shifted exponential", "uniform"])
def test_however_many_are_cut_off_no_sojourn_has_density_zero(family):
    rng = np.random.default_rng(1)
    for cut in (stats.uniform(0.25, 0.2), stats.expon(scale=0.5), stats.uniform(0.9, 0.2)):
        for count in (8, 20, 60):
            seen = [drawn(TRUTH[family], cut, rng, count) for _ in range(20)]
            for observed in (log for log in seen if log.complete.size >= 5):
                dist, _, aic = estimate(family, observed)
                assert dist.pdf(observed.complete).min() > 0.0
                assert dist.sf(observed.censored).min(initial=1.0) > 0.0
                assert np.isfinite(aic)


@pytest.mark.parametrize("family", ["shifted exponential", "uniform"])
def test_no_logged_sojourn_is_impossible_under_the_fit(family):
    for logs in (one_log(TRUTH[family]), short_logs(TRUTH[family], count=40)):
        model = SemiMarkov.fit(logs, family=family)
        for dist, seen in zip(model.sojourn, sojourns_of(logs), strict=True):
            assert dist.pdf(seen.complete).min() > 0.0
            assert dist.sf(seen.censored).min(initial=1.0) > 0.0


def test_jump_probabilities_are_shares_of_the_switches():
    signal = SemiMarkov(stats.gamma(3.0, scale=0.2), JUMPS).sample(600.0, seed=5)
    model = SemiMarkov.fit(signal)
    pairs = list(zip(signal.modes, signal.modes[1:], strict=False))
    counts = np.array([[pairs.count((i, j)) for j in range(3)] for i in range(3)], dtype=float)
    visits = counts.sum(axis=1, keepdims=True)
    assert model.transition == pytest.approx(counts / visits, rel=1e-12)
    assert (np.abs(model.transition - JUMPS) <= 3.0 * np.sqrt(JUMPS * (1 - JUMPS) / visits)).all()


@pytest.mark.few(2)
@pytest.mark.parametrize("family", TRUTH)
def test_the_unit_of_time_only_scales_the_fit(family):
    logs = short_logs(TRUTH[family], count=60)
    slow = [SwitchingSignal(1000.0 * log.times, log.modes, 1000.0 * log.end) for log in logs]
    fits = [SemiMarkov.fit(signals, family=family) for signals in (logs, slow)]
    assert fits[1].mean == pytest.approx(1000.0 * fits[0].mean, rel=1e-6)
    assert fits[1].goodness[0].distance == pytest.approx(fits[0].goodness[0].distance, rel=1e-4)


def test_recordings_that_begin_amid_a_sojourn_are_read_without_it():
    """The sojourn under way at a fixed instant is longer than most, and cut at its front."""
    truth = TRUTH["gamma"]
    whole = [SemiMarkov(truth).sample(9.0, seed=i) for i in range(40)]
    aged = [signal.after(5.0) for signal in whole]
    bare = [SwitchingSignal(log.times, log.modes, log.end) for log in aged]
    model, dropped = SemiMarkov.fit(aged), SemiMarkov.fit(bare, first="drop")
    assert repr(model.goodness) == repr(dropped.goodness)
    assert model.goodness[0].complete < SemiMarkov.fit(bare).goodness[0].complete


# -- goodness ------------------------------------------------------------------------------


@pytest.mark.few(3)
@pytest.mark.parametrize("logs", [one_log, short_logs], ids=["complete", "censored"])
@pytest.mark.parametrize("family", TRUTH)
def test_the_criterion_is_that_of_the_distribution_returned(family, logs):
    signals = logs(TRUTH[family])
    model = SemiMarkov.fit(signals, family=family)
    for dist, good, seen in zip(model.sojourn, model.goodness, sojourns_of(signals), strict=True):
        expected = 2.0 * len(good.parameters) - 2.0 * log_likelihood(dist, seen)
        assert good.aic == pytest.approx(expected, rel=1e-12)


def test_auto_takes_the_family_of_least_aic():
    logs = short_logs(TRUTH["weibull"])
    best = SemiMarkov.fit(logs).goodness
    every = [SemiMarkov.fit(logs, family=family).goodness for family in TRUTH]
    for mode, fit in enumerate(best):
        assert fit.aic == min(other[mode].aic for other in every)


def test_auto_takes_a_uniform_only_where_it_is_the_best_by_four():
    """Sojourns at even spacings on 1..2 s: the more there are, the plainer it is."""
    leads = []
    for count in (8, 12, 16, 20, 24, 32):
        logs = paired(np.linspace(1.0, 2.0, count))
        *others, uniform = (
            SemiMarkov.fit(logs, family=family).goodness[0].aic
            for family in [*(set(TRUTH) - {"uniform"}), "uniform"]
        )
        leads.append(min(others) - uniform)
        taken = SemiMarkov.fit(logs).goodness[0].family
        assert (taken == "uniform") == (leads[-1] > 4.0)
    assert any(0.0 < lead < 4.0 for lead in leads)
    assert leads[-1] > 4.0


@pytest.mark.few(1)
@pytest.mark.parametrize(("family", "most"), [("gamma", 2), ("exponential", 2), ("uniform", 30)])
def test_auto_seldom_takes_ten_sojourns_for_uniform_ones(family, most):
    """Whatever they are; with the criterion of the extreme observations it took 29 of 40 gammas."""
    rng = np.random.default_rng(2)
    logs = [paired(TRUTH[family].rvs(10, random_state=rng)) for _ in range(20)]
    taken = [good.family for log in logs for good in SemiMarkov.fit(log).goodness]
    assert taken.count("uniform") <= most


@pytest.mark.parametrize("family", ["shifted exponential", "uniform", "lognormal"])
def test_auto_recognises_families_that_are_unlike_the_others(family):
    assert {fit.family for fit in SemiMarkov.fit(one_log(TRUTH[family])).goodness} == {family}


def test_equal_sojourns_are_fixed_ones():
    model = SemiMarkov.fit(SemiMarkov([0.3, 0.7]).sample(60.0, seed=1))
    assert [fit.family for fit in model.goodness] == ["fixed", "fixed"]
    assert [fit.distance for fit in model.goodness] == [0.0, 0.0]
    assert model.mean == pytest.approx([0.3, 0.7], rel=1e-12)
    assert model.ages(0.1) == 7
    cut_later = paired([0.3] * 9, [0.4])
    assert SemiMarkov.fit(cut_later).goodness[0].family != "fixed"


@pytest.mark.few(1)
@pytest.mark.parametrize("logs", [one_log, short_logs], ids=["complete", "censored"])
def test_the_distance_is_small_for_the_right_family_and_large_for_a_wrong_one(logs):
    for family, truth in TRUTH.items():
        for fit in SemiMarkov.fit(logs(truth), family=family).goodness:
            assert fit.p_value > 0.02
            assert fit.distance < 1.4 / np.sqrt(fit.complete)
    for fit in SemiMarkov.fit(logs(TRUTH["shifted exponential"]), family="exponential").goodness:
        assert fit.p_value < 1e-6
        assert fit.distance > 0.25


def test_each_mode_may_have_its_own_family():
    logs = short_logs(TRUTH["gamma"])
    model = SemiMarkov.fit(logs, family=["gamma", "weibull"])
    assert [fit.family for fit in model.goodness] == ["gamma", "weibull"]
    numbers = r"a=\S+, scale=\S+; \d+ complete, \d+ censored, distance=0\.\d{3}, p_value=\S+, aic="
    assert re.match(rf"Goodness\(gamma, {numbers}", repr(model.goodness[0]))
    assert SemiMarkov(1.0).goodness is None


# -- refusals ------------------------------------------------------------------------------

logs = paired([1.0, 2.0, 3.0, 4.0, 5.0])
fit = SemiMarkov.fit


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: fit(paired([1.0, 2.0, 3.0])),
            "signals hold only 3 complete sojourns of mode 0: at least 5 are needed to fit; log "
            "longer, or give SemiMarkov a distribution.",
        ),
        (lambda: fit(logs, modes=3), "signals hold only 0 complete sojourns of mode 2"),
        (lambda: fit(SwitchingSignal.constant(0)), "signals hold only 0 complete sojourns of mode"),
        (lambda: fit([]), "signals must be a SwitchingSignal or a list of at least one, got an"),
        (lambda: fit(3), "signals must be a SwitchingSignal or a list of at least one, got int."),
        (lambda: fit([*logs, 1.0]), "signals[1] must be a SwitchingSignal, got float."),
        (lambda: fit(logs, modes=1), "modes must be an integer of at least 2, got 1."),
        (
            lambda: fit([SwitchingSignal([0, 1], [0, 2])], modes=2),
            "signal enters mode 2 at 1 s, but the plant's modes are 0..1",
        ),
        (lambda: fit(logs, first="half"), "first must be 'whole' or 'drop', got 'half'."),
        (
            lambda: fit(logs, family="normal"),
            "family must be 'auto' or one of exponential, shifted exponential, gamma, weibull, "
            "uniform, lognormal, fixed, got 'normal'.",
        ),
        (lambda: fit(logs, family=["gamma", 3]), "family[1] must be 'auto' or one of"),
        (lambda: fit(logs, family=["gamma"]), "family must have one entry per mode, 2, got 1."),
        (
            lambda: fit(logs, family="fixed"),
            "family 'fixed' cannot be fitted to the sojourns of mode 0, which last from 1 to 5 s",
        ),
        (lambda: fit(paired([2.0] * 5), family="uniform"), "family 'uniform' cannot be fitted"),
    ],
)
def test_a_fit_that_cannot_be_made_is_refused_by_name(call, message):
    with pytest.raises(ArgumentError, match=re.escape(message)):
        call()
