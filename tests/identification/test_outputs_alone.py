"""Plants from outputs alone: against dense Gaussians and plants that are known."""

import re
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import multivariate_normal

import deadtime as dt
from deadtime.cli import main
from deadtime.identification.likelihoods.likelihood import maximise
from deadtime.identification.likelihoods.noisy_log import Embedding, NoiseLevels, NoisyLog
from deadtime.identification.log.recording import Part, Recording
from deadtime.identification.parameters import Layout
from deadtime.identification.sampling import nodes_for
from deadtime.identification.scoring import Evaluation, climb
from deadtime.problems import load_problem
from deadtime.reports.identification_report import interval_rows
from output_logs import MOTOR, OUTPUTS, H, logged, misses
from synthetic_logs import Plant

A = [
    [[0.0, 1.0, 0.0], [-2.0, -1.0, 0.5], [0.3, 0.1, -1.0]],
    [[0.0, 1.0, 0.0], [-3.0, -0.5, 0.5], [0.0, 0.2, -2.0]],
    [[0.0, 1.0, 0.0], [-1.0, -1.5, -0.4], [0.1, 0.0, -0.5]],
]
B = [
    [[0.0, 0.0], [1.0, 0.1], [0.0, 1.0]],
    [[0.0, 0.0], [1.2, 0.0], [0.2, 0.8]],
    [[0.0, 0.0], [0.8, -0.2], [0.0, 1.2]],
]
D = [[0.112, 0.137], [0.063, 0.171], [0.089, 0.124]]
THREE = Plant(A, B, D, 1e-3 * np.eye(3))


def dense(part, begins, plant, C, sensor, P0):
    """Mean and covariance of all outputs of a log from a sample on, the state there N(0, P0)."""
    rows, n = range(begins, part.time.size - 1), len(P0)
    count = len(rows) + 1
    mean, cov = np.zeros((count, n)), np.zeros((count, n, count, n))
    cov[0, :, 0] = P0
    for k, row in enumerate(rows):
        Phi, added = plant.period(part.time, part.input, part.mode, row)
        mean[k + 1] = Phi @ mean[k] + added
        for j in range(k + 1):
            cov[k + 1, :, j] = Phi @ cov[k, :, j]
            cov[j, :, k + 1] = cov[k + 1, :, j].T
        length = round(part.time[row + 1] - part.time[row], 13)
        own = Phi @ cov[k, :, k] @ Phi.T
        cov[k + 1, :, k + 1] = own + plant.covariance(part.mode[row], length)
    y = mean @ C.T
    cov = np.einsum("pi,aibj,qj->apbq", C, cov, C).reshape(y.size, y.size)
    return y.ravel(), cov + np.diag(np.tile(sensor**2, count))


@pytest.mark.few(3)
@pytest.mark.parametrize("order", [(2, 1), (1, 2)])
@pytest.mark.parametrize("jitter", [0.0, 0.3], ids=["even", "uneven"])
def test_the_likelihood_is_that_of_all_outputs_given_those_that_begin(order, jitter):
    count, first = 34, 5
    table = logged(THREE, OUTPUTS[order], count, 1, 3, jitter=jitter, missing=0.1)
    y, u = table[["y1", "y2"]].to_numpy().copy(), table[["u1", "u2"]].to_numpy()
    y[:first] = np.nan  # what acts before is not known
    part = Part(table["t"].to_numpy(), y, u, table["mode"].to_numpy())
    names = ("y1", "y2"), ("u1", "u2"), ("0", "1", "2")
    record = Recording((part,), H, not jitter, *names, True)
    layout, nodes = Layout(3, 3, 2, per_mode=True), nodes_for(record.parts, np.array(A))
    shape = Embedding(order, True, np.array([0.3, 0.5, 0.4]))
    theta = layout.join(1.1 * np.array(A), 0.9 * np.array(B), np.array(D) + 0.004)
    sensor, W = np.array([0.02, 0.05]), np.diag([2e-3, 1e-3, 3e-3])
    log = NoisyLog(record, layout, False, (0.05, 0.2), nodes, shape.C, shape)
    starts, vector = log.starts(0.05, 0.2), log.join(theta, NoiseLevels(W, sensor))
    begins = int(np.flatnonzero(starts[0])[-1])
    assert begins <= first
    plant = Plant(*layout.split(theta), W)
    mean, cov = dense(part, begins, plant, shape.C, sensor, log.P0)
    y = y[begins:]
    flat = y.ravel()
    known = np.isfinite(flat)
    prefix = known & (np.arange(flat.size) < _prefix(y, order))
    assert 3 <= prefix.sum() <= 8
    density: Any = multivariate_normal
    both = [density(mean[own], cov[np.ix_(own, own)]).logpdf(flat[own]) for own in (known, prefix)]
    assert log.value(vector, starts) == pytest.approx(both[0] - both[1], rel=1e-7)
    if not jitter:
        cells = np.ceil(np.array(D).ravel() / H + 0.08).astype(int)
        found = log.evaluate_in(0.05, 0.2)(cells)(vector)
        assert found.value == pytest.approx(both[0] - both[1], rel=1e-7)
        for a in log.free[:: max(1, log.free.size // 9)]:
            step = 1e-5 * np.eye(vector.size)[a]
            slope = (log.value(vector + step, starts) - log.value(vector - step, starts)) / 2e-5
            assert found.score[a] == pytest.approx(slope, rel=1e-4, abs=1e-3)


def _prefix(output, order):
    """How many places are over when each output was measured as often as it has states."""
    rows = [np.flatnonzero(np.isfinite(one))[n - 1] for one, n in zip(output.T, order, strict=True)]
    return (max(rows) + 1) * output.shape[1]


def test_position_alone_tells_the_motor_and_its_delay():
    table = logged(MOTOR, [[1.0, 0.0]], 600)
    fit = dt.identify(table, modes=None, delay=(0.0, 1.0), order=2)
    low, high = fit.interval("delay")
    assert low < 0.312 < high < low + 0.06
    assert misses(fit, MOTOR, [[1.0, 0.0]], (2,)) == ([], 3)
    assert fit.states == ("y1", "y1'")
    low, high = fit.interval("noise[0]")
    assert low < 0.003 < high
    assert fit.tests.white
    assert fit.tests.unrelated


def test_a_loop_closed_on_the_position_tells_the_motor_as_well():
    rng, t = np.random.default_rng(8), H * np.arange(400)
    x, u = MOTOR.log(t, rng.standard_normal((400, 1)), rng, feedback=np.array([[-1.5, 0.0]]))
    y = x[:, 0] + 0.003 * rng.standard_normal(400)
    table = pd.DataFrame({"t": t, "y1": y, "u1": u[:, 0]})
    fit = dt.identify(table, modes=None, delay=(0.0, 1.0), order=2, zeros=False)
    low, high = fit.interval("delay")
    assert low < 0.312 < high < low + 0.08
    assert misses(fit, MOTOR, [[1.0, 0.0]], (2,)) == ([], 3)


FIRST = Plant([[[-0.8]]], [[[1.0]]], 0.22, 1e-3 * np.eye(1))


def test_where_an_order_too_high_leaves_unknowns_open_the_error_names_a_better_one():
    table = logged(FIRST, [[1.0]], 300, 1)
    with pytest.raises(dt.ArgumentError, match=r"apart.*An order of 1 explains the log better"):
        dt.identify(table, modes=None, delay=(0.0, 1.0), order=2, zeros=True)


@pytest.mark.long
@pytest.mark.parametrize(("plant", "order"), [(FIRST, 2), (MOTOR, 3)])
def test_an_order_too_high_by_one_is_named(plant, order):
    table = logged(plant, np.eye(1, plant.A.shape[1]), 300, 1)
    try:
        said = dt.identify(table, modes=None, delay=(0.0, 1.0), order=order, zeros=False).message
    except dt.ArgumentError as error:  # where unknowns are so open that there are no intervals
        said = str(error)
    assert f"An order of {order - 1} explains the log better" in said
    assert f"say order={order - 1}, --order {order - 1}." in said


@pytest.mark.parametrize("rest", [0.0, 5.0])
def test_an_output_that_rests_elsewhere_than_at_0_has_an_operating_point(rest):
    table = logged(MOTOR, [[1.0, 0.0]], 300)
    plain = dt.identify(table, modes=None, delay=(0.0, 1.0), order=2, zeros=False)
    assert plain.operating_point is None
    table["y1"] += rest
    fit = dt.identify(table, modes=None, delay=(0.0, 1.0), order=2, zeros=False)
    assert (fit.operating_point is None) == (rest == 0.0)
    assert fit.delays == pytest.approx(plain.delays, abs=0.01)
    if fit.operating_point is not None:
        x, u = fit.operating_point.x, fit.operating_point.u
        assert x[0] - rest - u[0] / -fit.plant.A[0, 1, 0] * fit.plant.B[0, 1, 0] == pytest.approx(
            0.0, abs=0.2
        )


def test_an_order_too_low_is_told_to_be_raised():
    table = logged(MOTOR, [[1.0, 0.0]], 300)
    fit = dt.identify(table, modes=None, delay=(0.0, 1.0), order=1)
    assert not fit.tests.white
    assert "say how many each column has: order=2, --order 2)" in fit.message


def test_noise_that_is_not_told_is_less_than_where_the_likelihood_has_fallen():
    plant = Plant(MOTOR.A, MOTOR.B, 0.312, np.diag([1e-12, 1e-3]))
    table = logged(plant, [[1.0, 0.0]], 400, 1)
    fit = dt.identify(table, modes=None, delay=(0.0, 1.0), order=2, zeros=False)
    low, high = fit.interval("disturbance[0][0,0]")
    assert low == 0.0
    log, best, window = fit._estimate.log, fit._estimate.best, fit._estimate.window
    theta, fixed = best.theta.copy(), np.zeros(best.theta.size, bool)
    place = log.layout.size
    theta[place], fixed[place] = 0.5 * np.log(high), True
    fall = best.value - maximise(log, theta, fixed, window)[0].value
    assert 1.3 < fall < 3.0
    rows = {row[0]: row[1:] for row in interval_rows(fit)}
    assert rows["disturbance[0][0,0]"] == ("undetermined", "0", f"{high:.2g}")
    assert float(rows["noise[0]"][1]) > 0.0


@pytest.mark.long
def test_a_sensor_without_noise_is_said_to_have_less_than_some():
    table = logged(MOTOR, [[1.0, 0.0]], 400, 6, sensor=1e-7)
    fit = dt.identify(table, modes=None, delay=(0.0, 1.0), order=2, zeros=False)
    low, high = fit.interval("noise[0]")
    assert low == 0.0
    assert 1e-7 < high < 5e-3
    assert "Measurements are noisy: standard deviation less than " in fit.message


@pytest.mark.long
@pytest.mark.parametrize("jitter", [0.0, 0.3], ids=["even", "uneven"])
def test_three_modes_two_inputs_six_delays_and_missing_measurements(jitter):
    count = 900 if not jitter else 400
    C = OUTPUTS[2, 1]
    table = logged(THREE, C, count, 3, 3, jitter=jitter, missing=0.05)
    fit = dt.identify(table, delay=(0.0, 0.3), order=(2, 1), per_mode=True, switches="samples")
    wrong, names = misses(fit, THREE, C, (2, 1))
    assert names == 30
    assert len(wrong) <= 5
    off = np.abs(fit.delays - THREE.D)
    assert (off < 0.75 * np.diff(fit.delay_interval)[..., 0]).all()


@pytest.mark.long
def test_a_log_without_noise_gives_the_plant_to_many_digits():
    plant = Plant(MOTOR.A, MOTOR.B, 0.23)
    table = logged(plant, [[1.0, 0.0]], 200, sensor=0.0)
    fit = dt.identify(table, modes=None, delay=(0.0, 1.0), order=2)
    np.testing.assert_allclose(fit.plant.A, plant.A, atol=1e-6)
    assert fit.delays.item() == pytest.approx(0.23, abs=1e-6)


@pytest.mark.long
def test_the_file_has_an_observer_and_its_loop_is_proved(tmp_path):
    two = Plant(
        [[[0.0, 1.0], [-2.0, -1.0]], [[0.0, 1.0], [-3.0, -0.5]]],
        [[[0.0], [1.0]], [[0.0], [1.2]]],
        0.212,
        1e-3 * np.eye(2),
    )
    table = logged(two, [[1.0, 0.0]], 600, 4, 2)
    fit = dt.identify(table, delay=(0.0, 0.5), order=2, zeros=False, switches="samples")
    fit.save(tmp_path / "motor.toml")
    problem = load_problem(tmp_path / "motor.toml")
    law = problem.law("averaged")
    assert isinstance(law, dt.OutputFeedback)
    assert law.observer.C[0].tolist() == [[1.0, 0.0]]
    assert dt.certify(fit.plant, law, dwell_time=1.0, step=H).stable
    run = dt.simulate(fit.plant, law, problem.signal, problem.x0, 5.0, step=H)
    assert np.abs(run.estimates - run.states)[:, -1].max() < 0.05
    assert problem.law("belief").outputs is not None
    assert len(fit.uncertain.axes()) == 6
    assert "decay in every mode" in fit.verdict(dt.delay_margin(fit.plant, law, H), law)
    assert len(fit.plot().axes) == 5


def test_a_noise_that_begins_as_nothing_is_found():
    def likelihood(log_of_noise):
        """Of 50 measurements of variance 1, noise of a sensor 0.1, at its largest where v = 0.9."""
        v = float(np.exp(2.0 * log_of_noise[0]))
        s = v + 0.1
        score, F = 50.0 * v * (1.0 / s - 1.0) / s, 100.0 * (v / s) ** 2
        return Evaluation(-25.0 * (np.log(s) + 1.0 / s), np.array([score]), np.array([[F]]))

    bounds = np.array([-15.0]), np.array([-16.0]), np.array([14.0])
    assert climb(likelihood, *bounds, stride=lambda _: np.array([1.5])).theta[0] == pytest.approx(
        0.5 * np.log(0.9)
    )
    assert climb(likelihood, *bounds).theta[0] < -5.0


def test_a_noise_that_is_not_there_is_left_in_a_few_steps():
    """L of W = L Lᵀ where W of 0 is likeliest: log L = −5 trace W, and the information on L is
    that on W, 4 L², which is nothing of the curvature −10 at L = 0."""
    asked = []

    def likelihood(L):
        asked.append(L)
        F = np.diag(4.0 * L**2)
        return Evaluation(float(-5.0 * (L**2).sum()), -10.0 * L, F)

    bounds = np.array([1e-2, -3e-3]), np.full(2, -np.inf), np.full(2, np.inf)
    found = climb(likelihood, *bounds, stride=np.abs)
    assert np.abs(found.theta).max() < 1e-5
    assert len(asked) < 10, len(asked)


TABLE = logged(MOTOR, [[1.0, 0.0]], 60)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"order": 0}, "order must be how many states each output has"),
        ({"order": (2, 2)}, "order must have a number for each output, 1 (y1), got 2"),
        ({"order": 2, "C": [[1.0]]}, "C must be left out beside order"),
        ({"order": 2, "noise": False}, "noise must not be False with order"),
        ({"order": 2, "modes": 2}, "modes must be logged where order is given"),
        ({"zeros": True, "states": ["y1"]}, "zeros is of outputs alone: give order"),
        ({"outputs": ["y1"]}, "outputs needs order"),
        ({"C": [[1.0, 0.0]]}, "C must have rank n = 2, got 1"),
        ({"C": [[1.0, 0.0]]}, "order=2 takes it and its derivative"),
        ({"order": 12}, "periods whose inputs and ends are known, at least 29 are needed"),
        ({"order": 2, "outputs": ["t2"]}, "log must have the column 't2'"),
    ],
)
def test_what_outputs_cannot_be_asked_is_refused_by_name(given, message):
    table = TABLE.head(50)
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        dt.identify(table, **{"modes": None, "delay": (0.0, 1.5), **given})


def test_an_output_that_never_moves_is_refused():
    with pytest.raises(dt.ArgumentError, match="y2 must move"):
        dt.identify(TABLE.assign(y2=1.0), modes=None, order=(2, 1))


def test_the_command_line_takes_the_order_and_the_outputs(tmp_path, capsys):
    table = logged(MOTOR, [[1.0, 0.0]], 300).rename(columns={"y1": "position"})
    table.to_csv(tmp_path / "log.csv", index=False)
    given = ["--order", "2", "--outputs", "position", "--one-mode", "--delay", "0", "1"]
    given += ["--no-zeros"]
    out = ["--out", str(tmp_path / "p.toml"), "--report", str(tmp_path / "p.html")]
    with pytest.raises(SystemExit) as stopped:
        main(["identify", str(tmp_path / "log.csv"), *given, *out])
    assert stopped.value.code == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "The states are position with its derivative." in printed
    assert load_problem(tmp_path / "p.toml").plant.states == 2
    assert "A[0][1,0]" in (tmp_path / "p.html").read_text(encoding="utf-8")
