"""The ideal loop of the expected law where an input's delay differs between modes.

What is sent is put back into its law, worked out twice: the moments of the first passage, marched
by Gauss sums, and, for one input and a model that switches once, the mean of the exact feedback
over the instant of the switch.
"""

import itertools

import numpy as np
import pytest

import deadtime as dt
import ideal_residual
from shares import mostly_long

RATES = {2: [[0.0, 1.5], [2.5, 0.0]], 3: [[0, 1.0, 2.0], [0.5, 0, 1.5], [3.0, 0.0, 0]]}
CASES = [
    [[0.21], [0.34]],
    [[0.25, 0.18], [0.25, 0.22], [0.3, 0.18]],
    [[0.17, 0.4], [0.31, 0.23]],
    [[0.25, 0.18, 0.33], [0.32, 0.22, 0.25], [0.41, 0.47, 0.18]],
]
TIMES = (0.0, 0.07, 0.31, 0.62)


def loop(number, generator=None):
    """A plant, its law, of another model where the number is odd, and a run."""
    delays = np.array(CASES[number])
    (modes, m), rng = delays.shape, np.random.default_rng(number)
    n = 1 + number % 3
    A, B = rng.normal(size=(modes, n, n)), rng.normal(size=(modes, n, m))
    model = plant = dt.SwitchedSystem(A, B, delays)
    if number % 2:
        plant = dt.SwitchedSystem(0.9 * A, 1.1 * B, 0.94 * delays)
    generator = RATES[modes] if generator is None else generator
    gains = 0.6 * rng.normal(size=(modes, m, n))
    law = dt.ExpectedPredictor(model, gains, dt.Markov(generator), allow_unstable=True)
    signal = dt.SwitchingSignal([0.0, 0.24, 0.53], [0, 1, modes - 1 if modes > 2 else 0])
    run = dt.simulate(plant, law, signal, np.ones(n), 0.8, step=None, u0=np.arange(1.0, m + 1.0))
    return plant, law, run, ideal_residual.rough(run, [plant.delays, model.delays], deep=2)


def by_moments(law, run, t, bends):
    """u(t) by the moments of what has not been read yet, an input at a time."""
    A, B, delays, K = law.plant.A, law.plant.B, law.plant.delays, law.gains
    (modes, m, n), rates = K.shape, np.array(law.model.generator)
    start = np.eye(modes)[int(run.signal(np.array([t]))[0])]
    breaks = np.unique(np.add.outer(bends, np.unique(delays)))
    answer = np.zeros(m)
    for j in range(m):
        y, p, begin = np.append(np.kron(start, ideal_residual.state(run, t)), 0.0), start, 0.0
        for end in np.unique(delays[delays <= delays[:, j].max()]):
            S, feed, left = np.zeros((modes * n + 1,) * 2), [], delays[:, j] > begin
            for i, o in itertools.product(np.flatnonzero(left), range(modes)):
                own, other = (slice(k * n, (k + 1) * n) for k in (i, o))
                S[own, other] += rates[o, i] * left[o] * np.eye(n)
                S[-1, own] += 0.0 if left[o] else rates[i, o] * K[o, j]
            for i, k in itertools.product(np.flatnonzero(left), range(m)):
                own = slice(i * n, (i + 1) * n)
                S[own, own] += A[i] / m
                if delays[i, k] <= begin:
                    S[own, own] += np.outer(B[i, :, k], K[i, k])
                else:
                    feed.append((i, k))
            values, vectors = np.linalg.eig(np.where(np.outer(left, left), rates.T, 0.0))
            shares = np.linalg.solve(vectors, p)

            def chances(s, begin=begin, values=values, vectors=vectors, shares=shares):
                return (np.exp((s - begin)[:, None] * values) * shares @ vectors.T).real

            def forcing(s, feed=feed, chances=chances):
                force, now = np.zeros((s.size, modes * n + 1)), chances(s - t)
                for i, k in feed:
                    sent = run.record.inputs_at(s - delays[i, k])[:, k]
                    force[:, i * n : (i + 1) * n] += np.outer(now[:, i] * sent, B[i, :, k])
                return force

            y = ideal_residual.integrate(S, forcing, y, t + begin, t + end, breaks)
            p = chances(np.array([end]))[0]
            for i in np.flatnonzero(delays[:, j] == end):
                y[-1] += K[i, j] @ y[i * n : (i + 1) * n]
                y[i * n : (i + 1) * n] = p[i] = 0.0
            begin = end
        answer[j] = y[-1]
    return answer


@pytest.mark.parametrize("number", mostly_long(range(4), 0))
def test_what_is_sent_is_what_the_moments_say(number):
    plant, law, run, bends = loop(number)
    largest = np.abs(run.inputs).max()
    for t in TIMES:
        u = run.record.inputs_at(np.array([t]))[0]
        assert np.abs(u - by_moments(law, run, t, bends)).max() < 1e-10 * largest
    defect = ideal_residual.plant_defect(run, plant, 0.1, 0.7, bends)
    assert defect < 1e-10 * np.abs(run.states).max()


RATE = 1.7


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_of_one_input_it_is_the_mean_of_the_exact_feedback(order):
    """Mode `order[0]` is left for the other at RATE, and that is never left."""
    first, last = order
    generator = np.zeros((2, 2))
    generator[first, last] = RATE
    _, law, run, bends = loop(0, generator)
    model = law.plant
    system = model.A, model.B, model.delays

    def along(t, believed):
        return ideal_residual.previewed(run, t, believed, system, law.gains, bends)

    for t in (0.02, 0.33, 0.62):
        if run.signal(np.array([t]))[0] == last:
            expected = along(t, [(-1.0, last)])
        else:
            own, other = model.delays[first, 0], model.delays[last, 0]
            expected = np.exp(-RATE * own) * along(t, [(-1.0, first)])
            # The integrand bends where what acts first after the switch is a bend of u.
            bent = np.concatenate([bends + delay - t for delay in (own, other)])
            marks = np.concatenate(([0.0, own, other], bent, bends + other - t))
            edges = np.unique(marks[(marks >= 0.0) & (marks <= own)])
            edges = edges[np.append(True, np.diff(edges) > 1e-10)]
            nodes, weights = np.polynomial.legendre.leggauss(8)
            for begin, end in itertools.pairwise(edges):
                for z, w in zip(nodes, weights, strict=True):
                    s = begin + 0.5 * (end - begin) * (z + 1.0)
                    density = 0.5 * (end - begin) * w * RATE * np.exp(-RATE * s)
                    expected = expected + density * along(t, [(-1.0, first), (t + s, last)])
        u = run.record.inputs_at(np.array([t]))[0]
        assert np.abs(u - expected).max() < 1e-10 * np.abs(run.inputs).max()


@pytest.mark.long
def test_the_digital_loop_tends_to_it_with_order_one():
    plant, law, run, _ = loop(2)
    times, errors = np.linspace(0.0, 0.8, 41), []
    exact = run.record.states_at(times).T
    for h in (0.01, 0.005, 0.0025):
        digital = dt.simulate(
            plant, law, run.signal, np.ones(3), 0.8, h, u0=[1.0, 2.0], times=times
        )
        errors.append(np.abs(digital.states - exact).max())
    slopes = np.diff(np.log(errors)) / np.log(0.5)
    assert slopes == pytest.approx(np.ones(2), abs=0.2)


@pytest.mark.long
def test_growth_rates_tend_to_that_without_a_step_with_order_one():
    delays = np.array([[0.25, 0.18], [0.25, 0.22]])
    rng = np.random.default_rng(4)
    plant = dt.SwitchedSystem(rng.normal(size=(2, 2, 2)), rng.normal(size=(2, 2, 2)), delays)
    gains = 0.6 * rng.normal(size=(2, 2, 2))
    law = dt.ExpectedPredictor(plant, gains, dt.Markov(RATES[2]), allow_unstable=True)
    for mode in range(2):
        coarse, fine = (dt.growth_rate(plant, law, mode, step=h) for h in (0.002, 0.001))
        ideal = dt.growth_rate(plant, law, mode, step=None)
        assert 2.0 * fine - coarse == pytest.approx(ideal, abs=1e-5)
        assert abs(fine - ideal) > 2e-6


def test_delays_that_hardly_differ_tend_to_a_delay_per_input():
    shift, (plant, law, _, _) = 1e-6, loop(2)
    alike = np.tile(plant.delays[0], (2, 1))
    runs = []
    for delays in (alike, np.array([[0.0, 0.0], [0.0, shift]]) + alike):
        model = dt.SwitchedSystem(plant.A, plant.B, delays)
        own = dt.ExpectedPredictor(model, law.gains, law.model, allow_unstable=True)
        runs.append(own.ideal(dt.SwitchingSignal.constant(0), 1.0))
    assert np.abs(runs[0].F - runs[1].F).max() < 1e-5


def test_delays_that_differ_by_so_little_that_it_takes_minutes_are_refused():
    plant, law, _, _ = loop(0)
    for apart, horizon in ((1e-5, 0.5), (1e-4, 500.0)):
        model = dt.SwitchedSystem(plant.A, plant.B, [[0.27], [0.27 + apart]])
        own = dt.ExpectedPredictor(model, law.gains, law.model, allow_unstable=True)
        message = rf"delays that differ by {apart:g} s take [\d,]+ segments of .*: make them equal"
        with pytest.raises(dt.ArgumentError, match=message):
            dt.simulate(model, own, dt.SwitchingSignal.constant(0), [1.0], horizon, None)
