"""Errors of characteristic roots, and short delays: the equation in 60 digits by mpmath."""

from itertools import pairwise

import mpmath
import numpy as np
import pytest

import deadtime as dt
import plants

DELAYS = [1e-15, 1e-12, 1e-9, 1e-7, 1e-5, 1e-3, 0.1, 1.0, 10.0]
A, B = [[0.0, 1.0], [-2.0, 1.0]], [[0.0], [1.0]]
GAINS = {"apart": [[[1.25, -3.0]]], "double": [[[1.0, -3.0]]]}  # poles −0.5, −1.5; −1 twice


def loop(kind, delay, K=GAINS["apart"]):
    """The truth and a law for it."""
    plant = dt.SwitchedSystem([A], [B], delay)
    if kind == "delayed":
        return plant, dt.DelayedStateFeedback(plant, K)
    if kind == "exact":
        return plant, dt.SingleModePredictor(plant, K, 0)
    model = dt.SwitchedSystem([[[0.1, 1.0], [-2.0, 0.9]]], [[[0.0], [1.1]]], 0.9 * delay)
    return plant, dt.SingleModePredictor(model, K, 0)


def determinant(plant, law, s):
    """det Δ(s) of one state-feedback or predictor loop with one input, in mpmath's precision."""
    A, B, K = (mpmath.matrix(x[0].tolist()) for x in (plant.A, plant.B, law.gains))
    S, R = (mpmath.matrix(x[0].tolist()) for x in (law.plant.A, law.plant.B))
    eye, D = mpmath.eye(A.rows), mpmath.mpf(plant.delay)
    F, W = K, mpmath.mpf(0)
    if not isinstance(law, dt.DelayedStateFeedback):
        lead = mpmath.mpf(law.plant.delay)
        E = mpmath.expm(S * lead, method="taylor")
        F = K * E
        W = (K * mpmath.lu_solve(s * eye - S, R - mpmath.exp(-s * lead) * (E * R)))[0]
    free = s * eye - A
    fed = (F * mpmath.lu_solve(free, B))[0] * mpmath.exp(-s * D)
    return mpmath.det(free) * (1 - W - fed)


def turns_of(plant, law, root, error, count):
    """How far the determinant's argument turns in each of `count` steps around a root's circle."""
    circle = [error * mpmath.expjpi(2.0 * k / count) for k in range(count + 1)]
    values = [determinant(plant, law, mpmath.mpc(root) + z) for z in circle]
    return [mpmath.arg(b / a) for a, b in pairwise(values)]


@pytest.mark.few(12)
@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("kind", ["delayed", "exact", "mismatched"])
@pytest.mark.parametrize("poles", GAINS)
def test_claimed_errors_of_roots_are_no_smaller_than_true_ones(poles, kind, delay):
    K = GAINS[poles]
    plant, law = loop(kind, delay, K)
    found = dt.characteristic_roots(plant, law, 0, count=2)
    assert found.complete
    assert found.roots.size >= (1 if delay == 10.0 else 2)
    with mpmath.workdps(60):
        for root, error in zip(found.roots, found.errors, strict=True):
            # A true root lies inside: the determinant goes round 0 as its argument goes round.
            # Where half of a double root is near the circle, shorter steps are needed to follow it.
            for count in (24, 96, 384):
                turns = turns_of(plant, law, complex(root), mpmath.mpf(error), count)
                if max(map(abs, turns)) < 1.5:
                    break
            assert max(map(abs, turns)) < 1.5
            assert round(float(sum(turns) / (2 * mpmath.pi))) in (
                (1, 2) if poles == "double" else (1,)
            )
    if delay <= 1e-3:
        assert found.errors.max() < (1e-12 if poles == "apart" else 1e-5)
    if kind == "exact" and poles == "apart" and delay <= 1.0:
        known = np.linalg.eigvals(np.array(A) + np.array(B) @ K[0])
        plants.close(np.sort(found.roots.real), np.sort(known.real), 1e-12)


@pytest.mark.parametrize("delay", [1e-15, 1e-12, 1e-10, 1e-6])
def test_a_short_delay_tends_to_none(delay):
    for kind in ("delayed", "exact"):
        rate = dt.growth_rate(*loop(kind, delay), 0, None)
        assert rate == pytest.approx(-0.5, abs=1e-12 + 10.0 * delay)
    plant = plants.scalar(0.0, delay=delay)
    assert dt.growth_rate(plant, dt.DelayedStateFeedback(plant, [[[-1.0]]]), 0, None) == (
        pytest.approx(-1.0 - delay - 1.5 * delay**2, abs=1e-12)
    )


@pytest.mark.few(4)
@pytest.mark.parametrize("delay", [1e-15, 1e-12, 1e-10, 1e-8, 1e-3, 1.0])
@pytest.mark.parametrize("gain", [1e-3, 1.0, 1e4])
def test_an_integrator_is_lost_at_a_quarter_turn_however_short_the_nominal_delay(gain, delay):
    nominal = delay / gain
    plant = plants.scalar(0.0, delay=nominal)
    law = dt.DelayedStateFeedback(plant, [[[-gain]]])
    margin = dt.delay_margin(plant, law, None)
    assert margin.upper == pytest.approx(0.5 * np.pi / gain, rel=1e-12)
    assert margin.upper_frequency == pytest.approx(gain, rel=1e-12)
    assert margin.lower == 0.0
    step = 1e-3 / gain
    sampled = dt.delay_margin(plant, law, step)
    # z − 1 + k h e^{−iωD} …: half a period is lost to the hold.
    assert sampled.upper == pytest.approx(0.5 * np.pi / gain - 0.5 * step, rel=1e-5)
