"""The worst switching signal is that of closed forms, exhaustive searches and known limits."""

import itertools

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import minimize

import deadtime as dt
import plants
from deadtime.certificates.worst_case.cycles import mode_cycles
from deadtime.spectrum import lifted_loop
from shares import mostly_long
from worst_case_laws import QUICK, TURNING, H, drifting, free, measured


def averaged(plant, poles):
    return plant, dt.AveragedPredictor(plant, dt.place(plant, poles))


def near_paper(alpha):
    return averaged(dt.problems.paper().plant.apart(alpha), [-1.0, -2.0])


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


# -- closed forms ------------------------------------------------------------------------------


@pytest.mark.few(1)
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


@pytest.mark.few(1)
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


# -- a second method: exhaustive search with SciPy's exponential -------------------------------


def test_two_stable_modes_are_destabilised_by_the_worst_switching():
    worst = dt.falsify(*free(TURNING, delay=0.05), dwell_time=0.2, step=0.05, budget=QUICK)
    _, best = best_of_two(TURNING, 0.2, np.arange(0.2, 2.0, 0.1))
    assert worst.growth_rate <= best + 1e-9
    assert worst.growth_rate == pytest.approx(best, abs=1e-3)
    assert measured(worst) == pytest.approx(worst.growth_rate, abs=1e-7)
    assert worst.message.startswith("The loop grows at +0.868 /s when mode 0 for ")
    assert worst.signal.dwell_time >= 0.2


@pytest.mark.few(1)
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


@pytest.mark.parametrize("seed", mostly_long([1, 2], 2))
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
        for word in mode_cycles([(1, 2), (0, 2), (0, 1)], count):
            product = np.broadcast_to(np.eye(3), (len(index), 3, 3))
            for i, column in zip(word, index.T, strict=True):
                product = powers[i, column] @ product
            radius = np.abs(np.linalg.eigvals(product)).max(axis=1)
            best = max(best, (np.log(radius) / (lengths[index].sum(axis=1) * H)).max())
    assert worst.growth_rate >= best - 1e-9


@pytest.mark.parametrize(
    "name", mostly_long(["expected", "mean, dwell-aware", "delayed"], "mean, dwell-aware")
)
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


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("alpha", "step", "grows"),
    [(0.65, 0.1, False), (0.66, 0.1, True), (0.638, 0.01, False), (0.6395, 0.01, True)],
)
def test_the_paper_s_law_is_refuted_from_the_known_distance_on(alpha, step, grows):
    worst = dt.falsify(*near_paper(alpha), 0.2, step, budget=QUICK)
    assert (worst.growth_rate > 0.0) == grows
    assert worst.message.startswith(
        "The loop grows" if grows else "No admissible switching signal was found"
    )


@pytest.mark.few(1)
@pytest.mark.parametrize(("scale", "grows"), [(0.79, False), (0.806, True)])
def test_the_three_mode_plant_s_law_is_refuted_from_the_known_distance_on(scale, grows):
    plant, law = averaged(dt.problems.three_mode().plant.apart(scale), [-2.0, -3.0])
    worst = dt.falsify(plant, law, 0.9, budget=QUICK)
    assert (worst.growth_rate > 0.0) == grows
    assert worst.modes == (0,)


@pytest.mark.parametrize(
    ("law", "rate"), mostly_long([("averaged", 0.282), ("mean", 0.368)], ("mean", 0.368))
)
def test_nothing_is_worse_for_the_paper_s_laws_than_mode_1_for_ever(law, rate):
    plant = plants.paper()
    worst = dt.falsify(plant, plants.LAWS[law](plant), 0.2, budget=4 * QUICK)
    assert worst.modes == (1,)
    assert worst.growth_rate == pytest.approx(rate, abs=5e-4)
    assert worst.growth_rate == dt.growth_rate(plant, plants.LAWS[law](plant), 1)


def test_a_law_that_believes_in_slow_switching_is_destabilised_by_switching():
    plant = plants.paper()
    law = dt.ExpectedPredictor(plant, plants.gains(plant), dt.Markov([[0.0, 0.1], [0.1, 0.0]]))
    worst = dt.falsify(plant, law, 0.2, budget=4 * QUICK)
    assert max(dt.growth_rate(plant, law, mode) for mode in (0, 1)) < -0.6
    assert worst.growth_rate > 0.1
    assert measured(worst) == pytest.approx(worst.growth_rate, abs=1e-6)
    assert 0.0 < worst.cycle.offset < 0.1  # the law sees every switch a period late
