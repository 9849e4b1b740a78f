"""Ideal runs put back into their equations, with delays by their definition.

Nothing here knows of segments or windows. What a run says of u before and after 0 is read off it;
x under what the plant's mode reads, and predictions marched from x(t) (an input that is in flight
is the run's, one whose delay has run out K x̂), are Gauss sums of variation of constants, with
exponentials by eigenvectors, over panels that end wherever u may jump or bend.
"""

import itertools

import numpy as np
from numpy.polynomial.legendre import leggauss

NODES, LONGEST = 12, 0.03
_Z, _W = leggauss(NODES)


def integrate(A, forcing, x, begin, end, breaks):
    """x at the end, of dx/dt = A x + forcing(t)."""
    even = np.linspace(begin, end, int((end - begin) / LONGEST) + 2)
    edges = np.unique(np.concatenate((even, breaks[(breaks > begin) & (breaks < end)])))
    edges = edges[np.append(True, np.diff(edges) > 1e-11)]
    half = 0.5 * np.diff(edges)[:, None]
    t, w = (edges[:-1, None] + half * (_Z + 1.0)).ravel(), (half * _W).ravel()
    values, vectors = np.linalg.eig(A)
    back = np.linalg.inv(vectors)
    sums = np.exp((end - t)[:, None] * values) * (forcing(t) @ back.T) * w[:, None]
    return (vectors @ (np.exp((end - begin) * values) * (back @ x) + sums.sum(axis=0))).real


def rough(run, delays, lead=0.0, deep=3):
    """Where u may jump or bend: 0, switches, jumps of u₀, and shifts by delays anyone reads.

    A law with a preview of switches so many seconds ahead (a number, or several) jumps there, too.
    """
    end = run.record.inputs.edges[-1]
    shifts = np.unique(np.concatenate([np.ravel(d) for d in delays]))
    apart = [np.abs(row[:, None] - row).ravel() for d in delays for row in np.atleast_2d(d)]
    shifts = np.unique(np.concatenate((shifts, *apart)))[1:]
    previewed = np.subtract.outer(run.signal.times, lead).ravel()
    front = np.array([0.0, run.record.inputs.edges[0], *run.signal.times, *previewed])
    found = [front]
    for _ in range(deep):
        front = np.unique(np.add.outer(front, shifts).round(13))
        front = front[front < end]
        found.append(front)
    return np.unique(np.concatenate(found))


def arriving(run, t, delays, inputs):
    """u_j(t − D_j) of some inputs, (times, inputs)."""
    return np.stack([run.record.inputs_at(t - delays[j])[:, j] for j in inputs], axis=1)


def state(run, t):
    return run.record.states_at(np.array([t]))[0]


def plant_defect(run, plant, begin, end, bends):
    """By how much x(end) misses what the plant makes of x(begin)."""
    x = state(run, begin)
    switches = [t for t in run.signal.times if begin < t < end]
    for a, b in itertools.pairwise([begin, *switches, end]):
        i = int(run.signal(np.array([0.5 * (a + b)]))[0])
        delays = plant.delays[i]
        breaks = np.concatenate([bends + d for d in delays])
        x = integrate(
            plant.A[i],
            lambda t, i=i, d=delays: arriving(run, t, d, range(len(d))) @ plant.B[i].T,
            x,
            a,
            b,
            breaks,
        )
    return np.abs(x - state(run, end)).max()


def feedback(run, t, A, B, delays, K, bends):
    """u(t) of the exact law of one system that is held for ever."""
    x, answer, begin = state(run, t), np.empty(len(delays)), t
    breaks = np.concatenate([bends + d for d in delays])
    for delay in np.unique(delays):
        flying, landed = np.flatnonzero(delays >= delay), np.flatnonzero(delays < delay)
        x = integrate(
            A + B[:, landed] @ K[landed],
            lambda s, flying=flying: arriving(run, s, delays, flying) @ B[:, flying].T,
            x,
            begin,
            t + delay,
            breaks,
        )
        answer[delays == delay], begin = K[delays == delay] @ x, t + delay
    return answer


def previewed(run, t, believed, system, K, bends):
    """u(t) of the exact law along a signal that it believes in.

    `believed` are (start, system) pairs, `system` the A, B and delays of all, K (systems, m, n).
    """
    A, B, delays = system
    breaks = np.concatenate([bends + d for d in np.unique(delays)])
    x, s, answer = state(run, t), t, np.full(delays.shape[1], np.nan)
    while True:
        i = [system for start, system in believed if start <= s + 1e-13][-1]
        read = np.isnan(answer) & (t + delays[i] <= s + 1e-13)
        answer[read] = (K[i] @ x)[read]
        if not np.isnan(answer).any():
            return answer
        marks = np.array([start for start, _ in believed] + (t + delays[i]).tolist())
        stop = marks[marks > s + 1e-13].min()
        flying = np.flatnonzero(0.5 * (s + stop) - delays[i] < t)
        landed = np.setdiff1d(np.arange(answer.size), flying)
        x = integrate(
            A[i] + B[i][:, landed] @ K[i][landed],
            lambda s, i=i, f=flying: arriving(run, s, delays[i], f) @ B[i][:, f].T,
            x,
            s,
            stop,
            breaks,
        )
        s = stop
