"""Loops of which a part keeps its value: a named answer, and a plant that can be certified."""

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.certificates.reach import why_unmoved
from deadtime.plant.plant_set import Polytope

STEP = 0.1
SCALAR = plants.scalar([0.0, 0.5])
CART = dt.SwitchedSystem(
    [[[0.0, 1.0], [0.0, -1.0]], [[0.0, 1.0], [0.0, -2.0]]], [[[0.0], [1.0]]] * 2, 0.2
)
SERVOS = {
    "integrator": (SCALAR, [[1.0]], [-1.0, -2.0], {}),
    "disturbance": (SCALAR, [[1.0]], [-1.0, -2.0], {"disturbance": [[1.0]]}),
    "cart": (CART, [[1.0, 0.0]], [-1.0, -2.0, -3.0], {}),
    "no sum": (CART, [[1.0, 0.0]], [-1.0, -2.0], {"integral": False}),
    "one mode": (dt.SwitchedSystem([[[0.0]]], [[[1.0]]], 0.3), [[1.0]], [-1.0, -2.0], {}),
}


@pytest.mark.parametrize("name", SERVOS)
@pytest.mark.parametrize("options", [{}, {"maximum_dwell": 2.0}], ids=["", "maximum"])
def test_a_servo_s_plant_is_answered_by_name(name, options):
    plant, C, poles, more = SERVOS[name]
    servo = dt.Servo(plant, C, **more)
    law = dt.AveragedPredictor(servo.plant, servo.place(poles, STEP), allow_unstable=True)
    answer = dt.certify(servo.plant, law, 0.6, STEP, **options)
    constants = [f"x[{i}]" for i in range(servo.plant.states) if i not in servo.moving]
    assert answer.stable is None
    assert f"{' and '.join(constants)} of the plant keeps its value" in answer.message
    assert "servo.driven" in answer.message


def test_what_moves_of_a_servo_is_certified_as_the_message_says():
    servo = dt.Servo(SCALAR, [[1.0]])
    K = servo.place([-1.0, -2.0], STEP)
    whole = dt.AveragedPredictor(servo.plant, K, allow_unstable=True)
    law = dt.AveragedPredictor(servo.driven, K[:, :, servo.moving])
    assert dt.certify(servo.driven, law, 1.0, STEP).stable
    # The same rows: the reference and the disturbance at 0.
    mine, its = law.digital(STEP), whole.digital(STEP)
    assert its.state_gain[:, :, servo.moving] == pytest.approx(mine.state_gain, rel=1e-12)
    assert its.input_gain == pytest.approx(mine.input_gain, rel=1e-12)


def test_a_combination_of_states_that_keeps_its_value_is_found_in_any_coordinates():
    servo = dt.Servo(CART, [[1.0, 0.0]])
    T = np.linalg.qr(np.random.default_rng(0).normal(size=(4, 4)))[0]
    plant = dt.SwitchedSystem(T @ servo.plant.A @ T.T, T @ servo.plant.B, CART.delay)
    gains = servo.place([-1.0, -2.0, -3.0], STEP) @ T.T
    law = dt.AveragedPredictor(plant, gains, allow_unstable=True)
    message = dt.certify(plant, law, 0.6, STEP).message
    assert "a combination of the plant's states keeps its value" in message


@pytest.mark.parametrize(
    ("A", "B", "gain"),
    [
        (np.zeros((2, 2)), [[1.0], [2.0]], np.zeros((1, 2))),
        ([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], np.zeros((1, 2))),
        ([[0.0, 0.0], [0.0, -1.0]], [[1.0], [1.0]], [[0.0, -0.1]]),
        ([[-1.0, 1.0], [0.0, -1.0]], [[0.0], [0.0]], np.zeros((1, 2))),
        (np.zeros((2, 2)), [[0.0], [0.0]], np.zeros((1, 2))),
    ],
    ids=["rank one", "double integrator", "one integrator", "repeated, no input", "nothing"],
)
def test_singular_plants_get_an_answer_or_a_reason(A, B, gain):
    plant = dt.SwitchedSystem([A, A], [B, B], 0.2)
    law = dt.DelayedStateFeedback(plant, [gain, gain], allow_unstable=True)
    answer = dt.certify(plant, law, 0.5, STEP, search_signals=False)
    decays = np.linalg.eigvals(plant.A[0]).real.max() < 0.0
    assert answer.stable is (True if decays else None)
    assert decays or "neither grows nor decays" in answer.message or "keep" in answer.message


def test_the_least_dwell_time_of_a_servo_s_plant_is_none_with_a_reason():
    servo = dt.Servo(SCALAR, [[1.0]])
    law = dt.AveragedPredictor(servo.plant, servo.place([-1.0, -2.0], STEP), allow_unstable=True)
    found = dt.least_dwell_time(servo.plant, law, STEP)
    assert found.certified is None
    assert "keeps its value" in found.message


@pytest.mark.parametrize("size", [1e-170, 1e160])
def test_states_in_whatever_units_move(size):
    plant = dt.SwitchedSystem(CART.A * size, CART.B * size, 0.2 / size)
    assert why_unmoved(Polytope.of([plant])) == ""
