"""The plant: what it holds, and what it refuses."""

import re
import subprocess
import sys

import control
import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.base.checks import number, positive

A = [[[2.0, 1.0], [0.0, 1.0]], [[2.3, 1.1], [0.05, 1.2]]]
B = [[[0.0], [1.0]], [[0.0], [1.02]]]


def test_sizes_are_read_off_the_matrices():
    plant = plants.generic()
    assert (plant.modes, plant.states, plant.inputs, plant.delay) == (3, 3, 2, 0.234)
    assert repr(plant) == "SwitchedSystem(modes=3, states=3, inputs=2, delay=0.234)"


def test_integer_lists_become_float_arrays():
    plant = dt.SwitchedSystem([[[0]]], [[[1]]], 1.0)
    assert plant.A.dtype == plant.B.dtype == np.float64


def test_the_plant_is_immutable_and_keeps_its_own_copy():
    given = np.array(A)
    plant = dt.SwitchedSystem(given, B, 1.0)
    given[0, 0, 0] = 99.0
    assert plant.A[0, 0, 0] == 2.0
    assert given.flags.writeable
    for array in (plant.A, plant.B):
        assert array.flags.c_contiguous
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0, 0] = 1.0
    with pytest.raises(AttributeError):
        plant.delay = 2.0


def test_mean_is_the_element_wise_mean_with_the_same_delay():
    mean = plants.paper().mean()
    plants.close(mean.A, [[[2.15, 1.05], [0.025, 1.1]]], 1e-15)
    plants.close(mean.B, [[[0.0], [1.01]]], 1e-15)
    assert (mean.modes, mean.delay) == (1, 1.0)


def test_modes_move_apart_from_mode_0_in_proportion():
    plant = dt.SwitchedSystem([[[1.0]], [[2.0]], [[0.5]]], [[[1.0]], [[1.5]], [[1.0]]], 0.3)
    far = plant.apart(2.0)
    np.testing.assert_array_equal(far.A.ravel(), [1.0, 3.0, 0.0])
    np.testing.assert_array_equal(far.B.ravel(), [1.0, 2.0, 1.0])
    assert far.delay == 0.3
    np.testing.assert_array_equal(plant.apart(1.0).A, plant.A)
    np.testing.assert_array_equal(plant.apart(0.0).A, plant.A[[0, 0, 0]])


@pytest.mark.parametrize("alpha", [-0.5, np.inf, np.nan])
def test_modes_move_apart_by_a_factor_that_is_no_negative_one(alpha):
    with pytest.raises(dt.ArgumentError, match="alpha must be ≥ 0 and finite"):
        dt.SwitchedSystem([[[1.0]], [[2.0]]], [[[1.0]], [[1.0]]], 0.3).apart(alpha)


def test_from_statespace_keeps_every_matrix():
    systems = [control.ss(a, b, np.eye(2), 0) for a, b in zip(A, B, strict=True)]
    plant = dt.SwitchedSystem.from_statespace(systems, 0.5)
    assert np.array_equal(plant.A, A)
    assert np.array_equal(plant.B, B)
    assert plant.delay == 0.5


def test_from_statespace_refuses_sampled_systems():
    sampled = control.ss(A[0], B[0], np.eye(2), 0, 0.1)
    with pytest.raises(
        dt.ArgumentError, match=r"systems\[1\] must be in continuous time, got dt = 0.1"
    ):
        dt.SwitchedSystem.from_statespace([control.ss(A[0], B[0], np.eye(2), 0), sampled], 1.0)


def test_from_statespace_refuses_systems_of_different_sizes():
    systems = [control.ss(A[0], B[0], np.eye(2), 0), control.ss([[1.0]], [[1.0]], [[1.0]], 0)]
    with pytest.raises(dt.ArgumentError, match=r"same numbers .* got .* = \[\(1, 1\), \(2, 1\)\]"):
        dt.SwitchedSystem.from_statespace(systems, 1.0)
    with pytest.raises(dt.ArgumentError, match=r"one or more models .* got .* = \[\]"):
        dt.SwitchedSystem.from_statespace([], 1.0)


@pytest.mark.parametrize(
    ("a", "b", "delay", "message"),
    [
        (A[0], B, 1.0, "A must have shape (modes, n, n), got (2, 2): stack one matrix per mode"),
        (A, [0.0, 1.0], 1.0, "B must have shape (modes, n, m), got (2,): stack one matrix"),
        (
            A,
            [[0, 1], [0, 1.02]],
            1.0,
            "B must have shape (modes, n, m), got (2, 2): stack one matrix per mode",
        ),
        (
            [[[1.0, 2.0]]],
            [[[1.0]]],
            1.0,
            "A must have shape (modes, n, n) = (1, 1, 1), got (1, 1, 2).",
        ),
        (A, B[:1], 1.0, "B must have shape (modes, n, m) = (2, 2, 1), got (1, 2, 1)."),
        (
            A,
            [[[0.0, 1.0]]] * 2,
            1.0,
            "B must have shape (modes, n, m) = (2, 2, 1), got (2, 1, 2): pass the transpose.",
        ),
        ([A[0], [[1.0]]], B, 1.0, "A must have shape (modes, n, n), got rows of different lengths"),
        ([[["x"]]], [[[1.0]]], 1.0, "A must hold real numbers, got an array of <U1."),
        ([[[1j]]], [[[1.0]]], 1.0, "A must hold real numbers, got an array of complex128."),
        (
            np.zeros((0, 2, 2)),
            B,
            1.0,
            "A must have shape (modes, n, n), got the empty shape (0, 2, 2).",
        ),
        ([A[0], [[1.0, np.nan], [0, 1]]], B, 1.0, "A[1, 0, 1] must be finite, got nan."),
        (A, [B[0], [[0.0], [np.inf]]], 1.0, "B[1, 1, 0] must be finite, got inf."),
        (A, B, 0.0, "delay must be positive, in s, got 0."),
        (A, B, -1.0, "delay must be positive, in s, got -1."),
        (A, B, np.inf, "delay must be finite, got inf."),
        (A, B, np.nan, "delay must be finite, got nan."),
    ],
)
def test_a_malformed_plant_is_refused_by_name(a, b, delay, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        dt.SwitchedSystem(a, b, delay)


def test_errors_are_value_errors_of_the_package():
    assert issubclass(dt.ArgumentError, ValueError)
    assert issubclass(dt.ArgumentError, dt.DeadtimeError)
    assert issubclass(dt.ProblemFileError, dt.ArgumentError)


def test_from_statespace_refuses_what_is_no_state_space():
    with pytest.raises(dt.ArgumentError, match=r"systems\[0\] must be a StateSpace, got float"):
        dt.SwitchedSystem.from_statespace([1.0], delay=1.0)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("1", "delay must be a number, got '1', a str: pass it without quotes"),
        (b"1", "delay must be a number, got b'1', a bytes: pass it without quotes"),
        (np.array("1")[()], "delay must be a number, got np.str_('1'), a str_: pass it without"),
        (None, "delay must be a number, got None, a NoneType."),
        ([1.0, 2.0], "delay must be a number, got [1.0, 2.0], a list."),
    ],
)
def test_what_is_no_number_is_refused_by_name_and_kind(value, message):
    for check in (number, positive):
        with pytest.raises(dt.ArgumentError, match=re.escape(message)):
            check("delay", value)


def test_a_delay_in_quotes_is_refused_where_nothing_checks_annotations():
    source = "import deadtime as dt; dt.SwitchedSystem([[[0.0]]], [[[1.0]]], '1')"
    run = subprocess.run(
        [sys.executable, "-c", source], capture_output=True, text=True, check=False
    )
    assert "ArgumentError: delay must be a number, got '1', a str" in run.stderr
