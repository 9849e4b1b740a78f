"""Laws and runs where inputs and modes have delays of their own, against their definition.

`delay_reference` works out the plant and every law with SciPy alone.
"""

import numpy as np
import pytest
from scipy import stats

import deadtime as dt
from deadtime.laws.tables.along_signal import rows_along
from deadtime.laws.tables.markov import passage_table
from deadtime.plant import SampledPlant
from delay_reference import Reference
from shares import mostly_long

STEP, DWELL, SAMPLES, SLOW = 0.1, 0.37, 12, 0.25


class Case:
    """A random plant, the model of its laws, gains, and a signal that switches off the grid."""

    def __init__(self, seed, most):
        rng = np.random.default_rng(seed)
        modes, n, m = (int(rng.integers(1, last)) for last in (4, 5, 4))
        A, B = 0.7 * rng.normal(size=(modes, n, n)), rng.normal(size=(modes, n, m))
        self.K, self.x0 = 0.5 * rng.normal(size=(modes, m, n)), rng.normal(size=n)
        shape = [(m,), (modes, 1), (modes, m)][rng.integers(3)]
        D = rng.uniform(0.02, most * STEP, size=shape)
        if rng.random() < 0.4:
            D = np.maximum(np.round(D / STEP), 1.0) * STEP
        self.model = dt.SwitchedSystem(A, B, D)
        A, B = A + 0.1 * rng.normal(size=A.shape), B + 0.1 * rng.normal(size=B.shape)
        self.plant = dt.SwitchedSystem(A, B, D * rng.uniform(0.8, 1.2, size=shape))
        times, path = np.append(0.0, np.cumsum(rng.exponential(0.35, size=40))), [0]
        for _ in range(40):
            path.append((path[-1] + int(rng.integers(1, modes))) % modes if modes > 1 else 0)
        self.signal = dt.SwitchingSignal(times, path) if modes > 1 else dt.SwitchingSignal([0], [0])
        self.weights = rng.dirichlet(np.ones(modes))
        self.lag = int(np.ceil(self.model.longest_delay / STEP))
        self.shortest = self.lag // 2 + 2  # samples of a sojourn that the expected law believes in

    def laws(self):
        loose = {"allow_unstable": True}
        plant, K, w = self.model, self.K, self.weights
        laws = {
            "averaged": dt.AveragedPredictor(plant, K, w, **loose),
            "averaged, dwelling": dt.AveragedPredictor(plant, K, w, dwell_time=DWELL, **loose),
            "single": dt.SingleModePredictor(plant, K, plant.modes - 1, **loose),
            "mean": dt.MeanPredictor(plant, K[0], K, **loose),
            "mean, dwelling": dt.MeanPredictor(plant, K[0], K, dwell_time=DWELL, **loose),
            "oracle": dt.ExactPredictor(plant, K, **loose),
            "delay ignored": dt.DelayedStateFeedback(plant, K, **loose),
        }
        laws["low-pass"] = dt.LowPassPredictor(laws["averaged"], SLOW)
        if plant.modes > 1 and (plant.inputs == 1 or (plant.delays == plant.delays[0]).all()):
            sojourn = stats.uniform(loc=self.shortest * STEP, scale=2.0 * STEP)
            model = dt.SemiMarkov(sojourn, modes=plant.modes)
            laws["expected"] = dt.ExpectedPredictor(plant, K, model, **loose)
        return laws

    def futures(self, mode, age):
        """Modes at the samples to come, as many as are previewed, and how likely they are.

        A sojourn lasts one sample more than the shortest, or two, equally likely.
        """
        futures = [(1.0, [mode], age)]
        for _ in range(self.lag + 2):
            then = []
            for likely, modes, old in futures:
                leaves = min(1.0, max(0.0, 0.5 * (old - self.shortest + 1)))
                others = [i for i in range(self.model.modes) if i != modes[-1]]
                if leaves > 0.0:
                    then += [(likely * leaves / len(others), [*modes, i], 0) for i in others]
                if leaves < 1.0:
                    then.append((likely * (1.0 - leaves), [*modes, modes[-1]], old + 1))
            futures = then
        return [(likely, modes) for likely, modes, _ in futures]

    def mode(self, time):
        return int(self.signal(np.array([time]))[0])

    def input_of(self, name, k, x, value):
        """u_k by definition."""
        plant, K, mean = self.model, self.K, self.model.mean()
        parts = [np.concatenate(pair) for pair in ((plant.A, mean.A), (plant.B, mean.B))]
        model = Reference(*parts, np.concatenate((plant.delays, mean.delays)), STEP)
        modes, now, begin, age = range(plant.modes), self.mode(k * STEP), k * STEP, 0
        while k - age > 0 and self.mode((k - age - 1) * STEP) == now:
            age += 1
        left = begin + max(0.0, DWELL - age * STEP)

        def along(after, gain, switch=-np.inf):
            return model.feedback(
                k, x, [switch], lambda t: now if t < switch else after, [gain] * 9, value
            )

        if name == "expected":
            grid = ((k + np.arange(self.lag + 3)) * STEP).tolist()
            answer = 0.0
            for likely, path in self.futures(now, age):
                sampled = lambda t, path=path: path[int(np.floor(t / STEP)) - k]  # noqa: E731
                answer = answer + likely * model.feedback(k, x, grid, sampled, [*K], value)
            return answer
        if name == "low-pass":
            own = sum(self.weights[i] * along(i, K[i]) for i in modes)
            before = np.array([value(j, k - 1) for j in range(plant.inputs)])
            return own + np.exp(-STEP / SLOW) * (before - own)
        if name == "averaged":
            return sum(self.weights[i] * along(i, K[i]) for i in modes)
        if name == "averaged, dwelling":
            return sum(self.weights[i] * along(i, K[i], left) for i in modes)
        if name == "single":
            return along(plant.modes - 1, K[-1])
        if name == "mean":
            return along(plant.modes, K[0])
        if name == "mean, dwelling":
            return along(plant.modes, K[0], left)
        if name == "oracle":
            return model.feedback(k, x, self.signal.times[1:].tolist(), self.mode, K, value)
        return K[now] @ x


@pytest.mark.parametrize("seed", range(6))
def test_runs_and_laws_are_what_their_definitions_say(seed):
    check(Case(seed, most=6))


@pytest.mark.long
@pytest.mark.parametrize("first", range(0, 300, 50))
def test_runs_and_laws_of_three_hundred_plants_are_what_their_definitions_say(first):
    """Delays up to thirty periods."""
    for seed in range(first, first + 50):
        check(Case(100 + seed, most=30))


def check(case):
    plant, m = case.plant, case.plant.inputs
    truth = Reference(plant.A, plant.B, plant.delays, STEP)
    for name, law in case.laws().items():
        run = dt.simulate(
            plant, law, case.signal, case.x0, SAMPLES * STEP, STEP,
            u0=lambda t: np.cos(3.0 * t + np.arange(m)),
        )  # fmt: skip
        inputs, past = run.record.inputs, run.record.past

        def value(j, k, inputs=inputs, past=past):
            return inputs[past + k, j]

        states = truth.states(case.x0, case.signal, SAMPLES, value)
        assert np.abs(run.states.T - states).max() <= 1e-12 * max(1.0, np.abs(states).max())
        for k in (0, 5, SAMPLES - 1):
            u = case.input_of(name, k, run.states[:, k], value)
            size = max(1.0, np.abs(u).max(), np.abs(inputs).max())
            assert np.abs(inputs[past + k] - u).max() <= 1e-12 * size, (name, k)


OWN = np.array([[0.1, 0.5], [0.234, 0.2], [0.3, 0.33]])


def two_delays(seed=0, delay=OWN, inputs=2):
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(3, 2, 2)), rng.normal(size=(3, 2, inputs))
    return dt.SwitchedSystem(A, B, delay), rng.normal(size=(3, inputs, 2))


def close(table, other, tolerance=1e-13):
    np.testing.assert_allclose(table.state_gain, other.state_gain, rtol=0.0, atol=tolerance)
    np.testing.assert_allclose(table.input_gain, other.input_gain, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("delay", [0.05, 0.234, 0.3])
def test_first_passages_with_one_delay_are_the_closed_form(delay):
    plant, K = two_delays(delay=delay)
    sampled = SampledPlant(plant, STEP)
    markov = dt.Markov(np.array([[0.0, 1.0, 2.0], [0.5, 0.0, 0.7], [2.5, 1.0, 0.0]]))
    law = dt.ExpectedPredictor(plant, K, markov, allow_unstable=True)
    close(law.digital(STEP), passage_table(K, markov.generator, sampled))


def test_a_markov_model_that_never_switches_is_the_current_mode_held():
    plant, K = two_delays()
    sampled = SampledPlant(plant, STEP)
    table = passage_table(K, np.zeros((3, 3)), sampled)
    for mode in range(3):
        F, G = rows_along(sampled, K, dt.SwitchingSignal.constant(mode), 1)
        np.testing.assert_allclose(table.state_gain[mode], F[0], atol=1e-13)
        np.testing.assert_allclose(table.input_gain[mode], G[0], atol=1e-13)


# Fixed sojourns in a fixed order leave nothing to chance: the expected law is the oracle. Exactly
# so for one input, and where each has the same delay in all modes.
@pytest.mark.parametrize(("delay", "inputs"), [([0.4, 0.2], 2), ([[0.1], [0.5], [0.3]], 1)])
def test_fixed_sojourns_give_the_oracle(delay, inputs):
    plant, K = two_delays(delay=delay, inputs=inputs)
    order = np.roll(np.eye(3), 1, axis=1)
    model = dt.SemiMarkov([0.2, 0.3, 0.2], order)
    times = np.cumsum([0.0, 0.2, 0.3, 0.2, 0.2, 0.3, 0.2, 0.2, 0.3, 0.2, 0.2, 0.3, 0.2])
    signal = dt.SwitchingSignal(times, np.arange(13) % 3)
    laws = [
        dt.ExpectedPredictor(plant, K, model, allow_unstable=True),
        dt.ExactPredictor(plant, K, allow_unstable=True),
    ]
    runs = [dt.simulate(plant, law, signal, [1.0, -1.0], 2.0, STEP) for law in laws]
    size = np.abs(runs[1].states).max()
    np.testing.assert_allclose(runs[0].states, runs[1].states, rtol=0.0, atol=1e-11 * size)


ONE_INPUT = [[0.1], [0.36], [0.3]], 1


@pytest.mark.parametrize(
    ("delay", "inputs"), mostly_long([([0.234, 0.41], 2), ONE_INPUT], ONE_INPUT)
)
def test_the_expected_law_is_the_mean_of_oracles(delay, inputs):
    plant, K = two_delays(delay=delay, inputs=inputs)
    rates = np.array([[0.0, 1.0, 2.0], [0.5, 0.0, 0.7], [2.5, 1.0, 0.0]])
    model, sampled, count = dt.Markov(rates), SampledPlant(plant, STEP), 1500
    table = dt.ExpectedPredictor(plant, K, model, allow_unstable=True).digital(STEP)
    signals = [dt.Markov(rates).sample(3.0, seed=i) for i in range(count)]
    for mode in range(3):
        own = [signal for signal in signals if signal.modes[0] == mode]
        rows = [rows_along(sampled, K, signal, 1) for signal in own]
        for values, mean in zip(
            zip(*rows, strict=True), (table.state_gain, table.input_gain), strict=True
        ):
            drawn = np.array(values)[:, 0]
            error = drawn.std(axis=0) / np.sqrt(len(own))
            assert (np.abs(drawn.mean(axis=0) - mean[mode]) <= 4.5 * error + 1e-12).all()


@pytest.mark.parametrize("delay", [OWN, [0.1, 0.5]])
def test_the_oracle_has_no_mismatch_and_what_is_read_later_than_the_run_is_not_known(delay):
    plant, K = two_delays(delay=delay)
    law = dt.ExactPredictor(plant, K, allow_unstable=True)
    signal = dt.SwitchingSignal.random(3, 6, dwell_time=0.3, seed=2)
    run = dt.simulate(plant, law, signal, [1.0, 1.0], 2.0, STEP)
    known = ~np.isnan(run.mismatch)
    assert np.abs(run.mismatch[known]).max() <= 1e-10 * np.abs(run.inputs).max()
    assert known[:, run.time <= 1.5].all()
    assert known.all() == (delay is OWN)  # whose last mode reads both inputs about as late


def test_delays_of_inputs_are_matched_one_by_one_and_the_longest_for_all_is_not_enough():
    A, B = np.array([[[1.0, 1.0], [0.0, 0.5]]]), np.array([[[1.0, 0.0], [0.2, 1.0]]])
    K = np.linalg.solve(B[0], np.diag([-1.0, -1.5]) - A[0])[None]
    for delay, one in (([1.2, 0.7], -0.15), ([0.7, 1.2], 1.26), ([1.0, 1.0], -1.053)):
        plant, longest = (dt.SwitchedSystem(A, B, D) for D in (delay, max(delay)))
        rates = [dt.growth_rate(plant, dt.AveragedPredictor(plant, K), 0, h) for h in (0.05, 0.025)]
        assert np.round(rates, 3).tolist() == [-1.053, -1.026]
        wrong = dt.growth_rate(plant, dt.AveragedPredictor(longest, K), 0, 0.05)
        assert wrong == pytest.approx(one, abs=0.006)


def test_delays_of_modes_are_averaged_mode_by_mode():
    problem = dt.problems.paper()
    A, B = problem.plant.A, problem.plant.B
    for delay, own, mean in (
        (0.4, (0.097, 0.162), (0.263, 0.307)),
        (0.3, (0.213, 1.587), (1.355, 1.715)),
    ):
        plant = dt.SwitchedSystem(A, B, [[0.5], [delay]])
        one = dt.SwitchedSystem(A, B, (0.5 + delay) / 2)
        for model, rates in ((plant, own), (one, mean)):
            law = dt.AveragedPredictor(model, problem.gains)
            found = [dt.growth_rate(plant, law, mode, 0.02) for mode in (0, 1)]
            assert np.round(found, 3).tolist() == list(rates)
