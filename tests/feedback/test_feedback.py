"""The table: which row applies, its factorisation, its shapes."""

import re

import numpy as np
import pytest

import deadtime as dt
import plants

FACTORED = ["averaged", "weighted", "single", "mean"]
MODES = np.array([1, 1, 1, 1, 0, 0, 2, 0, 0, 0, 0, 0])


def table(context, contexts=3, ages=1):
    return dt.Feedback(
        np.zeros((contexts, 2, 3)), np.zeros((contexts, 4, 2, 2)), context, 0.1, ages
    )


@pytest.mark.parametrize(
    ("context", "ages", "rows"),
    [
        ("none", 1, [0] * 12),
        ("mode", 1, MODES),
        ("step", 1, range(12)),
        ("mode_age", 1, MODES),
        ("mode_age", 3, [3, 4, 5, 5, 0, 1, 6, 0, 1, 2, 2, 2]),
        ("mode_age", 100, [100, 101, 102, 103, 0, 1, 200, 0, 1, 2, 3, 4]),
    ],
)
def test_the_context_selects_the_row(context, ages, rows):
    chosen = table(context, 12, ages).rows(MODES)
    assert chosen.tolist() == list(rows)
    assert chosen.dtype == np.int64


@pytest.mark.parametrize("context", ["none", "mode", "step", "mode_age"])
def test_the_rows_of_a_sample_do_not_depend_on_later_samples(context):
    feedback = table(context, 9, 3)
    whole = feedback.rows(MODES)
    for k in range(1, MODES.size):
        assert np.array_equal(feedback.rows(MODES[:k]), whole[:k])


@pytest.mark.parametrize("name", FACTORED)
@pytest.mark.parametrize("delay", [0.234, 0.3, 0.05, 1.77])
def test_the_factorisation_is_the_dense_taps(name, delay):
    feedback = plants.LAWS[name](plants.generic(delay)).digital(0.1)
    assert feedback.factor is not None
    taps = feedback.factor.taps(feedback.taps)
    assert taps.shape == feedback.input_gain.shape == (1, int(np.ceil(round(delay / 0.1, 9))), 2, 2)
    for j in range(feedback.taps):
        plants.close(taps[:, j], feedback.input_gain[:, j], 1e-12)


def test_the_factorisation_has_order_n_per_mode_that_the_law_averages():
    plant = plants.generic()
    orders = {name: plants.LAWS[name](plant).digital(0.1).factor.S.shape for name in FACTORED}
    assert orders == {"averaged": (9, 9), "weighted": (9, 9), "single": (3, 3), "mean": (3, 3)}


def test_factor_taps_follow_their_formula():
    rng = np.random.default_rng(0)
    H, S, G, last = (rng.normal(size=s) for s in [(3, 2, 4), (4, 4), (4, 2), (3, 2, 2)])
    taps = dt.Factor(H, S, G, last).taps(5)
    for j in range(1, 5):
        plants.close(taps[:, j - 1], H @ np.linalg.matrix_power(S, j - 1) @ G, 1e-14)
    assert np.array_equal(taps[:, 4], last)
    assert np.array_equal(dt.Factor(H, S, G, last).taps(1)[:, 0], last)


def test_every_array_of_a_table_is_read_only():
    feedback = plants.LAWS["averaged"](plants.generic()).digital(0.1)
    for array in (feedback.state_gain, feedback.input_gain, *feedback.factor):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0
    with pytest.raises(AttributeError):
        feedback.step = 1.0


def test_the_repr_says_what_the_table_is():
    assert repr(table("mode")) == (
        "Feedback(context='mode', rows=3, taps=4, inputs=2, step=0.1, dense)"
    )
    assert repr(plants.LAWS["single"](plants.generic()).digital(0.1)) == (
        "Feedback(context='none', rows=1, taps=3, inputs=2, step=0.1, factored)"
    )


@pytest.mark.parametrize("shape", [(2, 4, 2, 2), (3, 4, 1, 2), (3, 4, 2, 1), (3, 4, 2)])
def test_a_table_of_taps_that_does_not_fit_is_refused(shape):
    message = f"input_gain must have shape (contexts, N, m, m) = (3, N, 2, 2), got {shape}."
    unchecked = object.__new__(dt.Feedback)  # the shape checks of the test run would come first
    vars(unchecked).update(state_gain=np.zeros((3, 2, 3)), input_gain=np.zeros(shape), factor=None)
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        unchecked.__post_init__()


@pytest.mark.parametrize(
    ("age", "rows"), [(0, [0, 1, 2, 3]), (1, [1, 2, 2, 3]), (10**30, [2, 2, 2, 3])]
)
def test_the_age_at_the_start_counts_until_the_first_switch(age, rows):
    table = dt.Feedback(np.zeros((6, 1, 1)), np.zeros((6, 1, 1, 1)), "mode_age", 0.1, ages=3)
    assert table.rows(np.array([0, 0, 0, 1]), age).tolist() == rows
