"""The compiled run of an imperfect loop beside the same run with its law called once a period."""

import numpy as np

import deadtime as dt
import plants
from by_sample import by_sample
from deadtime.imperfections import Disturbance, Noise, RateLimit, Saturation, Sizes, streams
from deadtime.simulation.online import ImperfectLaw, run_online
from deadtime.simulation.truth import Grid, KnownTruth

MODEL = plants.generic()
# Not what the law believes: N = 3, φ = 0.051 and other matrices.
PLANT = dt.SwitchedSystem(1.03 * MODEL.A, 0.98 * MODEL.B, 0.251)
SIGNAL = plants.off_grid()
X0, U0 = np.array([1.0, -1.0, 0.5]), np.array([0.3, -0.2])
NOISE, OTHER = Noise([0.1, 0.0, 0.3]), Noise(0.05)
RATE, CLIP, TIGHT = RateLimit([20.0, 35.0]), Saturation([-4.0, -np.inf], 3.0), Saturation(-2.5, 9.0)


def by_periods(plant, law, signal, x0, horizon, step, kinds, predict, u0):
    """The run with the law as a function that is called once a period."""
    grid = Grid.of(plant, law, horizon, step, u0)
    pairs = list(zip(kinds, streams(kinds, 7), strict=True))
    forces = [pair for pair in pairs if isinstance(pair[0], Disturbance)]
    others = [pair for pair in pairs if not isinstance(pair[0], Disturbance)]
    update = law.online(step, signal, grid.samples)
    measured = plant.states if law.outputs is None else law.outputs.shape[1]
    sizes = Sizes(plant.modes, measured, plant.inputs, step)
    others = [(by_sample(kind), rng) for kind, rng in others]
    imperfect = ImperfectLaw(update, sizes, others, predict, grid.samples, law.outputs)
    return run_online(imperfect, KnownTruth(grid, signal, forces), x0, horizon)


def same(value, reference):
    assert value.shape == reference.shape
    scale = np.abs(reference[np.isfinite(reference)]).max(initial=0.0)
    np.testing.assert_allclose(value, reference, rtol=1e-12, atol=1e-12 * scale)


def require_same(
    law, kinds, horizon=2.04, step=0.1, predict="applied", plant=PLANT, signal=SIGNAL, x0=X0, u0=U0
):
    """Both runs, compared in all they leave behind; the compiled one is returned."""
    reference = by_periods(plant, law, signal, x0, horizon, step, kinds, predict, u0)
    run = dt.simulate(
        plant, law, signal, x0, horizon, step, u0,
        imperfections=kinds, seed=7, predict=predict,
    )  # fmt: skip
    assert run.diverged == reference.diverged
    assert run.end == (horizon if reference.end is None else reference.end)
    for name in ("path", "inputs"):
        same(getattr(run.record, name), getattr(reference.record, name))
    assert run.record.samples == reference.record.samples
    same(run.measured, reference.law_signals.measured.T)
    same(run.commanded, reference.law_signals.commanded.T)
    assert (run.estimates is None) == (reference.law_signals.estimates is None)
    if run.estimates is not None:
        same(run.estimates, reference.law_signals.estimates.T)
    assert (run.belief is None) == (reference.belief is None)
    if run.belief is not None:
        same(run.belief[:, : len(reference.belief)], reference.belief.T)
    same(run.history, reference.record.history(run.end))
    if (
        plant.inputs == 2
        and law.outputs is None
        and any(isinstance(kind, Saturation | RateLimit) for kind in kinds)
    ):
        assert (run.record.inputs[run.record.past :] != run.commanded.T).any()
    return run
