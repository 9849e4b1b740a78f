"""`Controller.prediction`: the state that the input of now will meet."""

import copy

import numpy as np
import pytest
from scipy.linalg import expm

import belief_laws
import deadtime as dt
import plants
from deadtime.feedback.prediction_rows import prediction_table
from predictions import GENERIC, OWN, SEMI, STEP, K, past_of, served

PREDICTING = [name for name in plants.LAWS if name not in ("exact", "delayed")]


def stepped(plant, mode, gains, x, past, target, step=STEP):
    """x(t + D) of an input with one mode held, from arrival to arrival, by SciPy's exponential.

    An input that arrives is the one sent a delay ago: from the past, or, from t on, K x of then.
    """
    delays = plant.delays[mode]
    count, m = len(past), plant.inputs
    arrivals = sorted(
        (round(delays[j] + k * step, 12), j, k) for j in range(m) for k in range(-count, count)
    )
    now, u = 0.0, np.zeros(m)
    for time, j, k in arrivals:
        if time > now:
            Phi, Gamma = plants.held(plant.A[mode], plant.B[mode], time - now)
            x, now = Phi @ x + Gamma @ u, time
        if k == 0 and j == target:
            return x
        u[j] = past[-k - 1][j] if k < 0 else gains[mode, j] @ x
    raise AssertionError


@pytest.mark.parametrize("plant", [GENERIC, OWN], ids=["one delay", "delays of their own"])
def test_each_mode_is_predicted_as_the_plant_moves_under_the_inputs_in_flight(plant):
    controller, x = served(dt.AveragedPredictor(plant, K, [0.2, 0.3, 0.5]))
    prediction = controller.prediction
    for mode in range(3):
        for j in range(2):
            want = stepped(plant, mode, K, x, past_of(controller.law), j)
            plants.close(prediction.by_mode[j, mode], want, 1e-12)
    assert np.array_equal(prediction.horizons, plant.delays.T)
    assert np.allclose(prediction.probabilities, [[0.2, 0.3, 0.5]] * 2, rtol=1e-14)
    whole = np.einsum("ji,jia->ja", prediction.probabilities, prediction.by_mode)
    plants.close(prediction.states, whole, 1e-13)


@pytest.mark.few(4)
@pytest.mark.parametrize("plant", [GENERIC, OWN], ids=["one delay", "delays of their own"])
@pytest.mark.parametrize("name", [*PREDICTING, "semi-Markov"])
def test_gains_times_predictions_are_the_input_of_every_law(name, plant):
    if name == "semi-Markov":
        law = dt.ExpectedPredictor(plant, K, SEMI)
    else:
        law = plants.LAWS[name](GENERIC)
        inner = getattr(law, "law", law)
        gain = inner.gain[None] if "mean" in name else inner.gains
        law = inner.extend(plant, gain[:, :0])  # the law itself, of this plant
        assert type(law) is type(inner)
    controller, _ = served(law)
    found, gains = controller.prediction, law.gain[None] if "mean" in name else K
    parts = np.einsum("ji,ija,jia->j", found.probabilities, gains, np.nan_to_num(found.by_mode))
    plants.close(parts, controller._command, 1e-12)
    assert np.allclose(found.probabilities.sum(axis=1), 1.0, rtol=1e-12)


def test_a_low_pass_law_predicts_what_the_law_that_it_filters_does():
    plain = plants.LAWS["averaged"](GENERIC)
    one, _ = served(plain)
    other, _ = served(dt.LowPassPredictor(plain, 0.3))
    assert np.array_equal(one.prediction.by_mode, other.prediction.by_mode)


def test_a_low_pass_law_with_delays_of_their_own_has_no_prediction():
    controller, _ = served(dt.LowPassPredictor(dt.AveragedPredictor(OWN, K), 0.3))
    with pytest.raises(dt.ArgumentError, match="of a LowPassPredictor needs one delay"):
        _ = controller.prediction


def test_the_oracle_predicts_where_a_run_arrives():
    signal = plants.off_grid(end=9.0)
    law = dt.ExactPredictor(GENERIC, K, signal)
    run = dt.simulate(GENERIC, law, signal, [1, -1, 0.5], 2.0, step=STEP)
    table = prediction_table(law, STEP, signal, 15)
    times = np.arange(16) * STEP + GENERIC.delay
    there = dt.simulate(GENERIC, law, signal, [1, -1, 0.5], 2.0, step=STEP, times=times)
    past = run.inputs.T
    for k in range(3, 15):
        moved = table.state[k, 0] @ run.states[:, k] + table.input[k, 0] @ past[k - 3 : k].ravel()
        plants.close(moved.sum(axis=0), there.states[:, k], 1e-11)
        assert table.probability[k, 0].tolist() == np.eye(3)[signal(k * STEP + 0.234)].tolist()


def test_a_forecast_of_switches_ends_in_each_mode_as_its_rates_say():
    model = plants.markov(3)
    controller, x = served(dt.ExpectedPredictor(GENERIC, K, model))
    found, mode = controller.prediction, 8 // 4 % 3
    assert np.allclose(found.probabilities, expm(0.234 * model.generator)[mode], rtol=1e-12)
    # E[x 1{σ = i}] and p u obey one linear equation from arrival to arrival.
    X, p, past = np.eye(3)[mode][:, None] * x, np.eye(3)[mode], past_of(controller.law)
    for length, lag in ((0.034, 3), (0.1, 2), (0.1, 1)):
        joint = np.zeros((12, 12))
        for i in range(3):
            joint[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = GENERIC.A[i]
            joint[3 * i : 3 * i + 3, 9 + i] = GENERIC.B[i] @ past[lag - 1]
        joint[:9, :9] += np.kron(model.generator.T, np.eye(3))
        joint[9:, 9:] = model.generator.T
        moved = expm(joint * length) @ np.concatenate((X.ravel(), p))
        X, p = moved[:9].reshape(3, 3), moved[9:]
    plants.close(found.by_mode[0], X / p[:, None], 1e-12)


def test_a_belief_predicts_as_it_weighs_the_modes_now():
    law = belief_laws.LAWS["ages"]()
    controller, x = served(law, law.filter.step)
    found, table = controller.prediction, prediction_table(law.law, law.filter.step)
    past = controller._past.recent.ravel()
    p, moved = np.zeros((2, 3)), np.zeros((2, 3, 3))
    for row, share in enumerate(controller.mode_belief.running.state.weight):
        for j in range(2):
            at = row, table.of_input[j]
            p[j] += share * table.probability[at]
            moved[j] += share * (table.state[at] @ x + table.input[at] @ past)
    plants.close(found.by_mode, moved / p[..., None], 1e-12)
    gained = np.einsum("ji,ija,jia->j", found.probabilities, K, found.by_mode)
    plants.close(gained, controller._command, 1e-12)


def test_a_bank_predicts_each_mode_from_its_own_estimate():
    controller, _ = served(belief_laws.from_outputs(), belief_laws.STEP)
    found = controller.prediction
    gained = np.einsum("ji,ija,jia->j", found.probabilities, belief_laws.GAINS, found.by_mode)
    plants.close(gained, controller._command, 1e-12)


def test_a_servo_predicts_the_states_that_its_law_is_given():
    paper = plants.paper(0.25)
    servo = dt.Servo(paper, C=[[1.0, 0.0]])
    gains = servo.lqr(np.eye(3), [[1.0]], step=STEP)
    law = dt.AveragedPredictor(servo.plant, gains, allow_unstable=True)
    observer = dt.luenberger(servo.model, servo.C, [-4.0, -5.0], step=STEP)
    controller = dt.Controller(dt.OutputFeedback(law, observer, servo=servo), STEP)
    for y in (1.0, 1.1, 1.3):
        controller.update([y], 0)
    found = controller.prediction
    parts = np.einsum("i,iab,ib->a", found.probabilities[0], gains, found.by_mode[0])
    plants.close(parts, controller._command, 1e-12)
    with pytest.raises(dt.ArgumentError, match="covariance of a servo's prediction is not known"):
        found.covariance(1.0, 1.0)


def test_inputs_count_as_applied_and_the_one_of_now_does_not():
    law, x = plants.LAWS["averaged"](GENERIC), np.array([1.0, -1.0, 0.5])
    controller = dt.Controller(law, STEP, limits=(-0.1, 0.1), u0=[0.05, 0.05])
    controller.update(x)
    past = [np.full(2, 0.05)] * 3
    plants.close(controller.prediction.by_mode[0, 1], stepped(GENERIC, 1, K, x, past, 0), 1e-12)
    controller.update(x, applied=[0.3, -0.2])
    past = [np.array([0.3, -0.2]), *past[:2]]
    plants.close(controller.prediction.by_mode[0, 1], stepped(GENERIC, 1, K, x, past, 0), 1e-12)


def test_a_long_window_is_read_from_the_ring_of_a_factorised_law():
    law = dt.AveragedPredictor(GENERIC, K)
    controller, x = served(law, 0.234 / 50, samples=80)
    assert "Factored" in type(controller._past).__name__
    past = past_of(law, 80)
    want = stepped(GENERIC, 2, K, x, past, 0, 0.234 / 50)
    plants.close(controller.prediction.by_mode[0, 2], want, 1e-12)


def test_a_call_out_of_order_leaves_the_prediction_of_the_sample_that_was_served():
    controller = dt.Controller(plants.LAWS["averaged"](GENERIC), STEP)
    controller.update([1.0, 0.0, 0.0], time=0.0)
    before = controller.prediction.states
    controller.update([5.0, 0.0, 0.0], time=0.0)
    assert controller.status.name == "OUT_OF_ORDER"
    assert np.array_equal(controller.prediction.states, before)


def test_who_does_not_ask_pays_for_no_tables():
    controller, _ = served(plants.LAWS["averaged"](GENERIC))
    assert "prediction_table" not in vars(controller)
    assert controller.prediction.states.shape == (2, 3)
    assert "prediction_table" in vars(controller)


def test_a_prediction_reads_like_one():
    assert repr(served(dt.AveragedPredictor(OWN, K))[0].prediction).count(" to ") == 2
    one = repr(served(dt.SingleModePredictor(GENERIC, K, 1))[0].prediction)
    assert one.endswith("in 0.234 s, modes 0 %, 100 %, 0 %)")
    assert one.count("[") == 1
    copied = copy.deepcopy(served(dt.SingleModePredictor(GENERIC, K, 1))[0].prediction)
    assert repr(copied) == one


LAW = dt.ExpectedPredictor(GENERIC, K, plants.markov(3))
HUGE = np.array([1.7e308, -1.7e308, 1.7e308])


def told(law, *calls):
    """A controller after calls of (x, mode)."""
    controller = dt.Controller(law, STEP)
    for x, mode in calls:
        controller.update(x, mode)
    return controller


@pytest.mark.parametrize(
    ("controller", "message"),
    [
        (lambda: told(LAW), "needs a sample: call update first"),
        (lambda: told(LAW, ([np.nan, 0, 0], 0)), "needs the state of the last sample"),
        (
            lambda: told(LAW, ([0, 0, 0], 7)),
            "needs the mode: no mode of the plant has been reported",
        ),
        (lambda: told(plants.LAWS["averaged"](GENERIC), (HUGE, 0)), "is beyond what floats hold"),
        (
            lambda: told(plants.LAWS["delayed"](GENERIC), ([0, 0, 0], 0)),
            r"DelayedStateFeedback \(delay ignored\) has no forecast of its own",
        ),
    ],
)
def test_where_there_is_nothing_to_predict_from_the_reason_is_named(controller, message):
    with pytest.raises(dt.ArgumentError, match=message):
        _ = controller().prediction


def test_after_a_restore_the_next_sample_is_waited_for():
    controller, _ = served(plants.LAWS["averaged"](GENERIC))
    controller.restore(controller.state)
    with pytest.raises(dt.ArgumentError, match="after `reset` and `restore` too"):
        _ = controller.prediction
