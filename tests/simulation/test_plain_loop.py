"""The loop over lists gives the bits of the kernel, as Python and compiled."""

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.imperfections import Noise, Saturation
from deadtime.simulation import digital_kernel, record_kernel

SIGNAL = dt.SwitchingSignal([0.0, 0.33, 0.71, 1.4], [0, 1, 0, 1])


def runs_of(monkeypatch, plant, law, x0, **options):
    """One run by each of the three ways: lists or what stands for them, arrays, compiled."""
    loop = digital_kernel.closed_loop
    found, taken = [], []

    def bare(*run):
        taken.append(True)
        return bare_loop(*run)

    bare_loop = digital_kernel.bare_loop
    monkeypatch.setattr(digital_kernel, "bare_loop", bare)
    for way in (loop.plain, loop.function, loop.dispatcher):
        monkeypatch.setattr(loop, "_ready", way)
        run = dt.simulate(plant, law, SIGNAL, x0, 3.0, **options)
        found.append((run.states, run.inputs, run.record.path, run.diverged, run.end))
    return found, bool(taken)


def assert_equal_bits(found):
    for other in found[1:]:
        for one, two in zip(found[0], other, strict=True):
            assert np.asarray(one).tobytes() == np.asarray(two).tobytes()


@pytest.mark.parametrize("delay", [0.2, 0.234, 0.01, [[0.2, 0.13], [0.31, 0.2]]])
def test_lists_give_the_bits_of_arrays_and_of_compiled_code(monkeypatch, delay):
    rng = np.random.default_rng(3)
    A, B = rng.normal(size=(2, 3, 3)), rng.normal(size=(2, 3, 2))
    plant = dt.SwitchedSystem(A, B, delay)
    gains = dt.place(plant, [-1.0, -1.5, -2.0])
    for law in (dt.AveragedPredictor(plant, gains), dt.DelayedStateFeedback(plant, gains)):
        found, bare = runs_of(monkeypatch, plant, law, [1.0, -1.0, 0.5], step=0.05)
        assert_equal_bits(found)
        assert bare


def test_a_run_that_diverges_ends_at_the_same_sample(monkeypatch):
    plant = dt.SwitchedSystem([[[200.0]], [[300.0]]], [[[1.0]], [[1.0]]], delay=0.1)
    law = dt.DelayedStateFeedback(plant, np.full((2, 1, 1), -1.0), allow_unstable=True)
    found, bare = runs_of(monkeypatch, plant, law, [-1.0], step=0.1)
    assert_equal_bits(found)
    assert bare
    assert found[0][3]


@pytest.mark.parametrize("imperfection", [Noise(0.1), Saturation(-0.1, 0.1)])
def test_a_run_of_which_more_is_asked_goes_by_arrays(monkeypatch, imperfection):
    plant = plants.paper()
    law = dt.AveragedPredictor(plant, dt.problems.paper().gains)
    options = {"step": 0.05, "imperfections": [imperfection]}
    found, bare = runs_of(monkeypatch, plant, law, [-1.0, 1.0], **options)
    assert_equal_bits(found)
    assert not bare


def test_integrals_have_the_bits_of_the_kernel():
    form = record_kernel.form_integral
    rng = np.random.default_rng(4)
    for n, m in ((1, 1), (2, 1), (3, 2), (5, 4)):
        M, entry = rng.normal(size=(6, n + m, n + m)), rng.integers(0, 6, 50)
        path, acting = rng.normal(size=(51, n)), rng.normal(size=(50, m))
        for pieces in (0, 1, 50):
            args = M, entry, pieces, path, acting
            ways = [way(*args) for way in (form.plain, form.function, form.dispatcher)]
            assert len({float(value).hex() for value in ways}) == 1


def test_runs_along_one_signal_share_their_pieces():
    problem = dt.problems.follower()
    signal = SIGNAL
    one, two = (
        dt.simulate(problem.plant, law, signal, [1.0, -0.5, 0.0], 3.0, 0.05)
        for law in (problem.laws["averaged"], problem.laws["mean"])
    )
    assert one.record.table is two.record.table
    other = dt.simulate(problem.plant, problem.laws["mean"], signal, [1.0, 0.0, 0.0], 2.0, 0.05)
    assert other.record.table is not one.record.table
