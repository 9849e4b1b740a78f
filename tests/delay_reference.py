"""Loops whose inputs and modes have delays of their own, by their definition and SciPy alone.

Nothing here knows of pieces, lags or tables: time is cut wherever a switch or any arrival falls,
and in the middle of each part it is asked which sample the mode in force reads.
"""

import itertools

import numpy as np
from scipy.linalg import expm


class Reference:
    """A plant, or a law's model, as matrices and delays (modes, m), at a period."""

    def __init__(self, A, B, delays, step):
        self.A, self.B, self.delays, self.step = A, B, np.asarray(delays), step

    def parts(self, begin, end, switches):
        """The parts of an interval in which nothing changes."""
        h, edges = self.step, [begin, end, *switches]
        for delay in np.unique(self.delays):
            first, last = np.floor((begin - delay) / h), np.ceil((end - delay) / h)
            edges += (np.arange(first, last + 1) * h + delay).tolist()
        edges = np.unique([t for t in edges if begin <= t <= end])
        edges = edges[np.append(True, np.diff(edges) > 1e-11)]
        return list(itertools.pairwise(edges))

    def move(self, x, mode, u, seconds):
        n, m = self.B.shape[1:]
        Z = np.zeros((n + m, n + m))
        Z[:n] = np.hstack((self.A[mode], self.B[mode]))
        E = expm(Z * seconds)
        return E[:n, :n] @ x + E[:n, n:] @ u

    def read(self, mode, time):
        """The samples that a mode reads."""
        return np.floor((time - self.delays[mode]) / self.step).astype(int)

    def states(self, x, signal, samples, value):
        """x(t_k), k = 0, …, samples; value(j, k) is what was sent."""
        result = [x]
        for k in range(samples):
            for a, b in self.parts(k * self.step, (k + 1) * self.step, signal.times[1:].tolist()):
                mode = int(signal(np.array([0.5 * (a + b)]))[0])
                sample = self.read(mode, 0.5 * (a + b))
                u = np.array([value(j, s) for j, s in enumerate(sample)])
                x = self.move(x, mode, u, b - a)
            result.append(x)
        return np.array(result)

    def feedback(self, k, x, switches, path, gains, value):
        """u_k of the law that believes in a path: a function of time, which switches at `switches`.

        Inputs from u_k on are K_i,j x where a mode i first reads them.
        """
        m = self.B.shape[2]
        begin, later, answer = k * self.step, [{} for _ in range(m)], np.full(m, np.nan)
        for a, b in self.parts(begin, begin + self.delays.max() + 2 * self.step, switches):
            mode = path(0.5 * (a + b))
            sample, u = self.read(mode, 0.5 * (a + b)), np.empty(m)
            for j, s in enumerate(sample):
                for new in range(k + len(later[j]), s + 1):
                    later[j][new] = gains[mode][j] @ x
                    if new == k:
                        answer[j] = later[j][new]
                u[j] = value(j, s) if s < k else later[j][s]
            if np.isfinite(answer).all():
                return answer
            x = self.move(x, mode, u, b - a)
        raise AssertionError("an input was never read")
