"""A second method for plants that switch by their state, sharing no code with the package.

The differential equation itself is integrated by SciPy's DOP853, restarted whenever a held input
arrives and at every zero of a boundary function that its event detection finds; the mode beyond a
boundary is asked for a little further along the path. Where the modes on both sides lead back to
the boundary, the mean of their fields that is tangent to it is integrated, until the weight of one
of them vanishes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.integrate import solve_ivp

AHEAD = 1e-7
ON = 1e-10  # a state that close to a boundary is on it


class Plant:
    """A plant with its rule: `mode` of a state, and functions that are zero on the boundaries."""

    def __init__(
        self,
        A: np.ndarray,
        B: np.ndarray,
        delay: float,
        mode: Callable[[np.ndarray], int],
        boundaries: Sequence[Callable[[np.ndarray], float]],
    ) -> None:
        self.A, self.B, self.delay, self.mode, self.boundaries = A, B, delay, mode, boundaries

    def on(self, x: np.ndarray) -> Callable[[np.ndarray], float] | None:
        """The boundary that x is on, if it is on one."""
        nearest = min(self.boundaries, key=lambda g: abs(g(x)), default=None)
        scale = ON * max(1.0, np.abs(x).max() ** 2)
        return nearest if nearest is not None and abs(nearest(x)) <= scale else None

    def sides(self, x: np.ndarray) -> set[int]:
        """The modes at x, both of them on a boundary."""
        g = self.on(x)
        if g is None:
            return {self.mode(x)}
        aside = AHEAD * slope(g, x) / np.linalg.norm(slope(g, x)) * max(1.0, np.abs(x).max())
        return {self.mode(x + aside), self.mode(x - aside)}

    def flow(
        self, x: np.ndarray, u: np.ndarray, tau: float, came_from: int | None = None
    ) -> tuple[np.ndarray, list]:
        """x after τ seconds under a held input, and (time, mode) past every boundary met.

        On a boundary at the start, it is in the mode it came from, and goes on into the other if
        that leads away from the boundary. `last` is the mode at the end, or the one it came from.
        """
        force = self.B @ u
        fields = [lambda y, i=i: self.A[i] @ y + force[i] for i in range(len(self.A))]
        t, switches, sides = 0.0, [], self.sides(x)
        if came_from in sides and len(sides) == 2:
            i, (j,) = came_from, sides - {came_from}
            if self._opposite(x, i, fields) is None:
                on = self.mode(x + AHEAD * fields[j](x)) == j
                switches += [(0.0, j)] if on else []
                i, j = j if on else i, None
        else:
            i = self.mode(x + AHEAD * fields[self.mode(x)](x))
            j = self._opposite(x, i, fields)
        while True:
            t, x, met = self._leg(t, x, tau, fields, i, j)
            if met is None:
                self.last = i
                return x, switches
            if j is None:
                found = self.mode(x + AHEAD * fields[i](x))
                j = found if self.mode(x + AHEAD * fields[found](x)) == i else None
                if j is not None and j != i:
                    continue
            else:
                found = (i, j)[met]
            i, j = found, None
            switches.append((t, found))

    def _opposite(self, x: np.ndarray, i: int, fields: list) -> int | None:
        """The mode on the other side of the boundary that x is on, if both lead to it."""
        for j in self.sides(x) - {i}:
            here, there = (self.mode(x + AHEAD * fields[k](x)) for k in (i, j))
            if (here, there) == (j, i):
                return j
        return None

    def _leg(
        self, t: float, x: np.ndarray, tau: float, fields: list, i: int, j: int | None
    ) -> tuple[float, np.ndarray, int | None]:
        """On in mode i, or between i and j, to the next event: time, state, number of the event."""
        options = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14 * max(1.0, np.abs(x).max())}
        events, field = list(self.boundaries), fields[i]
        if j is not None:
            boundary = self.on(x) or min(self.boundaries, key=lambda g: abs(g(x)))

            def across(k: int, y: np.ndarray) -> float:
                return float(slope(boundary, y) @ fields[k](y))

            def field(y: np.ndarray) -> np.ndarray:
                a, b = across(i, y), across(j, y)
                return (a * fields[j](y) - b * fields[i](y)) / (a - b)

            events = [lambda y: across(i, y), lambda y: across(j, y)]
        elif self.on(x) is not None:
            # It starts on a boundary: step off it before looking for the next event.
            off = min(AHEAD, tau - t)
            if off > 0.0:
                x = solve_ivp(lambda _, y: field(y), (t, t + off), x, **options).y[:, -1]
            t += off
        wrapped = [lambda _, y, g=g: g(y) for g in events]
        for event in wrapped:
            event.terminal = True
        found = solve_ivp(
            lambda _, y: field(y), (t, tau), x, events=wrapped, max_step=tau / 8.0, **options
        )
        met = (
            [k for k, times in enumerate(found.t_events) if times.size] if found.status else [None]
        )
        return float(found.t[-1]), found.y[:, -1], met[0]


def slope(g: Callable[[np.ndarray], float], x: np.ndarray) -> np.ndarray:
    """The gradient of a function that is at most quadratic, by central differences."""
    size = 0.5 * max(1.0, np.abs(x).max())
    return np.array([g(x + e) - g(x - e) for e in size * np.eye(x.size)]) / (2.0 * size)


def run(
    plant: Plant,
    control: Callable[[np.ndarray, list[np.ndarray]], np.ndarray],
    x0: np.ndarray,
    history: np.ndarray,
    step: float,
    samples: int,
) -> tuple[np.ndarray, np.ndarray, list]:
    """States, inputs and switches of the sampled loop; `history` (past, m), oldest first."""
    N = int(np.ceil(round(plant.delay / step, 9)))
    phase = plant.delay - (N - 1) * step
    pipe = list(history)
    x = np.array(x0, dtype=float)
    states, inputs, switches, mode = [x], [], [], plant.mode(x)
    last = None

    def move(x: np.ndarray, u: np.ndarray, begin: float, length: float) -> np.ndarray:
        nonlocal mode, last
        if length <= 1e-12:
            return x
        x, found = plant.flow(x, u, length, last)
        last = plant.last
        for t, new in found:
            if new != mode:  # some boundaries lie within a mode
                switches.append((begin + t, new))
                mode = new
        return x

    for k in range(samples):
        before, known = last, len(switches)
        at_phase = move(x, pipe[-N], k * step, phase)
        # The law is told the mode at the sample: a switch at once counts.
        now = [new for t, new in switches[known:] if t <= k * step + 1e-9]
        u = control(x, pipe, now[-1] if now else before)
        pipe.append(u)
        inputs.append(u)
        x = move(at_phase, pipe[-N], k * step + phase, step - phase)
        states.append(x)
    return np.array(states[:-1]), np.array(inputs), switches


def predictor(model: Plant, gains: np.ndarray, step: float):
    """u = K_r(P) P, with P the model's state a delay ahead."""
    N = int(np.ceil(round(model.delay / step, 9)))
    phase = model.delay - (N - 1) * step

    def control(x: np.ndarray, pipe: list[np.ndarray], mode: int | None = None) -> np.ndarray:
        x, _ = model.flow(x, pipe[-N], phase, mode)
        for j in range(N - 1, 0, -1):
            x, _ = model.flow(x, pipe[-j], step, model.last)
        sides = model.sides(x)
        if model.last in sides and len(sides) == 2:
            (beyond,) = sides - {model.last}
            u = gains[beyond] @ x
            if model.mode(x + AHEAD * (model.A[beyond] @ x + model.B[beyond] @ u)) == beyond:
                return u
            return gains[model.last] @ x
        return gains[model.mode(x)] @ x

    return control
