"""The batch engine against `simulate` and a plain loop: every law, limits, odd sizes."""

import itertools

import numpy as np
import pytest
import scipy.linalg

import deadtime as dt
import plants
from deadtime.imperfections import RateLimit, Saturation
from deadtime.plant import SampledPlant
from deadtime.scenarios.batch_loop import Loop
from deadtime.scenarios.engine import Engine, ModelAhead
from deadtime.scenarios.lane_loop import run_scenarios
from deadtime.scenarios.scenario_sums import ScenarioSums, metrics_of, needs_own_run
from deadtime.switching import SignalBatch
from shares import mostly_long

X0 = np.array([0.3, -0.6, 0.9])
X0.setflags(write=False)  # as in `monte_carlo`: another layout would be compiled once more
H, HORIZON, COUNT = 0.1, 6.03, 7
TRUTH, BELIEVED = plants.generic(), plants.generic(0.3, seed=5)
LIMITS = (Saturation([-2.0, -1.0], 1.5), RateLimit([9.0, 12.0]))


def signals(count=COUNT):
    """Switches off the grid of samples, several of them in some periods; odd ages at the start."""
    drawn = [
        dt.SwitchingSignal.random(3, HORIZON + 9.0, dwell_time=0.03, seed=i) for i in range(count)
    ]
    return [
        dt.SwitchingSignal(s.times, s.modes, s.end, initial_age=0.07 * i)
        for i, s in enumerate(drawn)
    ]


SIGNALS = signals()


def loop_of(plant=TRUTH, actuators=()):
    return Loop(SampledPlant(plant, H), X0, HORIZON, actuators)


def table_of(engine, loop, law, own=SIGNALS):
    samples = loop.whole + 1
    if law.preview(H, own[0], samples) is not None:
        ahead = ModelAhead(law, law.sampled_plant(H), samples)
        return engine.along(ahead, SignalBatch.of(own))
    return engine.table(law.digital(H, own[0], samples))


def check_as_simulated(loop, law, scenarios=(3, 6)):
    """Metrics, states and inputs of some scenarios are those of `simulate`, to 1e-11 of each."""
    engine = Engine(loop)
    figures, path = engine.path(
        table_of(engine, loop, law), loop.sample_signals(SignalBatch.of(SIGNALS)), 0, COUNT
    )
    assert path.x.shape == (COUNT, 3, loop.whole + 1)
    assert not needs_own_run(figures).any()
    found = metrics_of(loop, figures)
    for i in scenarios:
        run = dt.simulate(loop.plant, law, SIGNALS[i], X0, HORIZON, H, imperfections=loop.actuators)
        for name, value in run.metrics().items():
            assert found[name][i] == pytest.approx(value, rel=1e-11), name
        plants.close(path.x[i], run.states[:, : loop.whole + 1], 1e-11)
        plants.close(path.u[i], run.inputs[:, : loop.whole + 1], 1e-11)


# -- against simulate --------------------------------------------------------------------------


# Factored rows, and rows by mode. Batches of other tests have the others; of a law that knows its
# signal so do the tests below.
@pytest.mark.few(1)
@pytest.mark.parametrize("name", mostly_long(plants.LAWS, "averaged", "expected"))
def test_every_law_runs_as_simulated_on_a_plant_that_is_not_its_own(name):
    assert TRUTH.delay % H > 0.0
    assert HORIZON % H > 0.0
    check_as_simulated(loop_of(), plants.LAWS[name](BELIEVED))


@pytest.mark.long  # limits are beside other imperfections in `test_imperfect_batches`
@pytest.mark.parametrize("name", ["averaged", "mean, dwell-aware"])
def test_limited_inputs_are_as_simulated(name):
    check_as_simulated(loop_of(actuators=LIMITS), plants.LAWS[name](BELIEVED))


@pytest.mark.parametrize("name", mostly_long(["averaged", "exact"], "averaged"))
def test_a_window_longer_than_the_run_is_as_simulated(name):
    loop = loop_of(plants.generic(8.04))
    assert loop.sampled.longest_lag > loop.whole + 1
    check_as_simulated(loop, plants.LAWS[name](plants.generic(8.54, seed=5)), scenarios=(3,))


@pytest.mark.long  # as longer windows are; a kernel of its own
def test_a_window_of_one_input_is_as_simulated():
    check_as_simulated(loop_of(plants.generic(H)), plants.LAWS["averaged"](plants.generic(0.06)))


# -- a law that knows the signal ---------------------------------------------------------------


def predicted(plant, signal, x, inputs, start):
    """x a delay after `start` along a signal; inputs[j](t) is held, by SciPy's exponential."""
    end = start + plant.delay
    back = np.arange(1, int(plant.delay / H) + 2)
    arrivals = [(np.round(start / H) - j) * H + plant.delay for j in back]
    edges = sorted({start, end, *(t for t in (*arrivals, *signal.times) if start < t < end)})
    for low, high in itertools.pairwise(edges):
        if high - low > 1e-12:
            middle = 0.5 * (low + high)
            mode, sample = int(signal(middle)), int(np.floor((middle - plant.delay) / H))
            u = inputs[sample] if sample >= 0 else np.zeros(plant.inputs)
            x = (held(plant.A[mode], plant.B[mode], high - low)[0] @ [*x, *u])[: plant.states]
    return x


@pytest.mark.parametrize("delay", mostly_long([0.06, 0.1, 0.234, 0.3, 8.54], 0.234))
def test_an_oracle_predicts_along_its_signal(delay):
    loop, law = loop_of(), plants.LAWS["exact"](plants.generic(delay, seed=5))
    engine = Engine(loop)
    periods = loop.sample_signals(SignalBatch.of(SIGNALS))
    _, path = engine.path(table_of(engine, loop, law), periods, 0, COUNT)
    for i in (0, 3, 6):
        for k in (0, 1, 2, 17, 40, 60):
            x, u = path.x[i, :, k], path.u[i, :, :k].T
            ahead = predicted(law.plant, SIGNALS[i], x, u, k * H)
            mode = int(SIGNALS[i](k * H + delay + 1e-9 * H))
            np.testing.assert_allclose(path.u[i, :, k], law.gains[mode] @ ahead, rtol=1e-10)


def test_an_oracle_may_be_filtered_and_may_believe_in_a_signal_of_its_own():
    believed = plants.generic(0.234, seed=5)
    gains = plants.gains(believed)
    own = dt.ExactPredictor(believed, gains, SIGNALS[2])
    for law in (dt.LowPassPredictor(plants.LAWS["exact"](believed), 0.08), own):
        check_as_simulated(loop_of(), law, scenarios=(1, 4))


# -- against a plain loop ----------------------------------------------------------------------


def held(A, B, length):
    """Over a time with the input held: e^{Ml} of M = [[A, B], [0, 0]], and ∫|x|² = zᵀ E z."""
    n, m = B.shape
    M, C = np.zeros((n + m, n + m)), np.zeros((n + m, n + m))
    M[:n, :n], M[:n, n:], C[:n, :n] = A, B, np.eye(n)
    # Van Loan, IEEE Trans. Automatic Control 1978.
    both = scipy.linalg.expm(np.block([[-M.T, C], [np.zeros_like(M), M]]) * length)
    move = both[n + m :, n + m :]
    return move, move.T @ both[: n + m, n + m :]


def plain_figures(plant, law, signal):
    """What `ScenarioSums` says it holds, from dense rows and an exponential for every stretch."""
    feedback, m = law.digital(H), plant.inputs
    samples, taps = int(HORIZON / H) + 1, feedback.taps
    back = int(np.ceil(plant.delay / H))
    phase = plant.delay - (back - 1) * H
    u, x = np.zeros((samples + back + taps, m)), X0.copy()  # inputs from before time 0 lie behind
    mode, age = int(signal(0.0)), int(signal.initial_age / H) - 1
    squares, ise = [], 0.0
    for k in range(samples):
        squares.append(x @ x)
        age = age + 1 if int(signal(k * H)) == mode else 0
        mode = int(signal(k * H))
        row = 0
        if feedback.context == "mode_age":
            row = mode * feedback.ages + min(age, feedback.ages - 1)
        u[k] = feedback.state_gain[row] @ x
        for j in range(1, taps + 1):
            u[k] += feedback.input_gain[row, j - 1] @ u[k - j]
        end = min(H, HORIZON - k * H)
        edges = {0.0, min(phase, end), end, *(signal.times - k * H)}
        for low, high in itertools.pairwise(sorted(t for t in edges if 0.0 <= t <= end)):
            now = int(signal(k * H + 0.5 * (low + high)))
            z = np.concatenate((x, u[k - back if high <= phase else k - back + 1]))
            move, energy = held(plant.A[now], plant.B[now], high - low)
            ise, x = ise + z @ energy @ z, (move @ z)[:3]
    squares, spent = np.array(squares), (u[:samples] ** 2).sum(axis=1)
    late = np.log(squares[np.arange(samples) * H >= HORIZON / 2])
    outside = np.flatnonzero(squares > 0.02**2 * squares.max())[-1]
    energy = spent[:-1].sum() + spent[-1] * (HORIZON / H - (samples - 1))
    sums = late.sum(), np.cumsum(late).sum()
    return ScenarioSums(ise, energy, squares.max(), outside, np.exp(late.min()), *sums, x @ x)


@pytest.mark.parametrize("name", mostly_long(["averaged", "averaged, dwell-aware"], "averaged"))
def test_figures_of_all_scenarios_are_those_of_a_plain_loop(name):
    loop, law = loop_of(), plants.LAWS[name](BELIEVED)
    engine = Engine(loop)
    figures = engine.run(table_of(engine, loop, law), loop.sample_signals(SignalBatch.of(SIGNALS)))
    plain = np.array([plain_figures(TRUTH, law, signal) for signal in SIGNALS])
    for field, found, wanted in zip(ScenarioSums._fields, figures, plain.T, strict=True):
        assert found == pytest.approx(wanted, rel=1e-10), field


# -- what it promises --------------------------------------------------------------------------


def test_the_part_that_is_asked_for_changes_nothing():
    loop = loop_of()
    engine, periods = Engine(loop), loop.sample_signals(SignalBatch.of(SIGNALS))
    table = table_of(engine, loop, plants.LAWS["averaged"](BELIEVED))
    whole, some = engine.run(table, periods), engine.run(table, periods, 1, 6)
    for mine, theirs in zip(some, whole, strict=True):
        np.testing.assert_array_equal(mine, theirs[1:])
    late, path = (
        engine.path(table, periods, 1, 6, keep=40)[1],
        engine.path(table, periods, 0, COUNT)[1],
    )
    np.testing.assert_array_equal(late.u, path.u[1:, :, 40:])
    np.testing.assert_array_equal(late.x, path.x[1:, :, 40:])


def test_laws_and_signals_of_one_shape_are_compiled_once():
    loop = loop_of()
    engine, other = Engine(loop), [*SIGNALS[::-1], SIGNALS[3]]
    periods = [loop.sample_signals(SignalBatch.of(some)) for some in (SIGNALS, other)]
    engine.run(table_of(engine, loop, plants.LAWS["averaged"](BELIEVED)), periods[0])
    compiled = len(run_scenarios.dispatcher.signatures)
    for law in (plants.LAWS["weighted"](BELIEVED), plants.LAWS["averaged"](BELIEVED.apart(0.5))):
        for one in periods:
            engine.run(table_of(engine, loop, law), one)
    assert len(run_scenarios.dispatcher.signatures) == compiled
