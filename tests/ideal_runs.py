"""Runs of the ideal loop, and the second discretisation beside them."""

import numpy as np

import deadtime as dt
import ideal_reference
import plants

PAPER = plants.paper()
PLANT, SIGNAL = plants.generic(), plants.off_grid()
D = PLANT.delay  # 0.234
X0 = np.array([1.0, -0.5, 0.8])
CONSTANT = dt.SwitchingSignal.constant(0)


def run(name="averaged", plant=PLANT, signal=SIGNAL, x0=X0, horizon=3.0, **options):
    law = plants.LAWS[name](plant) if isinstance(name, str) else name
    return dt.simulate(plant, law, signal, x0, horizon, step=None, **options)


def belief(law, signal):
    """What the reference needs to know of a law."""
    model, known = law.plant, getattr(law, "signal", None) or signal
    sigma = ideal_reference.Piecewise(known.times, known.modes)
    A, B, lead = model.A, model.B, model.delay
    if isinstance(law, dt.SingleModePredictor):
        i = law.mode
        return ideal_reference.single(A[i], B[i], lead, law.gains[i])
    if isinstance(law, (dt.AveragedPredictor, dt.MeanPredictor)):
        frozen = (
            ideal_reference.averaged(A, B, lead, law.gains, law.weights)
            if isinstance(law, dt.AveragedPredictor)
            else ideal_reference.single(*law.mean, lead, law.gain)
        )
        if law.dwell_time is None:
            return frozen
        age = known.initial_age
        return ideal_reference.dwelling(A, B, lead, frozen, law.dwell_time, sigma, age)
    if isinstance(law, dt.ExpectedPredictor):
        return ideal_reference.markov(A, B, lead, law.gains, law.model.generator, sigma)
    if isinstance(law, dt.ExactPredictor):
        return ideal_reference.exact(A, B, lead, law.gains, sigma)
    return ideal_reference.delayed(law.gains, sigma)


def reference(law, plant, signal, x0, horizon, u0=None, u0_breaks=(), **options):
    sigma = ideal_reference.Piecewise(signal.times, signal.modes)
    return ideal_reference.solve(
        plant.A,
        plant.B,
        plant.delay,
        sigma,
        belief(law, signal),
        x0,
        horizon,
        u0,
        u0_breaks,
        **options,
    )


def agrees(law, plant, signal, x0, horizon, tolerance=1e-10, u0=None, expected=None, breaks=()):
    """The run and the reference at the run's 1001 points."""
    one = run(law, plant, signal, x0, horizon, u0=u0)
    assert not one.diverged
    other = reference(law, plant, signal, x0, horizon, expected, breaks)
    plants.close(one.states, other.states(one.time), tolerance)
    plants.close(one.inputs, other.inputs(one.time), tolerance)


def same_run(one, other, tolerance, scale=1.0):
    plants.close(one.states, other.states * scale, tolerance)
    plants.close(one.inputs, other.inputs, tolerance)


def other_model(delay):
    rng = np.random.default_rng(0)
    A, B = (M + 0.1 * rng.normal(size=M.shape) for M in (PLANT.A, PLANT.B))
    return dt.SwitchedSystem(A, B, delay)
