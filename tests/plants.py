"""Plants, gains, laws and signals that the tests share."""

import numpy as np
from scipy.linalg import expm

import deadtime as dt

POLES = (-1.0, -1.5, -2.0)


def paper(delay=1.0):
    """The example of arXiv 2503.08446: two modes, two states, one input."""
    A = [[[2, 1], [0, 1]], [[2.3, 1.1], [0.05, 1.2]]]
    return dt.SwitchedSystem(A, [[[0], [1]], [[0], [1.02]]], delay)


def generic(delay=0.234, seed=4):
    """Three modes, three states, two inputs; with a step of 0.1 the delay is N = 3, φ = 0.034."""
    rng = np.random.default_rng(seed)
    return dt.SwitchedSystem(rng.normal(size=(3, 3, 3)), rng.normal(size=(3, 3, 2)), delay)


def identical(delay=0.234, modes=3):
    """Modes of `generic` that are all the same."""
    plant = generic(delay)
    return dt.SwitchedSystem(
        np.tile(plant.A[:1], (modes, 1, 1)), np.tile(plant.B[:1], (modes, 1, 1)), delay
    )


def scalar(a, b=1.0, delay=0.25):
    """One state, one input; `a` and `b` may list one value per mode."""
    a = np.atleast_1d(np.asarray(a, dtype=float))
    return dt.SwitchedSystem(a[:, None, None], np.broadcast_to(b, a.shape)[:, None, None], delay)


def gains(plant):
    """Gains of every mode for poles −1, −1.5, −2 (the paper's: −1, −2)."""
    return dt.place(plant, POLES if plant.states == 3 else POLES[::2])


def markov(modes):
    """A Markov model without symmetry, rates of 0.5 to 3 1/s."""
    rates = 0.5 + 2.5 * np.random.default_rng(2).random((modes, modes))
    return dt.Markov(rates * (1.0 - np.eye(modes)))


def mean_gain(plant):
    return gains(plant.mean())[0]


def filter_matrix(plant, unit=1.0):
    """A time constant that mixes the inputs, with complex eigenvalues where there are two."""
    m = plant.inputs
    return unit * (0.05 * np.eye(m) + 0.02 * (np.tri(m, k=-1) - np.tri(m, k=-1).T))


# Every law, made for a plant: contracts run through all of them.
LAWS = {
    "averaged": lambda plant: dt.AveragedPredictor(plant, gains(plant)),
    "weighted": lambda plant: dt.AveragedPredictor(
        plant, gains(plant), np.arange(1, plant.modes + 1) / np.arange(1, plant.modes + 1).sum()
    ),
    "single": lambda plant: dt.SingleModePredictor(plant, gains(plant), plant.modes - 1),
    "mean": lambda plant: dt.MeanPredictor(plant, mean_gain(plant)),
    "mean with gains": lambda plant: dt.MeanPredictor(plant, mean_gain(plant), gains(plant)),
    "averaged, dwell-aware": lambda plant: dt.AveragedPredictor(plant, gains(plant), None, 0.1634),
    "mean, dwell-aware": lambda plant: dt.MeanPredictor(plant, mean_gain(plant), None, 0.31),
    "expected": lambda plant: dt.ExpectedPredictor(plant, gains(plant), markov(plant.modes)),
    "exact": lambda plant: dt.ExactPredictor(plant, gains(plant)),
    "delayed": lambda plant: dt.DelayedStateFeedback(plant, gains(plant)),
    "averaged, low-pass": lambda plant: dt.LowPassPredictor(
        dt.AveragedPredictor(plant, gains(plant)), filter_matrix(plant)
    ),
}
IDEAL = [name for name in LAWS if name != "averaged, low-pass"]  # have a form without a step
PREDICTORS = [name for name in IDEAL if name != "delayed"]


def in_other_units(name, T, c):
    """`generic` and a law made for it, in the state T x and the time c t."""
    plant = generic()
    A = T @ plant.A @ np.linalg.inv(T) / c
    changed = dt.SwitchedSystem(A, T @ plant.B / c, plant.delay * c)
    K, w = gains(plant) @ np.linalg.inv(T), np.array([1, 2, 3]) / 6
    mean = mean_gain(plant) @ np.linalg.inv(T)
    law = {
        "averaged": lambda: dt.AveragedPredictor(changed, K),
        "weighted": lambda: dt.AveragedPredictor(changed, K, w),
        "single": lambda: dt.SingleModePredictor(changed, K, 2),
        "mean": lambda: dt.MeanPredictor(changed, mean),
        "mean with gains": lambda: dt.MeanPredictor(changed, mean, K),
        "averaged, dwell-aware": lambda: dt.AveragedPredictor(changed, K, None, 0.1634 * c),
        "mean, dwell-aware": lambda: dt.MeanPredictor(changed, mean, None, 0.31 * c),
        "expected": lambda: dt.ExpectedPredictor(changed, K, dt.Markov(markov(3).rates / c)),
        "exact": lambda: dt.ExactPredictor(changed, K),
        "delayed": lambda: dt.DelayedStateFeedback(changed, K),
        "averaged, low-pass": lambda: dt.LowPassPredictor(
            dt.AveragedPredictor(changed, K), filter_matrix(changed, c)
        ),
    }[name]()
    return changed, law


def off_grid(modes=3, end=np.inf):
    """Switches off the grid of 0.1, two in one step, and one on it."""
    times = [0.0, 0.1718, 0.31, 0.3727, 0.8, 1.1234, 1.56, 2.07]
    return dt.SwitchingSignal(times, [i % modes for i in (0, 1, 2, 0, 1, 2, 1, 0)], end)


def held(A, B, tau):
    """Φ and Γ from SciPy's exponential of [[A, B], [0, 0]]."""
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n] = np.hstack([A, B])
    whole = expm(block * tau)
    return whole[:n, :n], whole[:n, n:]


def close(value, reference, tolerance, scale=None):
    """|value − reference| ≤ tolerance · max|reference| (or `scale`)."""
    value, reference = np.asarray(value), np.asarray(reference)
    assert value.shape == reference.shape
    scale = np.abs(reference).max() if scale is None else scale
    error = np.abs(value - reference).max()
    assert error <= tolerance * scale, f"relative error {error / scale:.1e} > {tolerance:.0e}"


def expected_inputs(table, x, modes, applied, history=None):
    """u_k from rows of the table, and Σ|terms|; `applied` (K, m) are the inputs that acted."""
    taps, m = table.input_gain.shape[1:3]
    past = np.zeros((taps, m)) if history is None else history
    past = np.concatenate((past, applied))[: taps + len(x) - 1]
    windows = np.lib.stride_tricks.sliding_window_view(past, taps, axis=0)[..., ::-1]
    rows = table.rows(modes)
    u, scale = np.empty((len(x), m)), np.empty((len(x), m))
    for row in np.unique(rows):
        at = rows == row
        F, G = table.state_gain[row], table.input_gain[row].transpose(1, 2, 0).reshape(m, -1)
        seen = windows[at].reshape(at.sum(), -1)
        u[at] = x[at] @ F.T + seen @ G.T
        scale[at] = np.abs(x[at]) @ np.abs(F).T + np.abs(seen) @ np.abs(G).T
    return u, scale


OUTPUTS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])


def near(delay=0.234):
    """`generic` with its modes close to each other."""
    return generic(delay).apart(0.1)


def resting(delay=0.234):
    """Three modes, three states, two inputs; positions 0 and 2 rest anywhere without an input."""
    A = np.zeros((3, 3, 3))
    A[:, 0, 1], A[:, 1, 1], A[:, 2, 1] = (1.0, 1.1, 0.9), (-0.5, 0.3, -1.0), (0.2, -0.3, 0.1)
    B = np.zeros((3, 3, 2))
    B[:, 1, 0], B[:, 2, 1], B[:, 1, 1] = (1.0, 0.8, 1.2), (1.0, 1.1, 0.9), (0.1, 0.0, -0.2)
    return dt.SwitchedSystem(A, B, delay)


def gramian_by_quadrature(A, W, time):
    """∫₀^τ e^{As} W e^{Aᵀs} ds by Gauss–Legendre, with no block exponential."""
    points, weights = np.polynomial.legendre.leggauss(24)
    total = np.zeros_like(W, dtype=float)
    for s, w in zip((points + 1.0) * time / 2.0, weights * time / 2.0, strict=True):
        E = expm(A * s)
        total += w * E @ W @ E.T
    return total
