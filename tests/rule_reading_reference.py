"""A second method for plants that a rule switches and whose modes differ in delays: no shared code.

What input j is sent at t is K_i,j x of when it is first read. x is integrated by SciPy's DOP853
with event detection, restarted where what the mode in force reads jumps or bends, and what has been
sent is asked of the solutions before.
"""

import numpy as np
from scipy.integrate import solve_ivp

SAME, ASIDE, DEEP = 1e-11, 1e-7, 6


class Loop:
    """A run from x0 at time 0, `before(t)` what was sent before, which jumps at `jumps`."""

    def __init__(self, plant, gains, mode, boundaries, x0, before, jumps):
        self.A, self.B, self.delays, self.K = plant.A, plant.B, plant.delays, gains
        self.mode_at, self.boundaries, self.before = mode, boundaries, before
        self.t, self.x, self.mode = 0.0, np.array(x0, float), mode(x0)
        m = self.B.shape[2]
        self.edges, self.solutions, self.switches = [0.0], [], []
        self.turned, self.newest, self.sent = False, np.zeros(m), [[] for _ in range(m)]
        self.bends = [[(t, 0) for t in [*jumps, 0.0]] for _ in range(m)]

    def at(self, t):
        """x at a time so far."""
        place = min(max(np.searchsorted(self.edges, t, "right") - 1, 0), len(self.solutions) - 1)
        return self.solutions[place](t)

    def was_sent(self, j, t, until):
        """What input j was sent at t < `until`, its piece that of just before `until`."""
        if until <= SAME:
            return self.before(t)[j]
        for begin, end, mode, held in self.sent[j]:
            if begin - SAME < 0.5 * (t + until) < end + SAME:
                return held if mode is None else self.K[mode, j] @ self.at(t + self.delays[mode, j])
        raise AssertionError((j, t, until, self.sent[j][-3:]))

    def enter(self):
        """The mode in force reads what is overdue."""
        for j, delay in enumerate(self.delays[self.mode]):
            if self.t - delay > self.newest[j] + SAME:
                value = self.K[self.mode, j] @ self.x
                self.sent[j].append((self.newest[j], self.t - delay, None, value))
                self.bends[j].append((self.newest[j], 0))
                self.newest[j] = self.t - delay

    def march(self, end):
        """x at a later time."""
        while self.t < end - SAME:
            self.step(end)
        return self.x

    def _next(self, end, anew):
        """Where the solution is begun anew at the latest, and the derivative that jumps there."""
        delays = self.delays[self.mode]
        marks = [(end, 99), (self.t + 0.04, 99)]
        for j in np.flatnonzero(~anew):
            marks.append((self.newest[j] + delays[j], 0))
            marks += [(b + delays[j], k + 1) for b, k in self.bends[j]]
        marks = [mark for mark in marks if mark[0] > self.t + SAME]
        stop = min(mark[0] for mark in marks)
        return stop, min(mark[1] for mark in marks if mark[0] < stop + SAME)

    def step(self, end):
        """To the next bend or boundary."""
        self.enter()
        i, t, delays = self.mode, self.t, self.delays[self.mode]
        anew = t - delays >= self.newest - SAME
        stop, order = self._next(end, anew)

        def slope(s, x):
            sent = [
                self.K[i, j] @ x if anew[j] else self.was_sent(j, s - delay, stop - delay)
                for j, delay in enumerate(delays)
            ]
            return self.A[i] @ x + self.B[i] @ sent

        def solve(begin, end, x, **more):
            return solve_ivp(slope, (begin, end), x, "DOP853", rtol=1e-13, atol=1e-14, **more)

        begin, x = t, self.x
        if self.turned:  # off the boundary before the next zero is looked for
            begin = min(t + ASIDE, stop)
            x = solve(t, begin, x).y[:, -1]
        events = [lambda s, x, g=g: g(x) for g in self.boundaries]
        for event in events:
            event.__dict__["terminal"] = True
        met = solve(begin, stop, x, events=events)
        self.turned = met.status == 1
        self.t = float(met.t[-1])
        self.solutions.append(solve(t, self.t, self.x, dense_output=True).sol)
        self.edges.append(self.t)
        self.x = self.solutions[-1](self.t)
        for j in np.flatnonzero(anew):
            self.sent[j].append((self.newest[j], self.t - delays[j], i, None))
            self.newest[j] = self.t - delays[j]
        if self.turned:
            self.mode, order = self.mode_at(self.x + ASIDE * slope(self.t, self.x)), 0
            self.switches += [self.t] if self.mode != i else []
        if order <= DEEP:
            for j in range(delays.size):
                self.bends[j] += [(self.t - self.delays[k, j], order) for k in {i, self.mode}]
