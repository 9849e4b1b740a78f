"""The batch engine: cut periods, window sums without drift, the same whatever the block."""

import importlib
import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
import scipy.linalg

import deadtime as dt
import plants
import reference
from deadtime.plant import SampledPlant
from deadtime.plant.pieces import Stretch
from deadtime.scenarios import draw_signals
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.engine import Engine, window_form
from deadtime.switching import SignalBatch

METRICS = ("ise", "energy", "cost", "peak", "settling_time", "decay_rate", "final_norm")
PAPER = plants.paper()
H = 0.05
X0 = [-1.0, 1.0]


def same_as_simulate(plant, laws, signals, x0, horizon, step, rel=1e-9, **options):
    """Every entry of `monte_carlo` against the metrics of its run by `simulate`."""
    data = dt.monte_carlo(plant, laws, signals, x0, horizon, step, **options)
    assert data.attrs["one_by_one"] == []
    for name, law in laws.items():
        for i, signal in enumerate(signals):
            imperfections = options.get("imperfections", ())
            run = dt.simulate(
                plant, law, signal, x0, horizon, step, imperfections=imperfections
            ).metrics()
            found = data.sel(law=name).isel(scenario=i)
            measured = {key: found[key].item() for key in METRICS}
            assert measured == pytest.approx(run, rel=rel), (name, i)
    return data


# -- against a second method -------------------------------------------------------------------


def test_trajectories_are_those_of_exact_fractions_and_taylor_series():
    # Three modes, two inputs, φ ≠ h, two switches in one period, one on the grid; the law's model
    # has another delay and other matrices than the plant.
    plant, believed = plants.generic(0.234), plants.near(0.26)
    law = plants.LAWS["averaged"](believed)
    signals = [plants.off_grid(), dt.SwitchingSignal([0, 0.234], [1, 2])]
    x0 = np.array([1.0, -0.5, 0.3])
    data = dt.monte_carlo(plant, {"law": law}, signals, x0, 2.35, 0.1, trajectories=True)
    step = Fraction(1, 10)
    for i, signal in enumerate(signals):
        times = [Fraction(str(round(t, 4))) for t in signal.times.tolist()]
        exact = reference.Signal(times, signal.modes.tolist())
        loop = reference.Loop(
            reference.Model(plant.A, plant.B, Fraction("0.234")), exact, step, np.zeros((3, 2))
        )
        model = reference.Model(believed.A, believed.B, Fraction("0.26"))
        weights = np.full(3, 1 / 3)
        rule = reference.averaged(model, law.gains, weights)
        states, inputs, scale = loop.run(rule, x0, data.time.size)
        for found, wanted in ((data.x, states), (data.u, inputs)):
            plants.close(found.values[0, i].T, wanted, 1e-12, scale)


def test_maps_of_cut_periods_are_products_of_exponentials():
    # Random switches, up to several in a period, against SciPy's exponential of [[A, B], [0, 0]].
    plant = plants.generic(0.234)
    loop = Loop(SampledPlant(plant, 0.1), np.ones(3), 3.03)
    rng = np.random.default_rng(1)
    times = np.concatenate(([0.0], np.sort(rng.uniform(0.0, 3.03, 70))))
    signal = dt.SwitchingSignal(times, rng.integers(0, 3, 71))
    periods = loop.sample_signals(SignalBatch.of([signal]))
    cut = np.flatnonzero(periods.records.map >= 3)
    assert cut.size > 20
    for record in cut:
        k = int(periods.records.step[record])
        end = 0.03 if k == 30 else 0.1
        edges = [0.0, 0.034, *(signal.times[1:] - k * 0.1), end]
        edges = sorted(t for t in set(edges) if 0.0 <= t <= end)
        z = np.eye(7)
        for a, b in itertools.pairwise(edges):
            mode = int(signal(k * 0.1 + 0.5 * (a + b)))
            own = np.zeros((7, 7))
            own[:3, :3] = plant.A[mode]
            own[:3, 3:5] = plant.B[mode] if b <= 0.034 else 0.0
            own[:3, 5:] = plant.B[mode] if b > 0.034 else 0.0
            z = scipy.linalg.expm(own * (b - a)) @ z
        move = periods.maps[periods.records.map[record], :21].reshape(3, 7)
        np.testing.assert_allclose(move, z[:3], rtol=0, atol=2e-14 * np.abs(z).max())


class OwnLags(SampledPlant):
    """A plant that reads inputs of lags of their own, input by input and mode by mode."""

    PIECES = (
        ((0.03, (3, 2)), (0.06, (2, 2)), (0.1, (2, 1))),
        ((0.1, (2, 2)),),
        ((0.05, (3, 3)), (0.1, (2, 3))),
    )

    def stretches(self, mode):
        start, result = 0.0, []
        for stop, lag in self.PIECES[mode]:
            result.append(Stretch(start, stop, np.array(lag)))
            start = stop
        return tuple(result)


@pytest.mark.few(1)
@pytest.mark.parametrize("tabulated", [True, False])
def test_every_input_and_mode_may_have_lags_of_its_own(tabulated, monkeypatch):
    # Against a loop that reads who acts when between any two events, with SciPy's exponential.
    if not tabulated:
        monkeypatch.setattr("deadtime.scenarios.periods.MOST_NUMBERS", 0.0)
    plant, step, samples = plants.generic(0.234), 0.1, 30
    loop = Loop(OwnLags(plant, step), np.ones(3), samples * step + 0.03)
    rng = np.random.default_rng(1)
    times = np.concatenate(([0.0], np.sort(rng.uniform(0.0, 3.0, 40))))
    signal = dt.SwitchingSignal(times, rng.integers(0, 3, 41))
    table = plants.LAWS["averaged"](plant).digital(step)
    engine = Engine(loop)
    _, path = engine.path(engine.table(table), loop.sample_signals(SignalBatch.of([signal])), 0, 1)
    F, G = table.state_gain[0], table.latest_first[0].reshape(2, -1, 2)
    x, inputs = np.ones(3), [np.zeros(2)] * table.taps
    for k in range(samples):
        inputs.append(F @ x + np.einsum("ijp,jp->i", G, inputs[: -table.taps - 1 : -1]))
        np.testing.assert_allclose(path.x[0, :, k], x, rtol=1e-11)
        np.testing.assert_allclose(path.u[0, :, k], inputs[-1], rtol=1e-11)
        events = {0.0, 0.03, 0.05, 0.06, 0.1, *(signal.times - k * step)}
        for a, b in itertools.pairwise(sorted(t for t in events if 0.0 <= t <= step)):
            mode = int(signal(k * step + 0.5 * (a + b)))
            lag = next(lag for stop, lag in OwnLags.PIECES[mode] if 0.5 * (a + b) < stop)
            Phi, Gamma = plants.held(plant.A[mode], plant.B[mode], b - a)
            x = Phi @ x + Gamma @ [inputs[-1 - lag[0]][0], inputs[-1 - lag[1]][1]]


@pytest.mark.parametrize("fast", [pytest.param(False, marks=pytest.mark.long), True])
def test_plants_of_any_speed_and_any_number_of_modes_agree_with_single_runs(fast):
    # Fast: a period of several time constants, so in many cells; otherwise more modes than pairs
    # of them are tabulated for.
    modes = 3 if fast else 120
    a = np.linspace(-40.0, 0.5, modes) if fast else np.linspace(-1.0, 0.3, modes)
    plant = plants.scalar(a, delay=0.33)
    gains = -(a + 1.0)[:, None, None] if not fast else np.where(a > 0, -1.0, 0.0)[:, None, None]
    law = dt.AveragedPredictor(plant, gains)
    times = [0.0, 0.12, 0.13, 0.4, 0.77, 1.9]
    orders = ([0, 2, 1, 0, 2, 1], [1, 0, 2, 1, 2, 0])
    signals = [dt.SwitchingSignal(times, order) for order in orders]
    same_as_simulate(plant, {"law": law}, signals, [1.0], 4.02, 0.1)


# -- window sums -------------------------------------------------------------------------------


def driven():
    """Two unstable modes that an oscillation, which nothing damps, disturbs for ever."""
    A, B = np.zeros((2, 4, 4)), np.zeros((2, 4, 1))
    for mode, (a, d) in enumerate([(1.0, 1.0), (1.1, 0.9)]):
        A[mode, :2, :2] = [[a, 1.0], [0.5, a]]
        A[mode, :2, 2] = [0.2 * d, 0.1]
        A[mode, 2:, 2:] = [[0.0, 1.7], [-1.7, 0.0]]
        B[mode, :, 0] = [0.0, 1.0, 0.0, 0.0]
    plant = dt.SwitchedSystem(A, B, 0.75)
    placed = dt.place(dt.SwitchedSystem(A[:, :2, :2], B[:, :2], 0.75), [-1.0, -1.2])
    gains = np.concatenate((placed, np.zeros((2, 1, 2))), axis=2)
    return plant, dt.AveragedPredictor(plant, gains, allow_unstable=True)


@pytest.mark.long
@pytest.mark.parametrize("periods", [1_000_000, pytest.param(10_000_000, marks=pytest.mark.long)])
def test_window_sums_are_exact_after_millions_of_periods(periods):
    plant, law = driven()
    step = 0.01
    signals = dt.Markov([[0, 30.0], [30.0, 0]]).draw(2e3, seed=3, count=8)
    signals = [dt.SwitchingSignal(one.times, one.modes) for one in signals]
    loop = Loop(SampledPlant(plant, step), np.array([0.1, 0.0, 1.0, 0.0]), periods * step)
    engine, table = Engine(loop), law.digital(step)
    taps = table.taps
    assert window_form(table) is not None
    keep = periods - 2 * taps
    _, path = engine.path(
        engine.table(table), loop.sample_signals(SignalBatch.of(signals)), 0, 8, keep=keep
    )
    F, G = table.state_gain[0, 0], table.input_gain[0, :, 0, 0]
    for x, u in zip(path.x, path.u[:, 0], strict=True):
        assert 0.01 < np.abs(u).max() < 1e3
        for k in range(taps, 2 * taps):
            terms = [*(F * x[:, k]), *(G * u[k - taps : k][::-1])]
            assert abs(math.fsum(terms) - u[k]) <= 1e-12 * sum(map(abs, terms))


def test_a_basis_is_taken_only_where_its_taps_are_the_table_s():
    law = plants.LAWS["averaged"](PAPER)
    assert window_form(law.digital(0.01)).transition.shape[1:] == (1, 1)  # diagonal
    # A double integrator has no basis of eigenvectors.
    A = np.array([[[0.0, 1.0], [0.0, 0.0]]])
    chain = dt.SwitchedSystem(A, np.array([[[0.0], [1.0]]]), 1.0)
    law = dt.AveragedPredictor(chain, dt.place(chain, [-1.0, -2.0]))
    form = window_form(law.digital(0.01))
    assert form.transition.shape[1:] == (2, 2)
    found = np.einsum("cmq,jqp->cjmp", form.out, form.ahead[::-1])
    np.testing.assert_allclose(found, law.digital(0.01).input_gain[:, :-1], rtol=1e-12)
    assert window_form(plants.LAWS["averaged, dwell-aware"](PAPER).digital(0.01)) is None


@pytest.mark.parametrize("taps", [1, 100, 1_000, 10_000])
@pytest.mark.parametrize("law", ["averaged", "mean", "single"])
def test_the_cost_of_a_period_does_not_depend_on_the_periods_of_delay(law, taps):
    """Dense rows of 10,000 inputs would take 150 times as long."""
    table = plants.LAWS[law](PAPER).digital(PAPER.delay / taps)
    assert table.input_gain.shape[1] == taps
    assert window_form(table) is not None


# -- the same whatever the block ---------------------------------------------------------------

LAWS = {name: plants.LAWS[name](PAPER) for name in ("averaged", "expected", "exact")}
MODEL = dt.Markov([[0.0, 5.0], [4.0, 0.0]])


def run(model=MODEL, laws=LAWS, scenarios=21, horizon=4.0, **options):
    return dt.monte_carlo(PAPER, laws, model, X0, horizon, H, scenarios, **options)


def test_results_do_not_depend_on_blocks_threads_or_how_signals_are_handed_over(monkeypatch):
    whole = run(seed=4)
    signals = draw_signals(MODEL, 5.0, seed=4, count=21)
    assert run(model=signals, seed=4).identical(whole)
    assert run(model=list(signals), seed=4).identical(whole)
    part = draw_signals(MODEL, 5.0, seed=4, first=13, count=5)
    for name in METRICS:
        here = run(model=part)[name].values
        np.testing.assert_array_equal(here, whole[name].values[:, 13:18])
    module = importlib.import_module("deadtime.scenarios.batch_run")
    for block, threads in ((8, 1), (16, 3)):
        monkeypatch.setattr(module, "_BLOCK", block)
        assert run(seed=4, threads=threads).identical(whole)


def test_trajectories_are_those_of_single_runs_and_end_where_a_run_diverges():
    laws = {"averaged": LAWS["averaged"], "delayed": plants.LAWS["delayed"](PAPER)}
    data = run(laws=laws, scenarios=9, horizon=300.0, trajectories=True)
    assert data.x.dims == ("law", "scenario", "state", "time")
    assert data.u.dims == ("law", "scenario", "input", "time")
    signals = draw_signals(MODEL, 301.0, count=9)
    for name, law in laws.items():
        for i in (0, 8):
            single = dt.simulate(PAPER, law, signals[i], X0, 300.0, H)
            x = data.x.sel(law=name).isel(scenario=i).values
            kept = single.time.size
            scale = np.abs(single.states).max()
            np.testing.assert_allclose(x[:, :kept], single.states, rtol=1e-8, atol=1e-12 * scale)
            assert np.isnan(x[:, kept:]).all()
            here = data["mode"].isel(scenario=i).values[:kept]
            np.testing.assert_array_equal(here, single.mode)
    assert data.diverged.values.tolist() == [[False] * 9, [True] * 9]
    assert (
        data.attrs["message"] == "delayed diverged on 9 of 9 scenarios: 0, 1, 2, 3, 4, 5, 6, 7, 8."
    )


def test_a_vanishing_state_and_a_short_horizon_are_measured_as_in_single_runs():
    same_as_simulate(PAPER, {"law": LAWS["averaged"]}, [plants.off_grid(2)], [0.0, 0.0], 4.0, H)
    same_as_simulate(PAPER, {"law": LAWS["averaged"]}, [plants.off_grid(2)], X0, 0.63, H)


def test_a_first_mode_of_any_age_is_as_in_single_runs():
    law = {"law": plants.LAWS["averaged, dwell-aware"](PAPER)}
    ages = [0.0, 0.0634, 1e4, 1e300]
    signals = [dt.SwitchingSignal([0.0, 1.01], [0, 1], initial_age=age) for age in ages]
    data = same_as_simulate(PAPER, law, signals, X0, 4.0, H)
    assert np.unique(data.ise.values).size == 3


def test_what_would_not_fit_into_memory_is_refused_with_the_estimate(monkeypatch):
    module = importlib.import_module("deadtime.scenarios.batch_run")
    monkeypatch.setattr(module, "free_memory", lambda: 2.0**30)
    message = r"trajectories of 1,000,000 scenarios of 81 samples under 3 laws would take 5.* GiB"
    with pytest.raises(dt.ArgumentError, match=message):
        run(scenarios=1_000_000, trajectories=True)
    with pytest.raises(dt.ArgumentError, match="metrics of 10,000,000 scenarios would take"):
        run(scenarios=10_000_000)
    assert run(scenarios=9, trajectories=True).sizes["scenario"] == 9


def test_an_interrupt_keeps_what_is_done():
    def at_the_second_block(done, total):
        if done > 2048:
            raise KeyboardInterrupt

    laws = {"averaged": LAWS["averaged"]}
    whole = run(laws=laws, scenarios=16 * 2048)
    data = run(laws=laws, scenarios=400_000, progress=at_the_second_block)
    assert data.attrs["interrupted"] == 1
    done = data.scenario.size
    assert 2048 < done < 400_000
    assert data.attrs["message"] == f"interrupted after {done:,} of 400,000 scenarios."
    both = np.intersect1d(data.scenario.values, whole.scenario.values)
    assert both.size >= 2048  # which blocks are done by then is up to the threads
    found, wanted = (d.ise.sel(scenario=both).values for d in (data, whole))
    np.testing.assert_array_equal(found, wanted)


def test_an_error_in_a_block_reaches_the_caller():
    signals = [dt.SwitchingSignal([0.0], [0], end=4.5) for _ in range(20)]
    with pytest.raises(dt.ArgumentError, match="signal must be known up to the last sample"):
        run(model=signals)
