"""The prediction in C over a long run, against the futures of the modes, counted out."""

import ctypes

import numpy as np
import pytest

import c_code
import deadtime as dt
import plants
from predictions import GENERIC, SEMI, STEP, K

pytestmark = c_code.needs_compiler

AGES = 12  # after which the hazard stays
# What acts over the 0.234 s ahead: how long, the sample it is of (samples ago), and the period.
PIECES = ((0.034, 3, 0), (0.066, 2, 0), (0.034, 2, 1), (0.066, 1, 1), (0.034, 1, 2))
WALK = """
void NAME_walk(NAME_controller *c, int count, const double *x, const int *mode,
               const double *applied, double *u, double *ahead, int *status);
void NAME_walk(NAME_controller *c, int count, const double *x, const int *mode,
               const double *applied, double *u, double *ahead, int *status)
{
    const int n = BIG_STATES, m = BIG_INPUTS;
    int k;
    for (k = 0; k < count; k++) {
        const double *told = applied[k * m] == applied[k * m] ? &applied[k * m] : 0;
        status[2 * k] = (int)NAME_update(c, &x[k * n], mode[k], told, 0, &u[k * m]);
        status[2 * k + 1] = (int)NAME_predict(c, &x[k * n], &ahead[k * m * n]);
    }
}
"""


def futures(mode, age):
    """F and G with x̂ = F x + Σ_l G_l u(l samples ago), over every path of the modes."""
    hazard = SEMI.hazard(STEP, AGES)
    paths = [(1.0, (mode,), age)]
    for _ in range(2):
        grown = []
        for p, modes, old in paths:
            ends = hazard[modes[-1], min(old, AGES - 1)]
            grown.append((p * (1.0 - ends), (*modes, modes[-1]), old + 1))
            grown += [(p * ends / 2, (*modes, j), 0) for j in range(3) if j != modes[-1]]
        paths = grown
    F, G = np.zeros((3, 3)), np.zeros((4, 3, 2))
    for p, modes, _ in paths:
        moved, of_input = np.eye(3), np.zeros((4, 3, 2))
        for length, lag, place in PIECES:
            Phi, Gamma = plants.held(GENERIC.A[modes[place]], GENERIC.B[modes[place]], length)
            moved, of_input = Phi @ moved, Phi @ of_input
            of_input[lag] += Gamma
        F, G = F + p * moved, G + p * of_input
    return F, G


def ages_of(modes):
    """Samples since the mode began."""
    begins = np.flatnonzero(np.diff(modes, prepend=-1))
    return np.arange(modes.size) - np.repeat(begins, np.diff(begins, append=modes.size))


@pytest.mark.parametrize(
    "count", [10_000, pytest.param(1_000_000, marks=pytest.mark.long)], ids=["few", "million"]
)
def test_every_call_predicts_the_mean_over_the_futures_of_the_mode(tmp_path, count):
    """Three modes, two inputs, a delay off the grid; inputs of its own, clipped, and others'.

    On the way `Controller.prediction` is asked, too.
    """
    rng, limits = np.random.default_rng(6), (-4.0, 4.0)
    controller = dt.Controller(dt.ExpectedPredictor(GENERIC, K, SEMI), STEP, limits=limits)
    controller.export_c(tmp_path, prediction=True)
    library = c_code.Library(tmp_path, GENERIC, options=("-O2",), more=WALK)
    library.reset()
    x = rng.normal(size=(count, 3))
    modes = np.repeat(rng.integers(0, 3, count), rng.integers(1, 15, count))[:count]
    modes = modes.astype(np.int32)
    applied = rng.normal(size=(count, 2))
    applied[rng.random(count) < 0.6] = np.nan
    u, ahead = np.empty((count, 2)), np.empty((count, 2, 3))
    status = np.empty((count, 2), np.int32)
    arrays = (x, modes, applied, u, ahead, status)
    pointers = [one.ctypes.data_as(ctypes.c_void_p) for one in arrays]
    library.call("walk", count, *pointers)
    assert (status[:, 1] == 0).all()
    assert set(status[:, 0].tolist()) == {0, 1}  # its own input, and that at a limit

    sent = np.zeros((count + 3, 2))  # sent[k + 3 − l]: the input of l samples ago at call k
    sent[3:] = u
    told = np.isfinite(applied[:, 0])
    sent[2:-1][told] = applied[told]
    ages, expected = np.minimum(ages_of(modes), AGES), np.empty((count, 3))
    for mode in range(3):
        for age in range(AGES + 1):
            at = np.flatnonzero((modes == mode) & (ages == age))
            F, G = futures(mode, age)
            expected[at] = x[at] @ F.T + sum(sent[at + 3 - lag] @ G[lag].T for lag in (1, 2, 3))
    size = np.abs(expected).max()
    assert np.abs(ahead - expected[:, None]).max() < 1e-12 * size

    for k in range(0, count if count < 1e5 else 100_000):
        controller.update(x[k], int(modes[k]), applied[k] if told[k] else None)
        if k % 20 == 0:
            assert np.abs(controller.prediction.states - ahead[k]).max() < 1e-12 * size
