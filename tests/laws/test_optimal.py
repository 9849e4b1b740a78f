"""The optimal law: against a Riccati solver, dense matrices, simulation, and every other law."""

import itertools
from functools import cache

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import block_diag, expm, solve_discrete_are

import deadtime as dt
import plants
from deadtime.laws import OptimalPredictor
from shares import mostly_long

H = 0.1
TRANSITION = np.array([[0.0, 0.8, 0.2], [0.5, 0.0, 0.5], [1.0, 0.0, 0.0]])
SOJOURNS = (stats.gamma(2.3, scale=0.4), stats.uniform(0.35, 0.4), stats.expon(0.25, 0.6))
RATES = np.array([[0.0, 0.6, 0.2], [1.0, 0.0, 0.2], [0.3, 0.8, 0.0]])
MODELS = {"semi-Markov": dt.SemiMarkov(SOJOURNS, TRANSITION), "Markov": dt.Markov(RATES)}
# D = 2 h + 0.034, D = 2 h, and delays of at most one period.
DELAYS = [0.234, 0.2, 0.1, 0.04]
Q = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 0.5]])
R = np.array([[0.7, 0.2], [0.2, 0.4]])
X0 = np.array([1.0, -0.5, 2.0])


# -- a second method: dense matrices on z = (x, u_{k−1}, …, u_{k−N}, u_k), by Van Loan ----------


def form(A, B, tau):
    """∫₀^τ xᵀQx dt as a form in (x, u) at its start."""
    n, m = B.shape
    Z = np.zeros((n + m, n + m))
    Z[:n] = np.hstack((A, B))
    size = n + m
    whole = expm(tau * np.block([[-Z.T, block_diag(Q, np.zeros((m, m)))], [0 * Z, Z]]))
    return whole[size:, size:].T @ whole[:size, size:]


@cache
def lifted(plant, mode):
    """x_{k+1}, u_k, … from z as a matrix, and the cost of one period as a form in z."""
    A, B = plant.A[mode], plant.B[mode]
    n, m = B.shape
    N = int(np.ceil(round(plant.delay / H, 9)))
    phase = plant.delay - (N - 1) * H
    x, u = (
        np.eye(n, n + (N + 1) * m),
        np.eye((N + 1) * m, n + (N + 1) * m, k=n).reshape(N + 1, m, -1),
    )
    newest = [u[-1], *u[:-1]]  # u_k, u_{k−1}, …
    Phi, Gamma = plants.held(A, B, phase)
    middle = Phi @ x + Gamma @ newest[N]
    Phi, Gamma = plants.held(A, B, H - phase)
    end = Phi @ middle + Gamma @ newest[N - 1]
    cost = H * newest[0].T @ R @ newest[0]
    for start, past, tau in ((x, N, phase), (middle, N - 1, H - phase)):
        z = np.vstack((start, newest[past]))
        cost = cost + z.T @ form(A, B, tau) @ z
    return np.vstack((end, *newest[:N])), cost


@cache
def chain(model, ages):
    """Transition probabilities between the rows of the table."""
    if model is MODELS["Markov"]:
        return expm(H * (RATES - np.diag(RATES.sum(axis=1))))
    result = np.zeros((3 * ages, 3 * ages))
    for i, a in itertools.product(range(3), range(ages)):
        outlived = SOJOURNS[i].sf(a * H)
        leaves = 1.0 - SOJOURNS[i].sf((a + 1) * H) / outlived if outlived > 0.0 else 1.0
        result[i * ages + a, i * ages + min(a + 1, ages - 1)] += 1.0 - leaves
        result[i * ages + a, ::ages] += leaves * TRANSITION[i]
    return result


def rows_of(feedback):
    """The table as matrices from ξ = (x, u_{k−1}, …) to u_k, one per mode and age."""
    rows, N, m, _ = feedback.input_gain.shape
    taps = feedback.input_gain.transpose(0, 2, 1, 3).reshape(rows, m, N * m)
    return np.concatenate((feedback.state_gain, taps), axis=2)


def costs_to_go(plant, model, gain, ages):
    """P of ξᵀPξ for every row under the table `gain`, by iterating what a period costs."""
    probability = chain(model, ages)
    closed, stage = [], []
    for row in range(3 * ages):
        matrix, cost = lifted(plant, row // ages)
        z = np.vstack((np.eye(gain.shape[2]), gain[row]))
        closed.append(matrix @ z)
        stage.append(z.T @ cost @ z)
    closed, stage = np.array(closed), np.array(stage)
    P = stage
    for _ in range(5000):
        mean = np.tensordot(probability, P, 1)
        new = stage + closed.transpose(0, 2, 1) @ mean @ closed
        if np.abs(new - P).max() <= 1e-13 * np.abs(new).max() or np.abs(new).max() > 1e9:
            return new
        P = new
    return P


def optimal(plant, model):
    return OptimalPredictor(plant, model, Q, R)


@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("kind", MODELS)
def test_the_table_satisfies_the_coupled_riccati_equations_and_costs_what_they_say(kind, delay):
    plant, model = plants.generic(delay), MODELS[kind]
    law = optimal(plant, model)
    feedback = law.digital(H)
    gain, ages = rows_of(feedback), feedback.ages
    P = costs_to_go(plant, model, gain, ages)
    mean = np.tensordot(chain(model, ages), P, 1)
    size = gain.shape[2]
    for row in range(3 * ages):
        matrix, cost = lifted(plant, row // ages)
        W = cost + matrix.T @ mean[row] @ matrix
        best = -np.linalg.solve(W[size:, size:], W[size:, :size])
        plants.close(gain[row], best, 1e-9)
        plants.close(P[row], W[:size, :size] + W[:size, size:] @ best, 1e-9)
    for mode in range(3):
        cost = X0 @ P[mode * ages, :3, :3] @ X0
        assert law.least_cost(X0, mode, H) == pytest.approx(cost, rel=1e-9)


@pytest.mark.parametrize(
    "kind", mostly_long(MODELS, *[kind for kind in MODELS if kind != "semi-Markov"])
)
def test_every_other_table_costs_more(kind):
    plant, model = plants.generic(0.234), MODELS[kind]
    law = optimal(plant, model)
    feedback = law.digital(H)
    best, ages = rows_of(feedback), feedback.ages
    first = np.arange(3) * ages
    least = costs_to_go(plant, model, best, ages)[first]
    rng = np.random.default_rng(0)
    others = [best * (1.0 + 0.05 * rng.normal(size=best.shape)) for _ in range(5)]
    gains = dt.lqr(plant, Q, R)
    laws = [
        dt.ExpectedPredictor(plant, gains, model),
        dt.AveragedPredictor(plant, gains),
        dt.MeanPredictor(plant, dt.lqr(plant.mean(), Q, R)[0]),
        dt.DelayedStateFeedback(plant, gains),
    ]
    for other in laws:
        table = other.digital(H)
        modes = {"none": 1}.get(table.context, 3)
        rows = rows_of(table).reshape(modes, table.ages, *best.shape[1:])
        age = np.minimum(np.arange(ages), table.ages - 1)
        others.append(np.broadcast_to(rows[:, age], (3, ages, *best.shape[1:])).reshape(best.shape))
    for other in others:
        more = costs_to_go(plant, model, other, ages)[first] - least
        for difference in more:  # for every state and every input under way
            assert np.linalg.eigvalsh((difference + difference.T) / 2.0)[0] > -1e-9 * least.max()
            assert (
                difference[:3, :3].trace() > 1e-4 * least[:, :3, :3].trace(axis1=1, axis2=2).min()
            )


# -- closed forms ------------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [*DELAYS, 1.0])
@pytest.mark.parametrize("case", ["no switching", "identical modes"])
def test_with_nothing_random_it_is_the_delay_free_regulator_of_the_exact_prediction(delay, case):
    if case == "no switching":
        plant, model = plants.generic(delay), dt.Markov(np.zeros((3, 3)))
    else:
        plant, model = plants.identical(delay), MODELS["semi-Markov"]
    law = optimal(plant, model)
    feedback = law.digital(H)
    N = feedback.taps
    for mode in range(3):
        A, B = plant.A[mode], plant.B[mode]
        Phi, Gamma = plants.held(A, B, H)
        weight = form(A, B, H)
        cross = weight[:3, 3:]
        X = solve_discrete_are(Phi, Gamma, weight[:3, :3], weight[3:, 3:] + H * R, s=cross)
        K = -np.linalg.solve(
            weight[3:, 3:] + H * R + Gamma.T @ X @ Gamma, Gamma.T @ X @ Phi + cross.T
        )
        arrival = expm(A * delay)
        last = plants.held(A, B, delay - (N - 1) * H)[1]
        G = [K @ np.linalg.matrix_power(Phi, j) @ (Gamma if j < N - 1 else last) for j in range(N)]
        for row in range(mode * feedback.ages, (mode + 1) * feedback.ages):
            plants.close(feedback.state_gain[row], K @ arrival, 1e-9)
            plants.close(feedback.input_gain[row], np.array(G), 1e-9)
        before = form(A, B, delay)[:3, :3]
        cost = X0 @ (before + arrival.T @ X @ arrival) @ X0
        assert law.least_cost(X0, mode, H) == pytest.approx(cost, rel=1e-9)


@pytest.mark.parametrize("step", [0.1, 0.05])
def test_a_plant_that_no_input_reaches_grows_as_its_second_moment(step):
    # E x² of a scalar plant: each period multiplies by e^{2ah} in mode i, then the mode may jump.
    a = np.array([0.7, -0.4])
    model = dt.Markov([[0.0, 0.5], [1.5, 0.0]])
    law = OptimalPredictor(plants.scalar(a, 0.0, 0.3), model, [[1.0]], [[1.0]])
    moment = np.exp(2.0 * a * step)[:, None] * expm(step * model.generator)
    rate = np.log(np.abs(np.linalg.eigvals(moment)).max()) / step
    with pytest.raises(dt.InfeasibleError, match=r"E\|x\|² grows at \+") as caught:
        law.digital(step)
    said = float(str(caught.value).split("grows at ")[1].split()[0])
    assert said == pytest.approx(rate, rel=5e-3)  # three digits are printed


@pytest.mark.parametrize("b", [-1.0, -0.2, 0.0])
def test_an_input_that_may_come_to_act_the_other_way_round_is_no_use(b):
    plant = plants.scalar([1.0, 1.0], np.array([1.0, b]), 1.0)
    model = dt.SemiMarkov(stats.expon(0.2, 0.2))
    with pytest.raises(dt.InfeasibleError, match=r"no causal law with a finite expected cost"):
        OptimalPredictor(plant, model, [[1.0]], [[1.0]]).digital(0.05)


# -- simulation --------------------------------------------------------------------------------


def test_predictable_switching_costs_exactly_what_is_previewed():
    plant = plants.generic(0.234)
    model = dt.SemiMarkov([0.3, 0.4, 0.5], np.roll(np.eye(3), 1, axis=1))
    law = OptimalPredictor(plant, model, np.eye(3), 0.5 * np.eye(2))
    for mode in range(3):
        order = [(mode + i) % 3 for i in range(3)]
        signal = dt.SwitchingSignal.periodic(np.array([0.3, 0.4, 0.5])[order], order, 30.0)
        metrics = dt.simulate(plant, law, signal, X0, 30.0, step=H).metrics()
        cost = metrics["ise"] + 0.5 * metrics["energy"]
        assert law.least_cost(X0, mode, H) == pytest.approx(cost, rel=1e-9)


def drawn(model, rng, samples):
    """A signal with switches at samples, from the hazards of the model."""
    hazard = model.hazard(H, 200)
    mode = age = 0
    times, modes = [0.0], [0]
    for k in range(1, samples):
        if rng.random() < hazard[mode, age]:
            mode, age = int(rng.choice(3, p=TRANSITION[mode])), 0
            times.append(k * H)
            modes.append(mode)
        else:
            age += 1
    return dt.SwitchingSignal(times, modes)


@pytest.mark.long
def test_the_mean_cost_of_many_runs_is_the_least_expected_cost():
    plant, model = plants.generic(0.234), MODELS["semi-Markov"]
    law = OptimalPredictor(plant, model, np.eye(3), 0.5 * np.eye(2))
    rng = np.random.default_rng(1)
    costs = []
    for _ in range(1500):
        metrics = dt.simulate(plant, law, drawn(model, rng, 250), X0, 25.0, step=H).metrics()
        costs.append(metrics["ise"] + 0.5 * metrics["energy"])
    error = np.std(costs) / np.sqrt(len(costs))
    assert error < 0.03 * np.mean(costs)
    assert abs(np.mean(costs) - law.least_cost(X0, 0, H)) < 3.0 * error


@pytest.mark.long
def test_where_modes_differ_much_it_stabilises_and_the_expected_law_does_not():
    plant = plants.scalar([1.0, 1.0], np.array([1.0, 0.2]), 1.0)
    model = dt.SemiMarkov(stats.expon(0.2, 0.2))
    laws = [
        OptimalPredictor(plant, model, [[1.0]], [[1.0]]),
        dt.ExpectedPredictor(plant, dt.lqr(plant, [[1.0]], [[1.0]]), model),
    ]
    data = dt.monte_carlo(plant, laws, model, [1.0], 30.0, step=0.05, scenarios=50, seed=0)
    optimal, expected = data.final_norm.median("scenario").values
    assert optimal < 1e-2
    assert expected > 1.0


# -- relations ---------------------------------------------------------------------------------


def test_units_of_cost_and_state_change_nothing():
    plant, model = plants.generic(0.234), MODELS["semi-Markov"]
    reference = optimal(plant, model).digital(H)
    scaled = OptimalPredictor(plant, model, 1e6 * Q, 1e6 * R).digital(H)
    plants.close(scaled.input_gain, reference.input_gain, 1e-9)
    T = np.diag([1e-3, 1.0, 1e4])
    back = np.linalg.inv(T)
    moved = dt.SwitchedSystem(T @ plant.A @ back, T @ plant.B, plant.delay)
    table = OptimalPredictor(moved, model, back @ Q @ back, R).digital(H)
    plants.close(table.state_gain @ T, reference.state_gain, 1e-8)
    plants.close(table.input_gain, reference.input_gain, 1e-8)


def test_a_shorter_table_lets_older_modes_count_as_its_oldest():
    plant = plants.generic(0.234)
    full = optimal(plant, MODELS["semi-Markov"]).digital(H)
    short = OptimalPredictor(plant, MODELS["semi-Markov"], Q, R, ages=4).digital(H)
    assert full.ages > 4
    assert short.ages == 4
    assert short.context == "mode_age"
    assert short.state_gain.shape == (12, 2, 3)


def test_the_table_is_made_once_for_a_step():
    law = optimal(plants.generic(), MODELS["Markov"])
    table = law.digital(H)
    assert law.digital(H) is table
    assert (table.context, table.ages) == ("mode", 1)
    assert law.digital(H / 2).step == H / 2


# -- refused -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"Q": np.eye(2)}, r"Q must have shape \(n, n\) = \(3, 3\), got \(2, 2\)"),
        ({"R": np.eye(3)}, r"R must have shape \(m, m\) = \(2, 2\), got \(3, 3\)"),
        ({"Q": Q + np.eye(3, k=1)}, r"Q must be symmetric"),
        ({"Q": np.diag([1.0, 1.0, 0.0])}, r"Q must be positive definite, got 0 on its diagonal\."),
        ({"R": np.diag([1.0, -1.0])}, r"R must be positive definite, got -1 on its diagonal\."),
        ({"model": dt.Markov([[0, 1], [1, 0]])}, r"model must have the plant's 3 modes, got 2"),
        ({"ages": 0}, r"ages must be an integer of at least 1, got 0"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(change, message):
    arguments = {"model": MODELS["Markov"], "Q": Q, "R": R} | change
    with pytest.raises(dt.ArgumentError, match=message):
        OptimalPredictor(plants.generic(), **arguments)


def test_requests_that_have_no_answer_are_refused():
    law = optimal(plants.generic(), MODELS["semi-Markov"])
    with pytest.raises(dt.ArgumentError, match=r"OptimalPredictor has no closed form"):
        dt.simulate(law.plant, law, dt.SwitchingSignal.constant(0), X0, 1.0, step=None)
    with pytest.raises(dt.ArgumentError, match=r"mode must be in 0\.\.2, got 3"):
        law.least_cost(X0, 3)
    with pytest.raises(dt.ArgumentError, match=r"x0 must have shape \(n,\) = \(3,\), got \(2,\)"):
        law.least_cost([1.0, 0.0], 0)
    with pytest.raises(dt.ArgumentError, match=r"step = 1 s is too long for the sojourns"):
        law.digital(1.0)
    message = r"step = 0\.0001 s needs a table of more than 7 ages, for which there is no room"
    with pytest.raises(dt.ArgumentError, match=message):
        law.digital(0.0001)


def test_a_delay_too_long_for_double_precision_is_named_as_such():
    plant = plants.scalar([12.0, 12.0], 1.0, 1.0)
    law = OptimalPredictor(plant, dt.Markov([[0, 1], [1, 0]]), [[1.0]], [[1.0]])
    with pytest.raises(dt.ArgumentError, match=r"plant is too unstable for so long a delay"):
        law.digital(0.05)
