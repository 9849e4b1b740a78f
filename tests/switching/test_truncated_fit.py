"""Fitting sojourns between known limits: recovery, and the likelihood written out once more."""

import math
import tomllib

import numpy as np
import pytest
from scipy import integrate, optimize, stats

from deadtime import ArgumentError, SemiMarkov, SwitchingSignal
from deadtime.cli.application import main
from deadtime.problems.switching_registry.entries.switching_models import SemiMarkovSwitching
from deadtime.switching.models.fit import sojourns_of
from shares import mostly_long

LOW, HIGH = 0.2, 1.3
TRUTH = {
    "exponential": (stats.expon, {"scale": 0.7}),
    "gamma": (stats.gamma, {"a": 3.0, "scale": 0.25}),
    "weibull": (stats.weibull_min, {"c": 2.2, "scale": 0.8}),
    "lognormal": (stats.lognorm, {"s": 0.5, "scale": 0.6}),
}
LIMITS = {"dwell_time": LOW, "maximum_dwell": HIGH}


def logs_of(family, count, length, modes=3, seed=0):
    """Short logs, whose last sojourns are cut off, drawn by the inverse of the distribution."""
    kind, parameters = TRUTH[family]
    rng, dist, found = np.random.default_rng(seed), kind(**parameters), []
    ends = dist.cdf([LOW, HIGH])
    for k in range(count):
        times, at = [0.0], [k % modes]
        while times[-1] < length:
            times.append(times[-1] + float(dist.ppf(rng.uniform(*ends))))
            at.append((at[-1] + int(rng.integers(1, modes))) % modes)
        found.append(SwitchingSignal(times[:-1], at[:-1], end=length))
    return found


def written_out(family, observed):
    """−log likelihood of parameters: densities by SciPy, every mass by quadrature of them."""
    kind, _ = TRUTH[family]

    def value(logs):
        dist = kind(*np.exp(logs[:-1]), scale=math.exp(logs[-1]))
        grid = np.linspace(LOW, HIGH, 4001)
        below = integrate.cumulative_simpson(dist.pdf(grid), x=grid, initial=0.0)
        rest = below[-1] - np.interp(np.maximum(observed.censored, LOW), grid, below)
        seen = np.log(dist.pdf(observed.complete) / below[-1]).sum()
        return -(seen + np.log(rest / below[-1]).sum())

    return value


@pytest.mark.few(1)
@pytest.mark.parametrize("family", TRUTH)
def test_the_fit_is_where_the_likelihood_that_is_written_out_is_largest(family):
    logs = logs_of(family, 60, 6.0)
    model = SemiMarkov.fit(logs, family=family, **LIMITS)
    observed = sojourns_of(logs)[0]
    assert observed.censored.size >= 10
    value = written_out(family, observed)
    found = model.goodness[0].parameters
    at = np.log(list(found.values()))
    for start in (at + 0.3, at - 0.2):
        near = list(zip(at - 0.7, at + 0.7, strict=True))
        other = optimize.minimize(value, start, method="L-BFGS-B", bounds=near)
        assert value(at) <= other.fun + 1e-5
        assert np.exp(other.x) == pytest.approx(list(found.values()), rel=5e-3)
    fixed = 2.0 * len(found)
    assert model.goodness[0].aic == pytest.approx(fixed + 2.0 * value(at), rel=1e-6)
    assert model.sojourn[0].sf([LOW, HIGH]) == pytest.approx([1.0, 0.0])


@pytest.mark.parametrize("family", mostly_long(TRUTH, "gamma"))
def test_parameters_come_back_which_a_fit_that_ignores_the_limits_misses(family):
    truth = np.array(list(TRUTH[family][1].values()))
    logs = logs_of(family, 25, 300.0, seed=3)
    known = SemiMarkov.fit(logs, family=family, **LIMITS).goodness
    plain = SemiMarkov.fit(logs, family=family).goodness
    each = np.array([list(good.parameters.values()) for good in known])
    assert known[0].complete > 3_000
    assert np.abs(each / truth - 1.0).max() < 0.15
    off = np.array([list(good.parameters.values()) for good in plain]) / truth - 1.0
    assert np.abs(off).max() > 2.0 * np.abs(each / truth - 1.0).max()
    assert min(good.p_value for good in known) > 0.01
    assert max(good.p_value for good in plain) < 0.01


def test_a_known_minimum_of_an_exponential_is_a_shift_by_hand():
    """Memoryless: beyond the minimum it begins anew, and scale = Σ(t − low)/n."""
    rng = np.random.default_rng(1)
    lengths = LOW + rng.exponential(0.4, 60)
    times = np.concatenate(([0.0], np.cumsum(lengths)))
    log = SwitchingSignal(times, np.arange(times.size) % 2, end=times[-1] + 0.9)
    model = SemiMarkov.fit(log, family="exponential", dwell_time=LOW)
    scale = ((lengths[::2] - LOW).sum() + 0.9 - LOW) / 30
    assert model.goodness[0].parameters["scale"] == pytest.approx(scale, rel=1e-6)
    assert model.goodness[0].censored == 1
    assert model.mean[0] == pytest.approx(LOW + scale, rel=1e-6)
    auto = SemiMarkov.fit(log, dwell_time=[LOW, 0.1], maximum_dwell=[math.inf, 9.0])
    assert auto.sojourn[1].low == 0.1
    assert auto.sample(30.0, seed=2).dwell_time > 0.1


def alternating(lengths):
    times = np.concatenate(([0.0], np.cumsum(lengths)))
    return SwitchingSignal(times[:-1], np.arange(times.size - 1) % 2, end=times[-1])


def test_sojourns_that_end_soon_after_the_minimum_leave_a_model_though_their_survival_underflows():
    """e^(−10/0.01) is 0 in floats, and what is left of an exponential there is one again."""
    lengths = 10.0 + np.random.default_rng(0).exponential(0.01, 201)
    model = SemiMarkov.fit(alternating(lengths), family="exponential", dwell_time=10.0)
    scale = (lengths[:-1:2].sum() + lengths[-1] - 10.0 * 101) / 100
    assert model.goodness[0].parameters["scale"] == pytest.approx(scale, rel=1e-6)
    assert model.sojourn[0].sf([9.0, 10.0 + scale]) == pytest.approx([1.0, math.exp(-1.0)])
    assert model.sojourn[0].cdf([0.0, 10.0]).tolist() == [0.0, 0.0]
    assert model.mean[0] == pytest.approx(10.0 + scale, rel=1e-9)
    again = SemiMarkov(stats.expon(scale=0.01), modes=2, dwell_time=10.0)
    assert again.sojourn[0].sf(10.01) == pytest.approx(math.exp(-1.0))


@pytest.mark.long
def test_of_such_sojourns_no_gamma_is_fitted_whose_survival_underflows():
    lengths = 10.0 + np.random.default_rng(0).exponential(0.01, 201)
    auto = SemiMarkov.fit(alternating(lengths), dwell_time=10.0)
    assert auto.mean == pytest.approx([lengths[::2].mean(), lengths[1::2].mean()], abs=1e-3)
    with pytest.raises(ArgumentError, match="family 'gamma' cannot be fitted"):
        SemiMarkov.fit(alternating(lengths), family="gamma", dwell_time=10.0)


def test_a_log_that_ends_when_a_sojourn_has_lasted_longest_has_seen_it_end():
    kind, parameters = TRUTH["gamma"]
    dist, rng = kind(**parameters), np.random.default_rng(2)
    lengths = dist.ppf(rng.uniform(*dist.cdf([LOW, HIGH]), 101))
    lengths[-1] = HIGH
    cut = SemiMarkov.fit(alternating(lengths), family="gamma", **LIMITS)
    whole = SemiMarkov.fit(alternating(np.append(lengths, 0.1)), family="gamma", **LIMITS)
    assert cut.goodness[0].parameters == pytest.approx(whole.goodness[0].parameters, rel=1e-6)


def test_what_cannot_be_is_refused_by_name():
    logs = logs_of("gamma", 10, 20.0)
    shortest = sojourns_of(logs)[0].complete[0]
    with pytest.raises(ArgumentError, match=f"a sojourn of {shortest:g} s in mode 0, shorter"):
        SemiMarkov.fit(logs, dwell_time=0.5)
    with pytest.raises(ArgumentError, match=r"in mode 1, longer than its maximum_dwell of 0\.5"):
        SemiMarkov.fit(logs, maximum_dwell=[2.0, 0.5, 2.0])
    for family in ("uniform", "shifted exponential"):
        with pytest.raises(ArgumentError, match=r"family must not be .* which are its parameters"):
            SemiMarkov.fit(logs, family=family, dwell_time=LOW)
    even = np.linspace(0.3, 1.25, 41)[1:]  # crowds upwards: no exponential describes it best
    times = np.concatenate(([0.0], np.cumsum(np.repeat(even, 2))))
    log = SwitchingSignal(times, np.arange(times.size) % 2)
    with pytest.raises(ArgumentError, match="family 'exponential' cannot be fitted"):
        SemiMarkov.fit(log, family="exponential", **LIMITS)
    crowded = alternating(HIGH - 1e-3 * np.arange(40) / 40)
    with pytest.raises(ArgumentError, match=r"'auto' cannot be .*: give SemiMarkov a distribution"):
        SemiMarkov.fit(crowded, **LIMITS)


def test_the_command_line_fits_between_limits_and_prints_a_section_that_says_so(tmp_path, capsys):
    log = logs_of("gamma", 1, 200.0, modes=2)[0]
    path = tmp_path / "log.csv"
    log.to_csv(path)
    options = ["--dwell-time", "0.2", "--maximum-dwell", "1.3,inf", "--family", "gamma"]
    with pytest.raises(SystemExit) as stopped:
        main(["fit", str(path), *options, "--out", str(tmp_path / "fit.png")])
    assert stopped.value.code == 0
    section = capsys.readouterr().out.split("[switching]\n")[1].split("\n\n")[0]
    table = tomllib.loads(section)
    assert (table["dwell_time"], table["maximum_dwell"]) == ([0.2, 0.2], [1.3, math.inf])
    model = SemiMarkovSwitching(**table).model(2, tmp_path)
    limits = {"dwell_time": LOW, "maximum_dwell": [HIGH, math.inf]}
    fitted = SemiMarkov.fit(SwitchingSignal.from_csv(path), family="gamma", **limits)
    t = np.linspace(0.0, 3.0, 50)
    for one, other in zip(model.sojourn, fitted.sojourn, strict=True):
        assert one.sf(t) == pytest.approx(other.sf(t), abs=1e-12)
