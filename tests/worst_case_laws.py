"""Laws and plants whose worst switching signal is searched for."""

import numpy as np

import deadtime as dt

H = 0.1
QUICK = 4000  # budget
TURNING = [[[-0.1, 1.0], [-4.0, -0.1]], [[-0.1, 4.0], [-1.0, -0.1]]]  # both stable


def drifting():
    """A loop that only a signal between dwell time and clock destabilises."""
    A = [[[-9.7, 15.8], [-17.39, -2.6]], [[-10.55, -11.29], [-13.6, -23.77]]]
    B = [[[8.22], [12.58]], [[-3.68], [-8.8]]]
    plant = dt.SwitchedSystem(A, B, delay=H)
    return plant, dt.DelayedStateFeedback(plant, [[[-0.42, 0.24]], [[1.689, -1.205]]])


def free(A, delay=0.1, m=1):
    """A plant left to itself: the law's gains are 0."""
    A = np.asarray(A, dtype=float)
    B = np.ones((*A.shape[:2], m))
    plant = dt.SwitchedSystem(A, B, delay)
    gains = np.zeros((A.shape[0], m, A.shape[1]))
    return plant, dt.DelayedStateFeedback(plant, gains, allow_unstable=True)


def measured(worst, cycles=6):
    """The growth rate in the run itself: the lifted state at cycle ends obeys z″ = p z′ + q z."""
    run = worst.simulate(cycles)
    assert not run.diverged
    period = worst.cycle.periods
    inputs, W = np.hstack((worst.u0, run.inputs)), worst.u0.shape[1]
    z = [np.append(run.states[:, k], inputs[:, k : k + W]) for k in range(0, run.time.size, period)]
    assert len(z) == cycles + 1
    scale = [np.linalg.norm(z[c]) for c in range(cycles - 1)]
    before = np.concatenate([z[c] / s for c, s in enumerate(scale)])
    now = np.concatenate([z[c + 1] / s for c, s in enumerate(scale)])
    after = np.concatenate([z[c + 2] / s for c, s in enumerate(scale)])
    p, q = np.linalg.lstsq(np.column_stack((now, before)), after, rcond=1e-9)[0]
    assert np.linalg.norm(p * now + q * before - after) < 1e-6 * np.linalg.norm(after)
    return np.log(np.abs(np.roots([1.0, -p, -q])).max()) / worst.length
