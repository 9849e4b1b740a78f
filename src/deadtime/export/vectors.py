"""Test vectors: what a controller is given, hostile calls among it, and what it answers."""

from __future__ import annotations

import math

import numpy as np

from deadtime.controller import Controller

_PERIODS, _MOST = 300, 3000


def vectors(controller: Controller) -> tuple[str, float, int]:
    """A CSV table of calls, the largest sum of moduli of terms, and the longest line."""
    run = Controller(controller.law, controller.step, limits=(controller.low, controller.high))
    plant, table = controller.law.plant, run.table
    n, m, rng = plant.states, plant.inputs, np.random.default_rng(0)
    count = min(_PERIODS + 2 * table.taps, _MOST)
    modes = np.repeat(rng.integers(0, plant.modes, count), rng.integers(1, 30, count))[:count]
    seen, time = 1.0, 0.0
    heading = [
        *("time", "mode"),
        *(f"x{i}" for i in range(n)),
        *(f"applied{i}" for i in range(m)),
        "status",
        *(f"u{i}" for i in range(m)),
    ]
    lines = [",".join(heading)]
    for k in range(count):
        x, applied, mode = rng.normal(size=n), None, int(modes[k])
        if k % 3 == 0:
            applied = rng.normal(size=m)
        if k % 53 == 20:
            x[k % n] = (math.nan, math.inf, -math.inf)[k % 3]
        if k % 61 == 30:
            applied = np.full(m, math.nan)
        if k % 71 == 40:
            mode = plant.modes + k
        when = None
        if k > count // 2:  # clocks: jitter, periods without a call, calls out of order
            time += controller.step * (k % 47 != 5) * (1 + (k % 29 == 7) * (1 + k % 5))
            when = time + 0.3 * controller.step * math.sin(k)
        u = run.update(x, mode, applied, time=when)
        seen = max(seen, float(np.abs(u).max()))
        given = [math.nan] * m if applied is None else applied.tolist()
        fields = ["" if when is None else repr(when), str(mode), *map(repr, x.tolist())]
        fields += [""] * m if applied is None else map(repr, given)
        lines.append(",".join([*fields, str(int(run.status)), *map(repr, u.tolist())]))
    scale = float(np.abs(table.state_gain).sum(axis=2).max()) * 5.0
    scale += float(np.abs(table.input_gain).sum(axis=(1, 3)).max()) * max(seen, 5.0)
    return "\n".join(lines) + "\n", scale, max(map(len, lines))
