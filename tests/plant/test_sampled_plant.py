"""SampledPlant: its pieces against the plant propagated by SciPy, with each input held by hand."""

import numpy as np
import pytest

import plants
from deadtime.plant import SampledPlant
from deadtime.plant.sampled_plant import acting

STEP = 0.1


def propagated(plant, mode, x, inputs, fine=700):
    """x(h) in small pieces; the input that acts at t was computed at ⌊(t − D)/h⌋, the latest 0."""
    A, B, h = plant.A[mode], plant.B[mode], STEP / fine
    Phi, Gamma = plants.held(A, B, h)
    for i in range(fine):
        sample = int(np.floor(((i + 0.5) * h - plant.delay) / STEP))
        x = Phi @ x + Gamma @ inputs[-sample]
    return x


# Multiples of h/700, where the pieces by hand may be cut.
@pytest.mark.parametrize("delay", [0.03, 0.1, 0.24, 0.3, 0.51])
@pytest.mark.parametrize("mode", range(3))
def test_a_period_is_what_its_pieces_and_the_plant_itself_do(delay, mode):
    plant = plants.generic(delay)
    rng = np.random.default_rng(mode)
    x, inputs = rng.normal(size=3), rng.normal(size=(9, 2))  # u_k, u_{k−1}, …
    sampled, reference = SampledPlant(plant, STEP), propagated(plant, mode, x, inputs)
    Phi, Gamma, lags = sampled.period(mode)
    moved = Phi @ x + sum(part @ inputs[lag] for part, lag in zip(Gamma, lags, strict=True))
    plants.close(moved, reference, 1e-12)
    for piece in sampled.pieces(mode):
        x = piece.Phi @ x + piece.Gamma @ acting(piece.stretch.lag, inputs)
    plants.close(x, reference, 1e-12)
    assert max(lags) == sampled.longest_lag == int(np.ceil(round(delay / STEP, 9)))


def test_a_delay_of_whole_periods_has_one_piece():
    (piece,) = SampledPlant(plants.generic(0.3), STEP).pieces(0)
    assert (piece.stretch.start, piece.stretch.stop) == (0.0, STEP)
    assert piece.stretch.lag.tolist() == [3, 3]


def test_its_arrays_are_read_only():
    sampled = SampledPlant(plants.generic(), STEP)
    for array in (*sampled.period(1)[:2], *sampled.pieces(1)[0][:2], sampled.pieces(1)[0][2].lag):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
