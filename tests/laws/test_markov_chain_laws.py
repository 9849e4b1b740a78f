"""Laws, spreads and filters under a Markov chain at samples, against the sum over all paths."""

import itertools

import numpy as np
import pytest
from scipy.linalg import expm

import deadtime as dt
import mode_paths
import plants
from deadtime.feedback.table import Known
from delay_reference import Reference

STEP = 0.1
P = np.array([[0.7, 0.2, 0.1], [0.35, 0.5, 0.15], [0.0, 0.4, 0.6]])
CHAIN = dt.MarkovChain(P, STEP)


def plant_and_gains(delay, seed=0, inputs=2):
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(3, 2, 2)), rng.normal(size=(3, 2, inputs))
    return dt.SwitchedSystem(A, B, delay), rng.normal(size=(3, inputs, 2))


def paths(mode, samples, P=P):
    """Every sequence of modes at samples from one on, and how likely it is."""
    for rest in itertools.product(range(len(P)), repeat=samples):
        modes = (mode, *rest)
        likely = np.prod([P[i, j] for i, j in itertools.pairwise(modes)])
        if likely > 0.0:
            yield likely, modes


def moved(A, B, x, u, seconds):
    """x after so long under a held input, by one exponential."""
    n, m = B.shape
    Z = np.zeros((n + m + 1, n + m + 1))
    Z[:n, :n], Z[:n, -1] = A, B @ u
    return (expm(Z * seconds) @ np.concatenate((x, np.zeros(m), [1.0])))[:n]


@pytest.mark.parametrize("delay", [0.1, 0.04, 0.234, 0.3])
@pytest.mark.parametrize("mode", range(3))
def test_the_expected_law_is_the_sum_over_all_paths(delay, mode):
    plant, K = plant_and_gains(delay)
    table = dt.ExpectedPredictor(plant, K, CHAIN, allow_unstable=True).digital(STEP)
    assert (table.context, table.ages, len(table.state_gain)) == ("mode", 1, 3)
    count = int(np.ceil(delay / STEP - 1e-9))
    phase = delay - (count - 1) * STEP
    rng = np.random.default_rng(1)
    x, past = rng.normal(size=2), rng.normal(size=(count, 2))  # u_{k−1} first
    whole = int(np.floor(delay / STEP + 1e-9))
    answer = np.zeros(2)
    for likely, modes in paths(mode, whole):
        state = x
        for p in range(count):
            A, B = plant.A[modes[p]], plant.B[modes[p]]
            state = moved(A, B, state, past[count - 1 - p], phase)
            if p < count - 1:
                state = moved(A, B, state, past[count - 2 - p], STEP - phase)
        answer += likely * K[modes[whole]] @ state
    found = table.state_gain[mode] @ x + np.einsum("jab,jb->a", table.input_gain[mode], past)
    np.testing.assert_allclose(found, answer, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize(
    ("delay", "inputs"),
    [
        ([0.234, 0.1], 2),
        ([0.1, 0.3], 2),
        ([[0.15], [0.234], [0.04]], 1),
        ([[0.15], [0.2], [0.04]], 2),
        ([[0.1, 0.234], [0.1, 0.3], [0.1, 0.15]], 2),
    ],
    ids=["of inputs", "on the grid", "of modes", "of modes, two inputs", "of inputs and modes"],
)
def test_with_delays_of_inputs_and_modes_it_is_the_sum_over_all_paths(delay, inputs):
    plant, K = plant_and_gains(delay, seed=3, inputs=inputs)
    table = dt.ExpectedPredictor(plant, K, CHAIN, allow_unstable=True).digital(STEP)
    model = Reference(plant.A, plant.B, plant.delays, STEP)
    rng, taps = np.random.default_rng(2), table.input_gain.shape[1]
    x, past = rng.normal(size=2), rng.normal(size=(taps, inputs))
    samples = int(np.ceil(plant.longest_delay / STEP)) + 1
    grid = (np.arange(samples + 1) * STEP).tolist()
    for mode in range(3):
        answer = np.zeros(inputs)
        for likely, modes in paths(mode, samples):
            sampled = lambda t, modes=modes: modes[int(np.floor(t / STEP))]  # noqa: E731
            sent = lambda j, k: past[-1 - k, j]  # noqa: E731
            answer += likely * model.feedback(0, x, grid, sampled, [*K], sent)
        found = table.state_gain[mode] @ x + np.einsum("jab,jb->a", table.input_gain[mode], past)
        np.testing.assert_allclose(found, answer, rtol=0.0, atol=1e-13)


class Aged(dt.MarkovChain):
    """The same chain by one who tells ages apart that all say the same."""

    def ages(self, step, most=None):
        return 4

    def chain(self, step, ages=1):
        own = super().chain(step)
        return own._replace(hazard=np.repeat(own.hazard, ages, axis=1))


@pytest.mark.parametrize("delay", [0.234, [[0.1, 0.234], [0.1, 0.3], [0.1, 0.15]]])
def test_ages_that_say_nothing_change_nothing(delay):
    plant, K = plant_and_gains(delay, seed=5)
    table, aged = (
        dt.ExpectedPredictor(plant, K, model, allow_unstable=True).digital(STEP)
        for model in (CHAIN, Aged(P, STEP))
    )
    assert (aged.context, aged.ages) == ("mode_age", 4)
    for name in ("state_gain", "input_gain"):
        found = np.repeat(getattr(table, name), 4, axis=0)
        np.testing.assert_allclose(getattr(aged, name), found, rtol=0.0, atol=1e-14)


def test_as_the_period_falls_it_comes_to_the_law_of_the_process_in_continuous_time():
    """Which switches within periods, by O(h)."""
    plant, K = plant_and_gains(0.4)
    process, x = dt.Markov([[0.0, 1.0, 0.5], [2.0, 0.0, 0.3], [0.4, 0.9, 0.0]]), np.ones(2)
    errors = []
    for step in (0.1, 0.05, 0.025):
        chain = dt.MarkovChain(expm(step * process.generator), step)
        values = []
        for model in (process, chain):
            table = dt.ExpectedPredictor(plant, K, model, allow_unstable=True).digital(step)
            values.append(table.state_gain @ x + table.input_gain.sum(axis=1) @ np.ones(2))
        errors.append(np.abs(values[0] - values[1]).max())
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.abs(slopes - 1.0).max() < 0.15


@pytest.mark.parametrize("mode", range(3))
def test_predictions_spread_as_all_paths_do(mode):
    plant, K = plant_and_gains(0.234)
    rng = np.random.default_rng(4)
    x, past, first = rng.normal(size=2), rng.normal(size=(3, 2)), np.diag([0.2, 0.1])
    W = np.array([[0.3, 0.1], [0.1, 0.5]])
    law = dt.ExpectedPredictor(plant, K, CHAIN, allow_unstable=True)
    known = Known(np.array([mode]), np.ones(1), x[None], first[None], past)
    found = law.spread(STEP, known, W)[0, 0]
    pieces = ((0.034, 0, 0), (0.066, 1, 0), (0.034, 1, 1), (0.066, 2, 1), (0.034, 2, 2))
    ends = {i: [] for i in range(3)}
    for likely, modes in paths(mode, 2):
        mean, C = x, first
        for length, sample, place in pieces:
            A, B = plant.A[modes[place]], plant.B[modes[place]]
            mean = moved(A, B, mean, past[sample], length)
            E = expm(A * length)
            C = E @ C @ E.T + plants.gramian_by_quadrature(A, W, length)
        ends[modes[-1]].append((likely, mean, C))
    for i, own in ends.items():
        weights = np.array([one[0] for one in own]) / sum(one[0] for one in own)
        means, C = np.array([one[1] for one in own]), np.array([one[2] for one in own])
        apart = means - weights @ means
        whole = np.tensordot(weights, C, 1) + (weights[:, None] * apart).T @ apart
        np.testing.assert_allclose(found[i], whole, rtol=0.0, atol=1e-12)


def run_of(model, samples=9):
    plant = plants.generic([[0.234, 0.1], [0.15, 0.31], [0.05, 0.27]]).apart(0.4)
    rng = np.random.default_rng(5)
    inputs = {k: rng.normal(size=2) for k in range(-4, samples)}
    states, modes = [np.array([1.0, -1.0, 0.5])], [0, 0, 0, 1, 1, 1, 2, 2, 2]
    for k in range(samples - 1):
        x = mode_paths.ahead(plant, STEP, modes[k], states[-1], inputs, k)
        states.append(x + 0.15 * rng.normal(size=3))
    options = {"disturbance": np.diag([0.3, 0.2, 0.4]) + 0.05, "noise": [0.05, 0.02, 0.1]}
    filt = dt.ModeFilter(plant, model, STEP, forgetting=1e-18, **options)
    running = filt.start(np.array([inputs[k] for k in range(-filt.longest_lag, 0)]).T)
    found = [running.update(x, inputs[k - 1]) for k, x in enumerate(states)]
    return plant, np.array(states), inputs, filt, np.array(found)


def test_a_belief_is_the_sum_over_all_paths_and_takes_switches_to_be_at_samples():
    plant, states, inputs, filt, found = run_of(CHAIN)
    assert (filt.switches, filt.ages) == ("samples", 1)
    noise = filt.disturbance, filt.noise
    density = mode_paths.densities(plant, STEP, states, inputs, *noise, within=False)
    with np.errstate(divide="ignore"):
        log = np.log(P)

    def prior(paths):
        first = np.full(len(paths), -np.log(3.0))
        return first + sum(log[a, b] for a, b in zip(paths.T[:-1], paths.T[1:], strict=True))

    for count in (1, 3, 8):
        plants.close(found[count], mode_paths.beliefs(density[:count], prior), 1e-12)


def test_a_filter_from_outputs_takes_switches_to_be_where_the_model_has_them():
    plant, C = plants.generic().apart(0.4), [[1.0, 0.0, 0.2], [0.0, 1.0, 0.0]]
    options = {"covariance": 1.0, "disturbance": 0.1, "noise": 0.1}
    for model, switches in ((CHAIN, "samples"), (plants.markov(3), "anywhere")):
        filt = dt.OutputModeFilter(plant, model, STEP, C, **options)
        assert filt.chain.switches == switches
        assert filt.form().chain.within == (switches == "anywhere")


def test_a_process_seen_at_samples_is_the_chain_of_its_exponential():
    """Of a process in continuous time, filters that take switches to be at samples see P alone."""
    process = plants.markov(3)
    chain = dt.MarkovChain(expm(STEP * process.generator), STEP)
    plant, states, inputs, filt, found = run_of(chain)
    options = {"disturbance": filt.disturbance, "noise": filt.noise, "forgetting": 1e-18}
    other = dt.ModeFilter(plant, process, STEP, switches="samples", **options)
    running = other.start(np.array([inputs[k] for k in range(-other.longest_lag, 0)]).T)
    beliefs = [running.update(x, inputs[k - 1]) for k, x in enumerate(states)]
    np.testing.assert_allclose(beliefs, found, rtol=1e-12, atol=1e-15)


def test_the_optimal_law_costs_what_it_says_and_less_than_the_expected_one():
    """E ∫ over drawn signals of the chain: switches at samples are what its cost assumes."""
    problem, step = dt.problems.paper(), 0.05
    plant = problem.plant.apart(0.5)
    gains = dt.place(plant, [-1.0, -2.0])
    model = dt.MarkovChain([[0.95, 0.05], [0.1, 0.9]], step)
    optimal = dt.laws.OptimalPredictor(plant, model, np.eye(2), [[1.0]])
    laws = {"optimal": optimal, "expected": dt.ExpectedPredictor(plant, gains, model)}
    data = dt.monte_carlo(plant, laws, model, [-1.0, 1.0], 30.0, step, scenarios=400, seed=1)
    cost = data.cost.to_numpy()
    least = 0.5 * sum(optimal.least_cost([-1.0, 1.0], mode, step) for mode in range(2))
    error = cost[0].std() / np.sqrt(cost.shape[1])
    assert abs(cost[0].mean() - least) <= 4.0 * error
    assert cost[0].mean() < cost[1].mean()
