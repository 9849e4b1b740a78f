"""Simulated runs: the delay-free loop of the exact predictor, relations between runs."""

from itertools import pairwise

import numpy as np
import pytest

import deadtime as dt
import plants

H = 0.1
PLANT = plants.generic()  # D = 0.234, φ = 0.034
SIGNAL = plants.off_grid()
X0 = np.array([1.0, -0.5, 0.8])
HISTORY = np.random.default_rng(5).normal(size=(2, 3))


def run(
    name="averaged", plant=PLANT, signal=SIGNAL, x0=X0, horizon=3.0, u0=HISTORY, step=H, times=None
):
    law = plants.LAWS[name](plant) if isinstance(name, str) else name
    return dt.simulate(plant, law, signal, x0, horizon, step=step, u0=u0, times=times)


def same_run(one, other, tolerance, scale=1.0):
    plants.close(one.states, other.states * scale, tolerance)
    plants.close(one.inputs, other.inputs, tolerance)


# -- the exact predictor -----------------------------------------------------------------------


def terms(law, one, signal, history):
    """Σ |F| |x_k| + Σ |G_j| |u_{k−j}|: what the round-off of u_k scales with."""
    table = law.digital(H, signal, one.time.size)
    N = table.taps
    inputs = np.hstack([history, one.inputs])
    scale = np.einsum("kij,jk->ik", np.abs(table.state_gain), np.abs(one.states))
    for j in range(1, N + 1):
        past = inputs[:, N - j : N - j + one.time.size]
        scale += np.einsum("kij,jk->ik", np.abs(table.input_gain[:, j - 1]), np.abs(past))
    return scale


@pytest.mark.parametrize("delay", [0.234, 0.3, 0.04])
def test_the_exact_predictor_leaves_no_mismatch(delay):
    plant = plants.generic(delay)
    law = plants.LAWS["exact"](plant)
    history = HISTORY[:, : law.window(H).count]
    one = run(law, plant, u0=history)
    assert (np.abs(one.mismatch) <= 1e-12 * terms(law, one, SIGNAL, history)).all()


def delay_free(plant, gains, signal, z, steps):
    """z_{k+1} = Φ z_k + Γ K_σ(t_k + D) z_k over [t_k + D, t_{k+1} + D), cut at the switches."""
    states = [z]
    for k in range(steps - 1):
        start, end = k * H + plant.delay, (k + 1) * H + plant.delay
        u = gains[signal(np.array(start + 1e-12))] @ states[-1]
        cuts = [start, *(t for t in signal.times if start + 1e-10 < t < end - 1e-10), end]
        x = states[-1]
        for a, b in pairwise(cuts):
            i = signal(np.array(a + 1e-12))
            Phi, Gamma = plants.held(plant.A[i], plant.B[i], b - a)
            x = Phi @ x + Gamma @ u
        states.append(x)
    return np.array(states).T


@pytest.mark.parametrize("delay", [0.234, 0.3, 0.04])
def test_the_exact_predictor_gives_the_delay_free_loop_shifted_by_the_delay(delay):
    plant = plants.generic(delay)
    samples = np.arange(28) * H
    shifted = run("exact", plant, u0=None, times=samples + delay)
    loop = delay_free(plant, plants.gains(plant), SIGNAL, shifted.states[:, 0], 28)
    plants.close(shifted.states, loop, 1e-12)


def test_the_mismatch_is_u_minus_k_of_the_mode_and_state_a_delay_later():
    for name in ("averaged", "single", "mean with gains", "delayed"):
        one = run(name)
        later = run(name, horizon=3.5, times=one.time + PLANT.delay)
        K = plants.gains(PLANT)[SIGNAL(one.time + PLANT.delay)]
        expected = one.inputs - np.einsum("kij,jk->ik", K, later.states)
        plants.close(one.mismatch, expected, 1e-12, scale=np.abs(one.inputs).max())
    assert run("mean").mismatch is None


# -- relations between runs --------------------------------------------------------------------


def test_identical_modes_make_every_predictor_the_same_run():
    plant = plants.identical()
    reference = run("single", plant)
    for name in plants.PREDICTORS:
        same_run(run(name, plant), reference, 1e-12)


@pytest.mark.parametrize("name", plants.LAWS)
@pytest.mark.parametrize("first", [0.2, 0.8, 1.5])
def test_splitting_the_horizon_changes_nothing(name, first):
    whole = run(name)
    start = run(name, horizon=first)
    rest = run(
        name,
        signal=SIGNAL.after(first),
        x0=start.states[:, -1],
        horizon=3.0 - first,
        u0=start.history,
    )
    cut = start.time.size - 1
    plants.close(np.hstack([start.states[:, :-1], rest.states]), whole.states, 1e-12)
    plants.close(np.hstack([start.inputs[:, :-1], rest.inputs]), whole.inputs, 1e-12)
    assert np.array_equal(rest.mode, whole.mode[cut:])


@pytest.mark.parametrize("name", plants.LAWS)
def test_a_change_of_state_variables_commutes_with_simulation(name):
    T = np.array([[2.0, 0.5, 0.0], [-1.0, 1.0, 0.3], [0.2, 0.0, 0.7]])
    plant, law = plants.in_other_units(name, T, 1.0)
    one, other = run(name), run(law, plant, x0=T @ X0)
    plants.close(other.states, T @ one.states, 1e-11)
    plants.close(other.inputs, one.inputs, 1e-11)


@pytest.mark.parametrize("name", plants.LAWS)
def test_a_change_of_time_unit_commutes_with_simulation(name):
    c = 60.0
    plant, law = plants.in_other_units(name, np.eye(3), c)
    signal = dt.SwitchingSignal(SIGNAL.times * c, SIGNAL.modes)
    one, other = run(name), run(law, plant, signal, horizon=3.0 * c, step=H * c)
    plants.close(other.time, c * one.time, 1e-15)
    same_run(other, one, 1e-11)


@pytest.mark.parametrize("name", plants.LAWS)
def test_runs_superpose(name):
    # Linear laws along one signal: the response to x0 and to u0 add up.
    whole, free, forced = run(name), run(name, u0=None), run(name, x0=np.zeros(3))
    plants.close(free.states + forced.states, whole.states, 1e-12)
    plants.close(free.inputs + forced.inputs, whole.inputs, 1e-12)


def test_a_law_with_a_wrong_delay_still_reads_its_own_inputs():
    # Integrator: the model predicts with D = 0.3 what the plant does with D = 0.1.
    truth, model = plants.scalar(0.0, delay=0.1), plants.scalar(0.0, delay=0.3)
    law = dt.SingleModePredictor(model, [[[-1.0]]], 0)
    one = dt.simulate(
        truth, law, dt.SwitchingSignal.constant(0), [1.0], 2.0, step=H, u0=[[0.3, 0.2, 0.1]]
    )
    x, u = [1.0], [0.3, 0.2, 0.1]
    for _ in range(21):
        u.append(-(x[-1] + H * sum(u[-3:])))
        x.append(x[-1] + H * u[-2])
    plants.close(one.states[0], x[:-1], 1e-13)
    plants.close(one.inputs[0], u[3:], 1e-13)
    assert one.history.shape == (1, 3)
