"""The worst switching signal: closed forms, exhaustive searches, known limits, and its own run."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import minimize

import deadtime as dt
import plants
import reference
from deadtime.certificates.worst_case.cycles import Cycle, Dwell, mode_cycles
from deadtime.certificates.worst_case.kinds import Kinds
from deadtime.certificates.worst_case.loop import SampledLoop
from deadtime.certificates.worst_case.products import compress
from deadtime.certificates.worst_case.witness import repeat
from deadtime.spectrum import lifted_loop

H = 0.1
QUICK = 4000  # budget


def drifting():
    """A loop that only a signal between dwell time and clock destabilises: see below."""
    A = [[[-9.7, 15.8], [-17.39, -2.6]], [[-10.55, -11.29], [-13.6, -23.77]]]
    B = [[[8.22], [12.58]], [[-3.68], [-8.8]]]
    plant = dt.SwitchedSystem(A, B, delay=H)
    return plant, dt.DelayedStateFeedback(plant, [[[-0.42, 0.24]], [[1.689, -1.205]]])


def free(A, delay=0.1, m=1):
    """A plant left to itself: the law's gains are 0."""
    A = np.asarray(A, dtype=float)
    B = np.ones((*A.shape[:2], m))
    plant = dt.SwitchedSystem(A, B, delay)
    gains = np.zeros((A.shape[0], m, A.shape[1]))
    return plant, dt.DelayedStateFeedback(plant, gains, allow_unstable=True)


def averaged(plant, poles):
    return plant, dt.AveragedPredictor(plant, dt.place(plant, poles))


def near_paper(alpha):
    return averaged(dt.problems.paper().plant.apart(alpha), [-1.0, -2.0])


def measured(worst, cycles=6):
    """The growth rate in the run itself: the lifted state at cycle ends obeys z″ = p z′ + q z."""
    run = worst.simulate(cycles)
    assert not run.diverged
    period = worst.cycle.periods
    inputs, W = np.hstack((worst.u0, run.inputs)), worst.u0.shape[1]
    z = [np.append(run.states[:, k], inputs[:, k : k + W]) for k in range(0, run.time.size, period)]
    assert len(z) == cycles + 1
    scale = [np.linalg.norm(z[c]) for c in range(cycles - 1)]
    before = np.concatenate([z[c] / s for c, s in enumerate(scale)])
    now = np.concatenate([z[c + 1] / s for c, s in enumerate(scale)])
    after = np.concatenate([z[c + 2] / s for c, s in enumerate(scale)])
    p, q = np.linalg.lstsq(np.column_stack((now, before)), after, rcond=1e-9)[0]
    assert np.linalg.norm(p * now + q * before - after) < 1e-6 * np.linalg.norm(after)
    return np.log(np.abs(np.roots([1.0, -p, -q])).max()) / worst.length


# -- closed forms ------------------------------------------------------------------------------


def rotated(diagonal, seed):
    """A normal matrix with these real eigenvalues."""
    Q = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return Q @ np.diag(diagonal) @ Q.T


def commuting():
    V = np.random.default_rng(3).normal(size=(3, 3))
    return [V @ np.diag(d) @ np.linalg.inv(V) for d in ([-0.4, -1, -2], [-3, -0.6, -0.5])]


RATES = [[-0.3, -0.9, -0.5], [-0.2, -0.7, -1.1], [-1.0, -0.4, -0.6]]
KNOWN = {
    "commuting": commuting(),
    "upper triangular": [np.diag(d) + np.triu(np.full((3, 3), 0.9), 1) for d in RATES],
    "normal": [rotated(d, i) for i, d in enumerate(RATES)],
}


@pytest.mark.parametrize("name", KNOWN)
def test_a_constant_signal_is_worst_where_theory_says_so(name):
    plant, law = free(KNOWN[name])
    rates = [np.linalg.eigvals(A).real.max() for A in plant.A]
    worst = dt.falsify(plant, law, dwell_time=0.3, step=H, budget=QUICK)
    assert worst.growth_rate == pytest.approx(max(rates), abs=1e-9)
    assert worst.modes == (int(np.argmax(rates)),)
    assert worst.sojourns == (np.inf,)
    assert worst.signal.switches == 0
    assert measured(worst) == pytest.approx(max(rates), abs=1e-6)


@pytest.mark.parametrize(
    ("least", "most", "step"), [(0.3, 0.7, 0.1), (0.33, 0.47, 0.1), (0.25, 0.25, 0.1)]
)
def test_with_a_maximum_dwell_a_scalar_plant_grows_at_the_mean_of_its_modes(least, most, step):
    plant, law = free([[[0.5]], [[-1.0]], [[-0.4]]])
    worst = dt.falsify(
        plant, law, least, step, maximum_dwell=most, clock_tolerance=0.0, budget=QUICK
    )
    known = (0.5 * most - 0.4 * least) / (most + least)
    assert worst.growth_rate == pytest.approx(known, abs=1e-6)
    assert set(worst.modes) == {0, 2}
    assert measured(worst) == pytest.approx(known, abs=1e-6)


def test_a_plant_of_one_mode_has_constant_signals_only():
    plant, law = free([[[-0.7]]])
    for most in (None, 0.5):
        worst = dt.falsify(plant, law, 0.3, H, maximum_dwell=most)
        assert worst.modes == (0,)
        assert worst.growth_rate == pytest.approx(-0.7, abs=1e-9)
        assert "decays at 0.7 /s" in worst.message


# -- a second method: exhaustive search with SciPy's exponential -------------------------------

TURNING = [[[-0.1, 1.0], [-4.0, -0.1]], [[-0.1, 4.0], [-1.0, -0.1]]]  # both stable


def rate_of(A, modes, sojourns):
    product = np.eye(len(A[0]))
    for i, s in zip(modes, sojourns, strict=True):
        product = expm(np.array(A[i]) * s) @ product
    return np.log(np.abs(np.linalg.eigvals(product)).max()) / sum(sojourns)


def best_of_two(A, least, grid):
    """The largest rate of cycles of two sojourns: on a grid, and anywhere."""
    on = max(itertools.product(grid, repeat=2), key=lambda s: rate_of(A, (0, 1), s))
    found = minimize(
        lambda s: -rate_of(A, (0, 1), np.maximum(s, least)), on, method="Nelder-Mead",
        options={"xatol": 1e-6, "fatol": 1e-9},
    )  # fmt: skip
    return rate_of(A, (0, 1), on), -found.fun


def test_two_stable_modes_are_destabilised_by_the_worst_switching():
    worst = dt.falsify(*free(TURNING, delay=0.05), dwell_time=0.2, step=0.05, budget=QUICK)
    _, best = best_of_two(TURNING, 0.2, np.arange(0.2, 2.0, 0.1))
    assert worst.growth_rate <= best + 1e-9
    assert worst.growth_rate == pytest.approx(best, abs=1e-3)
    assert measured(worst) == pytest.approx(worst.growth_rate, abs=1e-7)
    assert worst.message.startswith("The loop grows at +0.868 /s when mode 0 for ")
    assert worst.signal.dwell_time >= 0.2


@pytest.mark.parametrize("dwell", [0.62, 0.7])
def test_switches_off_the_grid_are_found_where_they_are_worse(dwell):
    step = 0.5
    worst = dt.falsify(*free(TURNING, delay=0.3), dwell, step, budget=QUICK)
    on_grid, best = best_of_two(TURNING, dwell, np.arange(2, 12) * step)
    assert worst.growth_rate > on_grid + 0.1
    assert worst.growth_rate == pytest.approx(best, abs=2e-3)
    assert worst.signal.dwell_time >= dwell
    assert measured(worst) == pytest.approx(worst.growth_rate, abs=1e-7)


def test_the_signal_can_be_built_again_from_modes_sojourns_and_phase():
    worst = dt.falsify(*drifting(), 0.2, H, budget=QUICK)
    assert 0.0 < worst.phase < H
    assert f"beginning {worst.phase:.3g} s after a sample" in worst.message
    count = len(worst.signal.modes) // len(worst.modes)
    begins = worst.phase + np.concatenate(([0.0], np.cumsum(worst.sojourns * count)))[:-1]
    times, modes = np.append(0.0, begins), np.append(worst.modes[-1], worst.modes * count)
    again = dt.SwitchingSignal(times, modes)
    run = worst.simulate(cycles=4)
    other = dt.simulate(worst.plant, worst.law, again, worst.x0, run.time[-1], worst.step, worst.u0)
    np.testing.assert_allclose(other.states, run.states, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("seed", [1, 2])
def test_no_cycle_of_up_to_four_sojourns_on_the_grid_is_worse(seed):
    rng = np.random.default_rng(seed)
    A = 2.0 * rng.normal(size=(3, 3, 3))
    A -= np.array([np.linalg.eigvals(a).real.max() + 0.3 for a in A])[:, None, None] * np.eye(3)
    worst = dt.falsify(*free(A), dwell_time=0.3, step=H)
    lengths = np.array([3, 4, 5, 6, 8, 10, 13])
    powers = np.array([[expm(a * k * H) for k in lengths] for a in A])
    best = -np.inf
    for count in (2, 3, 4):
        index = np.array(list(itertools.product(range(lengths.size), repeat=count)))
        for word in mode_cycles(3, count):
            product = np.broadcast_to(np.eye(3), (len(index), 3, 3))
            for i, column in zip(word, index.T, strict=True):
                product = powers[i, column] @ product
            radius = np.abs(np.linalg.eigvals(product)).max(axis=1)
            best = max(best, (np.log(radius) / (lengths[index].sum(axis=1) * H)).max())
    assert worst.growth_rate >= best - 1e-9


@pytest.mark.parametrize("name", ["expected", "mean, dwell-aware", "delayed"])
def test_no_pair_of_modes_and_sojourns_on_the_grid_is_worse_for_a_law(name):
    plant = plants.generic()
    law = plants.LAWS[name](plant)
    worst = dt.falsify(plant, law, dwell_time=0.2, step=H, budget=QUICK)
    table = law.digital(H)

    def sojourn(mode, count):
        product = np.eye(plant.states + plant.inputs * table.taps)
        for row in table.rows(np.full(count, mode)):
            product = lifted_loop(plant, table, mode, int(row)) @ product
        return product

    powers = {(i, k): sojourn(i, k) for i in range(3) for k in range(2, 16)}
    best = max(
        np.log(np.abs(np.linalg.eigvals(powers[b] @ powers[a])).max()) / ((a[1] + b[1]) * H)
        for a, b in itertools.combinations(powers, 2)
        if a[0] != b[0]
    )
    assert worst.growth_rate >= best - 1e-9


# -- known limits ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("alpha", "step", "grows"),
    [(0.65, 0.1, False), (0.66, 0.1, True), (0.638, 0.01, False), (0.6395, 0.01, True)],
)
def test_the_paper_s_law_is_refuted_from_the_known_distance_on(alpha, step, grows):
    worst = dt.falsify(*near_paper(alpha), 0.2, step, budget=QUICK)
    assert (worst.growth_rate > 0.0) == grows
    assert worst.message.startswith("The loop grows" if grows else "No admissible signal was found")


@pytest.mark.parametrize(("scale", "grows"), [(0.79, False), (0.806, True)])
def test_the_three_mode_plant_s_law_is_refuted_from_the_known_distance_on(scale, grows):
    plant, law = averaged(dt.problems.three_mode().plant.apart(scale), [-2.0, -3.0])
    worst = dt.falsify(plant, law, 0.9, budget=QUICK)
    assert (worst.growth_rate > 0.0) == grows
    assert worst.modes == (0,)


@pytest.mark.parametrize(("law", "rate"), [("averaged", 0.282), ("mean", 0.368)])
def test_nothing_is_worse_for_the_paper_s_laws_than_mode_1_for_ever(law, rate):
    plant = plants.paper()
    worst = dt.falsify(plant, plants.LAWS[law](plant), 0.2, budget=4 * QUICK)
    assert worst.modes == (1,)
    assert worst.growth_rate == pytest.approx(rate, abs=5e-4)
    assert worst.growth_rate == dt.growth_rate(plant, plants.LAWS[law](plant), 1)


def test_a_law_that_believes_in_slow_switching_is_destabilised_by_switching():
    plant = plants.paper()
    law = dt.ExpectedPredictor(plant, plants.gains(plant), dt.Markov([[0.0, 0.1], [0.1, 0.0]]))
    worst = dt.falsify(plant, law, 0.2)
    assert max(dt.growth_rate(plant, law, mode) for mode in (0, 1)) < -0.6
    assert worst.growth_rate > 0.1
    assert measured(worst) == pytest.approx(worst.growth_rate, abs=1e-6)
    assert 0.0 < worst.cycle.offset < 0.1  # the law sees every switch a period late


# -- switches that are seen late ---------------------------------------------------------------


def test_a_mode_that_begins_after_a_sample_may_end_at_one_as_clocks_drift():
    plant, law = drifting()
    worst = dt.falsify(plant, law, 2.0 * H, H)
    assert worst.proven
    assert worst.growth_rate == pytest.approx(0.364, abs=1e-3)
    assert measured(worst) == pytest.approx(worst.growth_rate, abs=1e-6)
    assert min(worst.sojourns) < 2.0 * H
    assert worst.signal.dwell_time >= 2.0 * H * (1.0 - 1e-5)
    assert "mode 0 for 0.199999 s" in worst.message  # not rounded to the dwell time
    assert 1e-9 < worst.phase / H < 1e-3  # more than what counts as at the sample


@pytest.mark.parametrize("tolerance", [1e-6, 1e-4, 0.01])
def test_any_tolerance_of_the_clock_lets_it_grow(tolerance):
    worst = dt.falsify(*drifting(), 2.0 * H, H, clock_tolerance=tolerance)
    assert worst.growth_rate > 0.36
    assert worst.signal.dwell_time >= 2.0 * H * (1.0 - tolerance)


def test_without_a_tolerance_it_decays():
    worst = dt.falsify(*drifting(), 2.0 * H, H, clock_tolerance=0.0)
    assert worst.growth_rate == pytest.approx(-0.352, abs=2e-3)
    assert worst.signal.dwell_time >= 2.0 * H


@pytest.mark.parametrize("name", ["delayed", "expected", "mean, dwell-aware"])
def test_no_cycle_of_two_is_worse_whatever_is_seen_late(name):
    plant = plants.generic()
    law = plants.LAWS[name](plant)
    worst = dt.falsify(plant, law, 2.0 * H, H)
    late, loop = 5e-6, SampledLoop.of(plant, law.digital(H), 0.0)
    best = max(
        loop.growth(Cycle.on_grid([(i, a, s), (j, b, e)], late)).rate
        for i, j in itertools.combinations(range(3), 2)
        for a, b in itertools.product(range(2, 12), repeat=2)
        for s, e in itertools.product((False, True), repeat=2)
    )
    assert worst.growth_rate >= best - 1e-4


# -- the witness -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [name for name in plants.LAWS if name != "exact"])
def test_every_witness_is_admissible_and_grows_as_it_says(name):
    plant = plants.generic()
    law = plants.LAWS[name](plant)
    worst = dt.falsify(plant, law, dwell_time=0.25, step=H, budget=QUICK)
    assert worst.signal.dwell_time >= 0.25 * (1.0 - 1e-5)
    assert min(worst.sojourns) >= 0.25 * (1.0 - 1e-5)
    assert worst.growth_rate >= max(dt.growth_rate(plant, law, i, H) for i in range(3)) - 1e-12
    assert measured(worst) == pytest.approx(worst.growth_rate, abs=2e-6)
    assert worst.u0.shape == (2, law.digital(H).taps)


@pytest.mark.parametrize("name", ["averaged", "delayed", "averaged, dwell-aware"])
def test_the_witness_grows_in_an_independent_simulation_of_another_plant(name):
    delay, model_delay, dwell = Fraction(31, 100), Fraction(234, 1000), Fraction(1634, 10000)
    model = plants.generic(float(model_delay))
    plant = plants.generic(float(delay), seed=5)
    plant = dt.SwitchedSystem(0.5 * (model.A + plant.A), model.B, float(delay))
    law = plants.LAWS[name](model)
    worst = dt.falsify(plant, law, 0.17, H, maximum_dwell=0.63, budget=QUICK)
    assert len(worst.modes) > 1
    signal = repeat(worst.cycle, 2, 0.17, H)
    near = [round(t / H) for t in signal.times]  # within 1e-9 periods of a sample is at it
    cuts = [
        Fraction(k, 10) if abs(t / H - k) < 1e-9 else Fraction(t)
        for k, t in zip(near, signal.times, strict=True)
    ]
    true = reference.Model(plant.A, plant.B, delay)
    believed = reference.Model(model.A, model.B, model_delay)
    K, third = law.gains, np.full(3, 1.0 / 3.0)
    age = int(signal.initial_age / H + 1e-9)
    control = {
        "averaged": lambda: reference.averaged(believed, K, third),
        "delayed": lambda: reference.delayed(believed, K),
        "averaged, dwell-aware": lambda: reference.dwelling(believed, believed, K / 3, dwell, age),
    }[name]()
    loop = reference.Loop(
        true, reference.Signal(cuts, signal.modes.tolist()), Fraction(1, 10), worst.u0.T
    )
    samples = worst.cycle.periods + 1
    states, inputs, _ = loop.run(control, worst.x0, samples)
    run = worst.simulate(2)
    plants.close(run.states[:, :samples].T, states.astype(float), 1e-6)
    plants.close(run.inputs[:, :samples].T, inputs.astype(float), 1e-6)
    assert measured(worst) == pytest.approx(worst.growth_rate, abs=2e-6)


def test_a_dwell_time_is_kept_to_the_last_digit():
    for dwell in (0.3, 0.7 / 3.0, 0.41):
        r = Dwell.of(dwell, None, H).least
        for offset in (0.0, 0.3, 0.999):
            gaps = (r, r, np.ceil(4 * r) - 2 * r)
            signal = repeat(Cycle((0, 1, 2), gaps, offset), 200, dwell, H)
            assert dwell <= signal.dwell_time <= dwell * (1.0 + 1e-12)


# -- relations ---------------------------------------------------------------------------------


def test_the_same_search_finds_the_same_signal():
    plant = plants.generic()
    law = plants.LAWS["expected"](plant)
    runs = [dt.falsify(plant, law, 0.4, H, budget=QUICK) for _ in range(2)]
    assert runs[0].growth_rate == runs[1].growth_rate
    assert runs[0].sojourns == runs[1].sojourns


def test_another_unit_of_time_changes_the_rate_alone():
    plant = plants.generic()
    c = 4.0
    slow, law = plants.in_other_units("delayed", np.eye(3), c)
    worst = dt.falsify(plant, plants.LAWS["delayed"](plant), 0.2, H, budget=QUICK)
    other = dt.falsify(slow, law, c * 0.2, c * H, budget=QUICK)
    assert c * other.growth_rate == pytest.approx(worst.growth_rate, rel=1e-9)
    assert np.array(other.sojourns) == pytest.approx(c * np.array(worst.sojourns))


def test_identical_modes_leave_nothing_to_switch():
    plant = plants.identical()
    worst = dt.falsify(plant, plants.LAWS["averaged"](plant), 0.3, H, budget=QUICK)
    assert len(worst.modes) == 1
    assert worst.upper_estimate == pytest.approx(worst.growth_rate, abs=0.1)


def test_a_longer_dwell_time_never_makes_it_worse():
    rates = [
        dt.falsify(*free(TURNING), tau, H, budget=QUICK).growth_rate for tau in (0.2, 0.7, 1.4)
    ]
    assert np.all(np.diff(rates) < 1e-9)
    assert rates[0] > 0.8
    assert rates[-1] < rates[1]


def test_a_loop_that_explodes_has_a_finite_rate():
    plant = plants.scalar([60.0, 50.0], delay=1.0)
    law = dt.DelayedStateFeedback(plant, [[[-61.0]], [[-51.0]]])
    worst = dt.falsify(plant, law, 0.2, 0.05, budget=QUICK)
    assert worst.growth_rate == pytest.approx(60.0, abs=1e-6)
    assert worst.simulate().diverged


# -- the parts ---------------------------------------------------------------------------------


def _kind(kinds, mode, late):
    return np.flatnonzero((kinds.mode == mode) & (kinds.late == late))[0]


@pytest.mark.parametrize("name", ["averaged", "expected", "mean, dwell-aware"])
def test_a_functional_carried_back_reads_the_state_that_is_carried_on(name):
    plant = plants.generic()
    loop = SampledLoop.of(plant, plants.LAWS[name](plant).digital(H), 0.7)
    rng = np.random.default_rng(0)
    z, y = rng.normal(size=(2, loop.order))
    table = loop.table(Cycle((0, 1, 2), (2.3, 4.0, 2.7), 0.4))
    assert y @ loop.after(table, 1, z) == pytest.approx(loop.before(table, y) @ z, rel=1e-12)


def test_the_compressed_loop_ranks_cycles_as_the_loop_does_whatever_is_late():
    plant = plants.paper()
    law = dt.ExpectedPredictor(plant, plants.gains(plant), plants.markov(2))
    loop = SampledLoop.of(plant, law.digital(0.02), 0.0)
    lengths = np.arange(10, 120)
    kinds = Kinds.of(loop.feedback, 2, mixed=True)
    sojourns = compress(loop, lengths, kinds)
    assert sojourns.matrix.shape[2] < loop.order / 3
    rng = np.random.default_rng(1)
    for count in (2, 4, 6):
        for late in itertools.product((False, True), repeat=count):
            modes, index = np.arange(count) % 2, rng.integers(lengths.size, size=count)
            word = np.array([_kind(kinds, i, after) for i, after in zip(modes, late, strict=True)])
            sojourns_in_turn = zip(modes.tolist(), lengths[index].tolist(), late, strict=True)
            cycle = Cycle.on_grid(list(sojourns_in_turn), 1e-7)
            rate = sojourns.rates(word, index[None])[0] / 0.02
            off = 3e-3 if len(set(late)) == 1 else 2e-2
            assert rate == pytest.approx(loop.growth(cycle).rate, abs=off)


# -- what is refused ---------------------------------------------------------------------------


def ruled():
    plant = plants.paper()
    return dt.StateDependentPredictor(plant, plants.gains(plant), dt.HalfSpace([1.0, 0.0]))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"plant": plants.paper()}, "law must be made for a plant with 2 modes"),
        ({"law": plants.LAWS["exact"](plants.generic())}, "law must be a table .* ExactPredictor"),
        ({"law": ruled(), "plant": plants.paper()}, "law must be a table .* StateDependent"),
        ({"dwell_time": 0.0}, "dwell_time must be positive"),
        ({"dwell_time": 0.05}, "dwell_time must be at least one period, got 0.05 s .* shorten"),
        ({"step": -0.1}, "step must be positive"),
        ({"maximum_dwell": 0.1}, "maximum_dwell must be at least dwell_time = 0.2 s"),
        (
            {"dwell_time": 0.1 * 5**0.5, "maximum_dwell": 0.1 * 5**0.5},
            "maximum_dwell leaves no cycle of a whole number of periods",
        ),
        ({"clock_tolerance": -1e-9}, "clock_tolerance must be a part from 0 to 0.1, got -1e-09"),
        (
            {"clock_tolerance": 0.2},
            "clock_tolerance must be a part from 0 to 0.1, .* how much the clock",
        ),
        ({"clock_tolerance": "much"}, "clock_tolerance must be a"),
        ({"budget": 0}, "budget must be an integer of at least 1"),
    ],
)
def test_what_cannot_be_searched_is_refused_by_name(changes, message):
    plant = plants.generic()
    arguments = {"plant": plant, "law": plants.LAWS["mean"](plant), "dwell_time": 0.2, "step": H}
    with pytest.raises(dt.ArgumentError, match=message):
        dt.falsify(**(arguments | changes))
