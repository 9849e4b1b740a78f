"""A second method for plants that switch by their state, sharing no code with the package.

The differential equation itself is integrated by SciPy's DOP853, restarted whenever a held input
arrives and at every zero of a boundary function that its event detection finds; the mode beyond a
boundary is asked for a little further along the path.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.integrate import solve_ivp

AHEAD = 1e-7


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

    def flow(self, x: np.ndarray, u: np.ndarray, tau: float) -> tuple[np.ndarray, list]:
        """x after τ seconds under a held input, and (time, mode) past every boundary met."""
        t, switches = 0.0, []
        force = self.B @ u

        def field(i):
            return lambda _, y: self.A[i] @ y + force[i]

        while True:
            i = self.mode(x + AHEAD * field(self.mode(x))(0.0, x)) if t == 0.0 else switches[-1][1]
            events = [lambda _, y, g=g: g(y) for g in self.boundaries]
            for event in events:
                event.terminal = True
            scale = 1e-14 * max(1.0, np.abs(x).max())
            # A restart lies on the boundary: step off it before looking for the next event.
            off = min(AHEAD, tau - t) if switches and switches[-1][0] == t else 0.0
            options = {"method": "DOP853", "rtol": 1e-13, "atol": scale}
            y = solve_ivp(field(i), (t, t + off), x, **options).y[:, -1] if off else x
            found = solve_ivp(
                field(i), (t + off, tau), y, events=events, max_step=tau / 8.0, **options
            )
            x = found.y[:, -1]
            if found.status == 0:
                return x, switches
            t = float(found.t[-1])
            switches.append((t, self.mode(x + AHEAD * field(i)(0.0, x))))


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
    for k in range(samples):
        u = control(x, pipe)
        pipe.append(u)
        inputs.append(u)
        for begin, length, held in ((0.0, phase, pipe[-N - 1]), (phase, step - phase, pipe[-N])):
            if length > 1e-12:
                x, found = plant.flow(x, held, length)
                for t, new in found:
                    if new != mode:  # some boundaries lie within a mode
                        switches.append((k * step + begin + t, new))
                        mode = new
        states.append(x)
    return np.array(states[:-1]), np.array(inputs), switches


def predictor(model: Plant, gains: np.ndarray, step: float):
    """u = K_r(P) P, with P the model's state a delay ahead."""
    N = int(np.ceil(round(model.delay / step, 9)))
    phase = model.delay - (N - 1) * step

    def control(x: np.ndarray, pipe: list[np.ndarray]) -> np.ndarray:
        x, _ = model.flow(x, pipe[-N], phase)
        for j in range(N - 1, 0, -1):
            x, _ = model.flow(x, pipe[-j], step)
        return gains[model.mode(x)] @ x

    return control
