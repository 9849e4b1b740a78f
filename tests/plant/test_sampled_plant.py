"""SampledPlant: its pieces against the plant propagated by SciPy, with each input held by hand."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import deadtime as dt
import plants
from deadtime.plant import SampledPlant
from deadtime.plant.pieces import FEW, Stretches, gramians, pieces_along, up_to
from deadtime.plant.sampled_plant import acting_inputs
from deadtime.switching.grid import cuts_of

STEP = 0.1


def propagated(plant, mode, x, inputs, fine=700):
    """x(h) in small pieces; the input that acts at t was computed at ⌊(t − D)/h⌋, the latest 0."""
    A, B, h = plant.A[mode], plant.B[mode], STEP / fine
    Phi, Gamma = plants.held(A, B, h)
    for i in range(fine):
        sample = int(np.floor(((i + 0.5) * h - plant.delay) / STEP))
        x = Phi @ x + Gamma @ inputs[-sample]
    return x


# Multiples of h/700, where the pieces by hand may be cut.
@pytest.mark.parametrize("delay", [0.03, 0.1, 0.24, 0.3, 0.51])
@pytest.mark.parametrize("mode", range(3))
def test_a_period_is_what_its_pieces_and_the_plant_itself_do(delay, mode):
    plant = plants.generic(delay)
    rng = np.random.default_rng(mode)
    x, inputs = rng.normal(size=3), rng.normal(size=(9, 2))  # u_k, u_{k−1}, …
    sampled, reference = SampledPlant(plant, STEP), propagated(plant, mode, x, inputs)
    Phi, Gamma, lags = sampled.period(mode)
    moved = Phi @ x + sum(part @ inputs[lag] for part, lag in zip(Gamma, lags, strict=True))
    plants.close(moved, reference, 1e-12)
    for piece in sampled.pieces(mode):
        x = piece.Phi @ x + piece.Gamma @ acting_inputs(piece.stretch.lag, inputs)
    plants.close(x, reference, 1e-12)
    assert max(lags) == sampled.longest_lag == int(np.ceil(round(delay / STEP, 9)))


def test_a_delay_of_whole_periods_has_one_piece():
    (piece,) = SampledPlant(plants.generic(0.3), STEP).pieces(0)
    assert (piece.stretch.start, piece.stretch.stop) == (0.0, STEP)
    assert piece.stretch.lag.tolist() == [3, 3]


def test_its_arrays_are_read_only():
    sampled = SampledPlant(plants.generic(), STEP)
    for array in (*sampled.period(1)[:2], *sampled.pieces(1)[0][:2], sampled.pieces(1)[0][2].lag):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


# -- pieces along a signal ---------------------------------------------------------------------

SIGNAL = plants.off_grid()  # two switches in one period, one at a sample
PERIODS = 22


def along(delay, signal=SIGNAL):
    sampled = SampledPlant(plants.generic(delay), STEP)
    cuts = cuts_of(signal, sampled)
    return sampled, sampled.along(cuts, PERIODS), cuts


def run_through(table, x, inputs):
    """x at every sample, u_k = inputs[9 + k]."""
    states = [x]
    for k in range(PERIODS):
        for entry in table.entry[table.first[k] : table.first[k + 1]]:
            u = inputs[9 + k - table.lag[entry], [0, 1]]
            x = table.Phi[entry] @ x + table.Gamma[entry] @ u
        states.append(x)
    return np.array(states)


def integrated(plant, x, inputs, signal=SIGNAL):
    """x at every sample and ∫|x|² up to there, by an adaptive method between events."""
    samples = np.arange(PERIODS + 1) * STEP
    arrivals = np.arange(-9, PERIODS) * STEP + plant.delay
    events = np.unique(np.round(np.concatenate((samples, arrivals, signal.times)), 12))
    events = events[(events >= 0.0) & (events <= samples[-1])]
    states, z = [np.append(x, 0.0)], np.append(x, 0.0)
    for a, b in itertools.pairwise(events):
        middle = 0.5 * (a + b)
        A, B = (M[signal(middle)] for M in (plant.A, plant.B))
        u = inputs[9 + int(np.floor((middle - plant.delay) / STEP))]

        def slope(_, z, A=A, B=B, u=u):
            return np.append(A @ z[:3] + B @ u, z[:3] @ z[:3])

        z = solve_ivp(slope, (a, b), z, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
        if np.abs(samples - b).min() < 1e-9:
            states.append(z)
    return np.array(states)


@pytest.mark.parametrize("delay", [0.234, 0.3, 0.04])
def test_pieces_along_a_signal_are_the_plant_integrated(delay):
    sampled, table, cuts = along(delay)
    rng = np.random.default_rng(3)
    x, inputs = rng.normal(size=3), rng.normal(size=(9 + PERIODS, 2))
    reference = integrated(sampled.plant, x, inputs)
    plants.close(run_through(table, x, inputs), reference[:, :3], 1e-10)
    # The integral of |x|², entry by entry.
    plant = sampled.plant
    Q = gramians(plant.A, plant.B, table, cuts.offset, cuts.mode, plant.identity)
    total = 0.0
    for entry, sample in zip(table.entry, table.sample, strict=True):
        u = inputs[9 + sample, [0, 1]]
        z = np.append(x, u)
        total += z @ Q[entry] @ z
        x = table.Phi[entry] @ x + table.Gamma[entry] @ u
    assert total == pytest.approx(reference[-1, 3], rel=1e-10)


@pytest.mark.few(2)
@pytest.mark.parametrize("delay", [0.251, 0.3, 0.04])
@pytest.mark.parametrize("name", ["averaged, dwell-aware", "expected", "exact"])
def test_a_run_is_its_plant_integrated_under_the_inputs_that_were_sent(name, delay):
    model = plants.generic()
    plant = dt.SwitchedSystem(1.03 * model.A, 0.98 * model.B, delay)  # not what the law believes
    x0, u0 = np.array([1.0, -1.0, 0.5]), np.array([0.3, -0.2])
    run = dt.simulate(plant, plants.LAWS[name](model), SIGNAL, x0, PERIODS * STEP, STEP, u0)
    inputs = np.concatenate((np.tile(u0, (9, 1)), run.inputs.T))
    reference = integrated(plant, x0, inputs)
    plants.close(run.states.T, reference[:, :3], 1e-9)
    assert run.metrics()["ise"] == pytest.approx(reference[-1, 3], rel=1e-9)


def test_a_piece_begun_is_its_parts_up_to_there():
    sampled, table, cuts = along(0.234)
    A, B = sampled.plant.A, sampled.plant.B
    entry = int(np.argmax(np.diff(table.cut)))  # the one that is cut most
    parts = table.parts(entry, cuts)
    assert len(parts) > 1
    for end in (parts[0][2], 0.5 * (parts[1][1] + parts[1][2]), table.stop[entry]):
        Phi, Gamma = np.eye(3), np.zeros((3, 2))
        for mode, a, b in parts:
            if a < end:
                P, G = plants.held(A[mode], B[mode], min(b, end) - a)
                Phi, Gamma = P @ Phi, P @ Gamma + G
        found = up_to(A, B, table, cuts.offset, cuts.mode, entry, end)
        plants.close(found[0], Phi, 1e-13)
        plants.close(found[1], Gamma, 1e-13)
    plants.close(found[0], table.Phi[entry], 1e-15)


def test_pieces_end_where_the_acting_inputs_change_and_nowhere_else():
    _, table, _ = along(0.234)
    assert (np.diff(table.first) == 2).all()
    assert (np.diff(table.sample[:, 0]) == np.tile([1, 0], PERIODS)[: 2 * PERIODS - 1]).all()
    whole = table.entry[table.entry < 6]
    assert whole.size > 2 * PERIODS - 2 * SIGNAL.times.size
    assert (table.stop > table.start).all()


def test_pieces_between_few_switches_are_those_of_a_signal_with_many():
    """Those of few are kept, under what they were computed from: asked for again, in turn."""
    later = SIGNAL.times[-1] + PERIODS * STEP + 0.137 * np.arange(2 * FEW)
    modes = np.append(SIGNAL.modes, (SIGNAL.modes[-1] + 1 + np.arange(2 * FEW)) % 3)
    many = dt.SwitchingSignal(np.append(SIGNAL.times, later), modes)
    for delay in (0.234, 0.03, 0.234):
        few, whole = along(delay)[1], along(delay, many)[1]
        np.testing.assert_array_equal(few.Phi, whole.Phi)
        np.testing.assert_array_equal(few.Gamma, whole.Gamma)


def test_modes_may_have_stretches_of_their_own():
    """A plant that reads inputs of other ages in every mode: all that a reader sees is pieces."""
    sampled = SampledPlant(plants.generic(0.234), STEP)
    ages = {0: [(0.03, (3, 2)), (0.06, (2, 2)), (STEP, (2, 1))], 1: [(STEP, (2, 2))]}
    ages[2] = [(0.05, (3, 3)), (STEP, (2, 3))]
    start = [[0.0, *(stop for stop, _ in ages[i][:-1])] for i in range(3)]
    stretches = Stretches(
        np.array([0, 3, 4, 6]),
        np.concatenate(start),
        np.array([stop for i in range(3) for stop, _ in ages[i]]),
        np.array([lag for i in range(3) for _, lag in ages[i]]),
    )
    signal = dt.SwitchingSignal([0.0, 0.02, 0.145, 0.23, 0.26, 0.3], [0, 2, 1, 0, 1, 2])
    cuts = cuts_of(signal, sampled)
    A, B = sampled.plant.A, sampled.plant.B
    table = pieces_along(A, B, stretches, cuts.step, cuts.offset, cuts.mode, 4)
    rng = np.random.default_rng(6)
    x, inputs = rng.normal(size=3), rng.normal(size=(13, 2))
    reference, times = x, [0.0, *np.sort(np.r_[signal.times[1:], corners(ages, 4)]), 0.4]
    for a, b in itertools.pairwise(times):
        if b - a > 1e-12:
            middle = 0.5 * (a + b)
            mode, k = signal(middle), int(middle / STEP)
            lag = next(lag for stop, lag in ages[mode] if middle - k * STEP < stop)
            Phi, Gamma = plants.held(A[mode], B[mode], b - a)
            reference = Phi @ reference + Gamma @ inputs[9 + k - np.array(lag), [0, 1]]
    for entry, sample in zip(table.entry, table.sample, strict=True):
        x = table.Phi[entry] @ x + table.Gamma[entry] @ inputs[9 + sample, [0, 1]]
    plants.close(x, reference, 1e-13)


def corners(ages, periods):
    return [k * STEP + stop for k in range(periods) for mode in ages.values() for stop, _ in mode]
