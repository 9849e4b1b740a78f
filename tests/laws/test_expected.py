"""The expected law: against enumeration of all futures, a jump chain, and its limits."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
from scipy import stats

import deadtime as dt
import plants
import reference
from deadtime.switching.models.model import require_model
from reference import LONG
from shares import mostly_long

H = 0.1
PLANT = plants.generic()
RATES = np.array([[0.0, 1.3, 0.4], [2.0, 0.0, 0.7], [0.3, 3.1, 0.0]])
TRANSITION = np.array([[0.0, 0.8, 0.2], [0.5, 0.0, 0.5], [1.0, 0.0, 0.0]])
SOJOURNS = (stats.gamma(2.3, scale=0.2), stats.uniform(0.15, 0.4), stats.expon(0.25, 0.3))
# D = 3 h + φ with φ = h and with φ = 0.034.
DELAYS = [Fraction(4, 10), Fraction(334, 1000)]


def expected(plant, model, **options):
    return dt.ExpectedPredictor(plant, plants.gains(plant), model, **options)


def value(feedback, row, x, history):
    """F x + Σ G_j u_{k−j}, and the sum of the magnitudes of its terms."""
    F, G, past = feedback.state_gain[row], feedback.input_gain[row], history[::-1]
    terms = [np.abs(F) @ np.abs(x), *(np.abs(g) @ np.abs(u) for g, u in zip(G, past, strict=True))]
    return F @ x + sum(g @ u for g, u in zip(G, past, strict=True)), float(np.max(sum(terms)))


def numbers(plant, delay, seed=0):
    rng = np.random.default_rng(seed)
    count = -(-delay // Fraction(1, 10))
    return rng.normal(size=plant.states), rng.normal(size=(count, plant.inputs))


# -- a second method ---------------------------------------------------------------------------


def futures(mode, age, samples):
    """Every sequence of sampled modes, (probability, modes), of a semi-Markov process."""
    paths = [(1.0, [mode], age)]
    for _ in range(samples):
        following = []
        for probability, modes, a in paths:
            i = modes[-1]
            survived = 1.0 - SOJOURNS[i].cdf(a * H)
            leaves = (SOJOURNS[i].cdf((a + 1) * H) - SOJOURNS[i].cdf(a * H)) / survived
            if leaves < 1.0:
                following.append((probability * (1.0 - leaves), [*modes, i], a + 1))
            following += [
                (probability * leaves * TRANSITION[i, j], [*modes, j], 0)
                for j in range(3)
                if leaves * TRANSITION[i, j] > 0.0
            ]
        paths = following
    return [(probability, modes) for probability, modes, _ in paths]


@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize(("mode", "age"), [(0, 0), (0, 5), (1, 1), (1, 4), (2, 0), (2, 3)])
def test_a_semi_markov_table_is_the_mean_of_the_exact_predictor_over_all_futures(delay, mode, age):
    plant, step = plants.generic(float(delay)), Fraction(1, 10)
    x, history = numbers(plant, delay)
    model = dt.SemiMarkov(SOJOURNS, TRANSITION)
    feedback = expected(plant, model).digital(H)
    K, exact_model = plants.gains(plant), reference.Model(plant.A, plant.B, delay)
    u = np.zeros(2, LONG)
    # The sample at t_k + D counts, so with φ = h there is one more.
    for probability, modes in futures(mode, age, int(delay // step)):
        signal = reference.Signal([q * step for q in range(len(modes))], modes)
        loop = reference.Loop(exact_model, signal, step, history)
        u += LONG(probability) * (K[modes[-1]] @ sum(loop.predict(exact_model, signal, 0, x)))
    ours, scale = value(feedback, mode * feedback.ages + age, x, history)
    assert np.abs(ours - u).max() <= 1e-12 * scale


def jump_chain(plant, delay, mode, x, history, pieces):
    """E[K_σ(D) x(D)] of a chain that may jump after each of `pieces` parts of every period."""
    A, B = plant.A.astype(LONG), plant.B.astype(LONG)
    rates = RATES.astype(LONG) - np.diag(RATES.sum(axis=1)).astype(LONG)
    states, p = np.zeros((3, 3), LONG), np.zeros(3, LONG)
    states[mode], p[mode] = x, 1.0
    count = len(history)
    lengths = [delay - (count - 1) * Fraction(1, 10), *[Fraction(1, 10)] * (count - 1)]
    for length, u in zip(lengths, history.astype(LONG), strict=True):
        part = length / pieces
        span = LONG(part.numerator) / LONG(part.denominator)
        for _ in range(pieces):
            states = np.array(
                [reference.flow(A[i], B[i] @ u * p[i], states[i], part) for i in range(3)]
            )
            states, p = states + span * rates.T @ states, p + span * rates.T @ p
    return sum(plants.gains(plant)[i] @ states[i] for i in range(3))


@pytest.mark.parametrize(
    ("delay", "mode"),
    mostly_long(itertools.product(DELAYS, range(3)), (DELAYS[0], 0), (DELAYS[1], 2)),
)
def test_a_markov_table_is_the_limit_of_a_jump_chain(delay, mode):
    plant = plants.generic(float(delay))
    x, history = numbers(plant, delay, seed=mode)
    table = [jump_chain(plant, delay, mode, x, history, 2**k) for k in range(1, 8)]
    for order in range(1, 7):  # Richardson: the error is a power series in the chain's period
        table = [
            (2**order * fine - coarse) / (2**order - 1)
            for coarse, fine in itertools.pairwise(table)
        ]
    feedback = expected(plant, dt.Markov(RATES)).digital(H)
    ours, scale = value(feedback, mode, x, history)
    assert np.abs(ours - table[0]).max() <= 1e-8 * scale


@pytest.mark.parametrize("delay", [0.234, 0.4, 0.1001, 1.25])
def test_the_factor_of_a_markov_table_gives_its_rows(delay):
    feedback = expected(plants.generic(delay), dt.Markov(RATES)).digital(H)
    assert feedback.factor is not None
    plants.close(feedback.factor.taps(feedback.taps), feedback.input_gain, 1e-12)


def test_the_ideal_markov_law_is_the_limit_of_the_digital_one():
    # Switches and the delay on every grid: the digital loop is a power series in the period.
    plant = plants.generic(0.4)
    signal = dt.SwitchingSignal([0.0, 0.3, 0.7, 1.1], [0, 2, 1, 0])
    law, x0, times = expected(plant, dt.Markov(RATES)), [1.0, -0.5, 0.8], np.arange(16) * 0.1
    runs = [
        dt.simulate(plant, law, signal, x0, 1.5, H / 2**k, times=times).states for k in range(2, 9)
    ]
    for order in range(1, 7):
        runs = [
            (2**order * fine - coarse) / (2**order - 1) for coarse, fine in itertools.pairwise(runs)
        ]
    ideal = dt.simulate(plant, law, signal, x0, 1.5, step=None, times=times).states
    plants.close(runs[0], ideal, 1e-9)


def test_a_defective_generator_is_factored_too():
    # A chain 0 → 1 → 2 with equal rates has no basis of eigenvectors.
    model = dt.Markov([[0, 2.0, 0], [0, 0, 2.0], [0, 0, 0]])
    feedback = expected(PLANT, model).digital(H)
    assert feedback.factor is not None
    plants.close(feedback.factor.taps(feedback.taps), feedback.input_gain, 1e-12)


def test_a_factor_that_would_lose_digits_is_not_given():
    plant = plants.paper()
    slow, fast = (expected(plant, dt.Markov([[0, r], [r, 0]])).digital(0.01) for r in (1.0, 50.0))
    assert slow.factor is not None
    assert fast.factor is None


# -- fixed sojourns in a known order -----------------------------------------------------------


def in_order(sojourns):
    """The model that knows all: fixed sojourns, 0 → 1 → 2 → 0."""
    return dt.SemiMarkov(sojourns, np.roll(np.eye(3), 1, axis=1))


@pytest.mark.parametrize("delay", [0.2, 0.234, 0.7])
def test_fixed_sojourns_on_the_grid_in_a_known_order_give_the_oracle(delay):
    plant, sojourns = plants.generic(delay), [0.3, 0.2, 0.7]
    signal = dt.SwitchingSignal.periodic(sojourns, [0, 1, 2], 6.0)
    runs = [
        dt.simulate(plant, law, signal, [1.0, -0.5, 0.8], 3.0, H)
        for law in (
            expected(plant, in_order(sojourns)),
            dt.ExactPredictor(plant, plants.gains(plant)),
        )
    ]
    plants.close(runs[0].states, runs[1].states, 1e-10)
    plants.close(runs[0].inputs, runs[1].inputs, 1e-10)


def test_fixed_sojourns_off_the_grid_miss_the_oracle_by_order_one():
    plant = plants.generic(0.4)
    sojourns = [0.3 * np.sqrt(1.1), 0.2 * np.sqrt(1.3), 0.5 * np.sqrt(0.9)]
    signal = dt.SwitchingSignal.periodic(sojourns, [0, 1, 2], 6.0)
    steps, errors = [0.02 / 2**k for k in range(5)], []
    for step in steps:
        runs = [
            dt.simulate(plant, law, signal, [1.0, -0.5, 0.8], 2.0, step)
            for law in (
                expected(plant, in_order(sojourns)),
                dt.ExactPredictor(plant, plants.gains(plant)),
            )
        ]
        gap = (runs[0].states - runs[1].states)[:, :: round(0.02 / step)]
        errors.append(np.sqrt(np.mean(gap**2)))
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert 0.8 <= slope <= 1.3


# -- limits ------------------------------------------------------------------------------------


def distance(one, other, row=0):
    """Largest difference of two tables' rows, relative to the other's."""
    return max(
        np.abs(getattr(one, name)[row] - getattr(other, name)[0]).max()
        / np.abs(getattr(other, name)).max()
        for name in ("state_gain", "input_gain")
    )


def test_fast_symmetric_switching_tends_to_the_mean_law_with_slope_minus_one():
    plant = plants.generic(0.334)
    K = plants.gains(plant)
    mean = dt.MeanPredictor(plant, K.mean(axis=0), allow_unstable=True).digital(H)
    rates, errors = 10.0 ** np.arange(2, 6), []
    for rate in rates:
        feedback = expected(plant, dt.Markov(rate * (1 - np.eye(3)))).digital(H)
        errors.append(max(distance(feedback, mean, row) for row in range(3)))
    slopes = np.diff(np.log10(errors))
    assert np.abs(slopes + 1.0).max() <= 0.05


@pytest.mark.parametrize("delay", [0.4, 0.334])
def test_a_rate_of_zero_is_the_law_of_the_current_mode(delay):
    plant = plants.generic(delay)
    still = expected(plant, dt.Markov(np.zeros((3, 3)))).digital(H)
    never = expected(plant, dt.SemiMarkov([1e3, 1e3, 1e3]), ages=4).digital(H)
    for mode in range(3):
        single = dt.SingleModePredictor(plant, plants.gains(plant), mode).digital(H)
        assert distance(still, single, mode) <= 1e-13
        assert distance(never, single, mode * never.ages) <= 1e-13


def test_exponential_sojourns_tend_to_the_markov_table_with_order_one():
    plant, rates = plants.generic(0.4), np.array([1.0, 2.0, 0.5])
    markov = dt.Markov(rates[:, None] * TRANSITION)
    semi = dt.SemiMarkov([stats.expon(scale=1.0 / r) for r in rates], TRANSITION)
    steps, errors = [0.04, 0.02, 0.01, 0.005], []
    for step in steps:
        exact, rounded = expected(plant, markov).digital(step), expected(plant, semi).digital(step)
        assert rounded.ages == 1
        errors.append(np.abs(rounded.state_gain - exact.state_gain).max())
    assert abs(np.polyfit(np.log(steps), np.log(errors), 1)[0] - 1.0) <= 0.1


@pytest.mark.parametrize("model", [dt.Markov(RATES), dt.SemiMarkov(SOJOURNS, TRANSITION)])
@pytest.mark.parametrize("delay", [0.4, 0.334, 0.07])
def test_identical_modes_make_the_forecast_irrelevant(model, delay):
    plant = plants.identical(delay)
    single = dt.SingleModePredictor(plant, plants.gains(plant), 0).digital(H)
    feedback = expected(plant, model).digital(H)
    for row in range(feedback.state_gain.shape[0]):
        assert distance(feedback, single, row) <= 1e-13


def test_ages_past_the_table_use_its_last_row():
    plant, model = plants.generic(0.4), dt.SemiMarkov(SOJOURNS, TRANSITION)
    whole, few = expected(plant, model).digital(H), expected(plant, model, ages=3).digital(H)
    assert (few.context, few.ages) == ("mode_age", 3)
    for mode in range(3):
        for age in range(3):
            rows = mode * few.ages + age, mode * whole.ages + age
            assert np.array_equal(few.state_gain[rows[0]], whole.state_gain[rows[1]])
            assert np.array_equal(few.input_gain[rows[0]], whole.input_gain[rows[1]])


def test_no_sojourn_is_so_long_that_a_certain_switch_is_forgotten():
    plant, law = plants.paper(), expected(plants.paper(), dt.SemiMarkov(12.0))
    feedback = law.digital(0.01)
    oracle = dt.ExactPredictor(plant, law.gains)
    exact = oracle.digital(0.01, dt.SwitchingSignal([0, 12.0], [0, 1], 25.0), 1151)
    row = feedback.rows(np.zeros(1200, int))[1150]
    plants.close(feedback.state_gain[row], exact.state_gain[1150], 1e-10)


def test_very_long_sojourns_are_fine_once_the_ages_are_limited():
    law = expected(plants.paper(), dt.SemiMarkov(1e6), ages=10)
    single = dt.SingleModePredictor(plants.paper(), law.gains, 0).digital(0.01)
    assert law.digital(0.01).ages == 10
    assert distance(law.digital(0.01), single, 0) <= 1e-13


# -- refused -----------------------------------------------------------------------------------


def test_a_model_with_other_modes_than_the_plant_is_refused():
    with pytest.raises(dt.ArgumentError, match=r"model must have the plant's 3 modes, got 2"):
        expected(PLANT, dt.Markov([[0, 1.0], [1.0, 0]]))


def test_what_is_no_switching_model_is_refused():
    with pytest.raises(
        dt.ArgumentError, match="model must be a switching model, such as Markov or SemiMarkov"
    ):
        require_model(stats.expon(scale=0.2), 3)


@pytest.mark.parametrize("ages", [0, -1, True])
def test_a_number_of_ages_that_is_none_is_refused(ages):
    with pytest.raises(dt.ArgumentError, match="ages must be an integer of at least 1"):
        expected(PLANT, dt.Markov(RATES), ages=ages)


def test_a_step_too_long_for_the_sojourns_is_refused():
    law = expected(PLANT, dt.SemiMarkov([0.5, 0.15, 0.5]))
    with pytest.raises(dt.ArgumentError, match=r"step.*mode 1"):
        law.digital(H)


def test_a_table_that_memory_does_not_hold_is_refused():
    law = expected(plants.paper(), dt.SemiMarkov(1e6))
    with pytest.raises(dt.ArgumentError, match=r"step = 0\.01 s needs a table of more than"):
        law.digital(0.01)
    law = expected(plants.paper(), dt.SemiMarkov(1.0), ages=10**9)
    with pytest.raises(dt.ArgumentError, match=r"ages needs a table of 1e\+09 ages"):
        law.digital(0.01)


@pytest.mark.parametrize("rate", [1e10, 1e20, 1e200])
def test_rates_that_doubles_cannot_tell_from_infinite_ones_are_refused(rate):
    law = expected(plants.paper(), dt.Markov([[0.0, rate], [2.0 * rate, 0.0]]))
    with pytest.raises(dt.ArgumentError, match="model has rates up to"):
        law.digital(0.01)


def test_fast_switching_under_the_ideal_loop_is_refused_by_name():
    law = expected(plants.paper(), dt.Markov([[0.0, 50.0], [50.0, 0.0]]))
    with pytest.raises(dt.ArgumentError, match=r"closed form of ExpectedPredictor .* up to 50"):
        law.ideal(dt.SwitchingSignal.constant(0), 1.0)


def test_the_ideal_loop_is_refused_by_name():
    with pytest.raises(dt.ArgumentError, match="ExpectedPredictor"):
        dt.simulate(
            PLANT,
            expected(PLANT, dt.SemiMarkov(SOJOURNS, TRANSITION)),
            plants.off_grid(),
            np.ones(3),
            1.0,
            step=None,
        )
