"""The digital loop against an independent propagation, on random plants, laws and signals."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import deadtime as dt
import reference

LAWS = ("averaged", "single", "mean", "exact", "delayed", "averaged, dwell", "mean, dwell")
NEAR = (0.0, 1e-12, -1e-12, 1e-7, -1e-7)


@st.composite
def ratios(draw, top=7):
    """D/h: anywhere, or near an integer; within 1e-9 of an integer it is that integer."""
    if draw(st.booleans()):
        return Fraction(draw(st.floats(0.05, top))).limit_denominator(10**6)
    return draw(st.integers(1, top)) + Fraction(draw(st.sampled_from(NEAR)))


def meant(ratio: Fraction) -> Fraction:
    return Fraction(round(ratio)) if abs(ratio - round(ratio)) < Fraction(1, 10**9) else ratio


@st.composite
def loops(draw):
    """Sizes, delays and a seed for the numbers: everything that changes the structure of a run."""
    return {
        "modes": draw(st.integers(1, 4)),
        "n": draw(st.integers(1, 5)),
        "m": draw(st.integers(1, 3)),
        "step": Fraction(draw(st.sampled_from(["0.05", "0.1", "0.13", "1"]))),
        "ratio": draw(ratios()),
        "model_ratio": draw(st.one_of(st.none(), ratios())),
        "law": draw(st.sampled_from(LAWS)),
        "dwell_ratio": draw(ratios(9)),
        "age": draw(st.integers(0, 5)),
        "seed": draw(st.integers(0, 2**32 - 1)),
    }


def random_signal(rng, modes, step, delay, samples):
    """Off-grid switches, some at samples, some at a sample plus the delay, several in one step."""
    horizon = samples * step
    instants = set()
    for _ in range(rng.integers(0, 2 * samples)):
        kind = rng.integers(4)
        k = int(rng.integers(1, samples))
        t = Fraction(float(rng.uniform(0, float(horizon)))).limit_denominator(10**5)
        instants.add([t, k * step, k * step + delay, t][kind])
    times = sorted(t for t in instants if t > 0)
    times = [t for i, t in enumerate(times) if i == 0 or t - times[i - 1] > step / 10**4]
    visited = rng.integers(0, modes, size=len(times) + 1)
    return reference.Signal([Fraction(0), *times], visited.tolist())


def random_plant(rng, modes, n, m, time):
    A = rng.normal(size=(modes, n, n))
    norms = np.linalg.norm(A, 2, axis=(1, 2))[:, None, None]
    A *= rng.uniform(0.1, 3.0) / (float(time) * norms)
    return A, rng.normal(size=(modes, n, m))


def require_agreement(case):
    """`simulate` and the second method on one random loop."""
    rng = np.random.default_rng(case["seed"])
    modes, n, m, step = case["modes"], case["n"], case["m"], case["step"]
    delay = meant(case["ratio"]) * step
    model_ratio = case["ratio"] if case["model_ratio"] is None else case["model_ratio"]
    model_delay = meant(model_ratio) * step
    samples = int(rng.integers(4, 16))

    A, B = random_plant(rng, modes, n, m, max(delay, step))
    C, E = (A, B) if rng.integers(2) else random_plant(rng, modes, n, m, max(model_delay, step))
    gains = rng.normal(size=(modes, m, n))
    signal = random_signal(rng, modes, step, delay, samples)
    past = int(max(-(-delay // step), -(-model_delay // step)))
    history = rng.normal(size=(past, m))
    x0 = rng.normal(size=n)

    truth = dt.SwitchedSystem(A, B, float(case["ratio"] * step))
    model = dt.SwitchedSystem(C, E, float(model_ratio * step))
    exact_model = reference.Model(C, E, model_delay)
    weights = rng.dirichlet(np.ones(modes))
    mode = int(rng.integers(modes))
    dwell_time, age = case["dwell_ratio"] * step, case["age"]
    dwelling = (meant(case["dwell_ratio"]) * step, age)
    centre = reference.Model(C.mean(axis=0)[None], E.mean(axis=0)[None], model_delay)
    free = {"allow_unstable": True}
    law, second = {
        "averaged": (
            dt.AveragedPredictor(model, gains, weights, **free),
            reference.averaged(exact_model, gains, weights),
        ),
        "single": (
            dt.SingleModePredictor(model, gains, mode, **free),
            reference.single(exact_model, gains, mode),
        ),
        "mean": (
            dt.MeanPredictor(model, gains[0], gains, **free),
            reference.mean(exact_model, gains[0]),
        ),
        "exact": (
            dt.ExactPredictor(model, gains, **free),
            reference.exact(exact_model, gains),
        ),
        "averaged, dwell": (
            dt.AveragedPredictor(model, gains, weights, float(dwell_time), **free),
            reference.dwelling(exact_model, exact_model, weights[:, None, None] * gains, *dwelling),
        ),
        "mean, dwell": (
            dt.MeanPredictor(model, gains[0], gains, float(dwell_time), **free),
            reference.dwelling(exact_model, centre, gains[:1], *dwelling),
        ),
        "delayed": (
            dt.DelayedStateFeedback(model, gains, **free),
            reference.delayed(exact_model, gains),
        ),
    }[case["law"]]

    loop = reference.Loop(reference.Model(A, B, delay), signal, step, history)
    states, inputs, scale = loop.run(second, x0, samples)

    own_signal = dt.SwitchingSignal(
        [float(t) for t in signal.times], signal.modes, initial_age=float(age * step)
    )
    horizon = float((samples - 1) * step)
    run = dt.simulate(truth, law, own_signal, x0, horizon, step=float(step), u0=history.T)
    assert run.time.size == samples
    assert np.abs(run.states.T - states).max() <= 1e-12 * scale
    assert np.abs(run.inputs.T - inputs).max() <= 1e-12 * scale


def random_loops(count):
    return settings(
        max_examples=count,
        deadline=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
    )


@random_loops(60)
@given(loops())
def test_simulate_equals_an_independent_propagation_to_round_off(case):
    require_agreement(case)


@pytest.mark.long
@random_loops(1000)
@given(loops())
def test_simulate_equals_an_independent_propagation_on_a_thousand_loops(case):
    require_agreement(case)
