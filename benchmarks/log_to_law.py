"""From a hidden plant to the C that controls it: is a loop that the verdict passes stable?

    python benchmarks/log_to_law.py --draws 100

Plants are drawn: 1–3 states, 1–2 inputs, 1–3 modes, a fractional delay per input, in many draws
with one input per mode, rates of growth up to 0.8 1/s. Each is logged for 8–40 s with random inputs
and noise of 0.3–30 % of them, in runs of 4 s from rest, the mode changing at any time. The log
goes through `identify`, LQR, `design` where LQR's margin is narrower than the delay's interval,
`certify`, `export_c`. The verdict says so if `Identification.verdict` says enough, the likeliest
plant and two drawn from the covariance, delays included, are certified one by one for every signal
with the dwell time.

Then gcc compiles the C, and it is stepped against the hidden plant, whose every period is a product
of SciPy's exponentials between switches and arrivals: no code of the package. Stable: within
300 s |x| falls to 1e-6 of its largest, or to a tenth where it decays slowly, in every mode held,
under the fastest switching, a random signal (both off the grid) and the worst signal that `falsify`
finds for the hidden plant.
"""

from __future__ import annotations

import argparse
import ctypes
import itertools
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.linalg import expm

import deadtime as dt
from deadtime.controller.export.compiler import compiler

H = 0.1
RUN = 40  # samples of a run of the log
LONG = 3000  # samples of a closed loop
DRAWN = 2
FALLEN, GROWN = 1e-6, 1e6


class Hidden:
    """A plant, its exact steps; D (modes, m)."""

    def __init__(self, rng):
        n, m, modes = (int(rng.integers(1, top + 1)) for top in (3, 2, 3))
        first = rng.standard_normal((n, n))
        near = first + 0.3 * rng.standard_normal((modes, n, n))
        fastest = np.linalg.eigvals(near).real.max(axis=1)
        growth = rng.uniform(-1.0, 0.8)
        self.A = near + (growth - fastest.max()) * np.eye(n)
        self.B = rng.standard_normal((n, m)) + 0.2 * rng.standard_normal((modes, n, m))
        self.per_mode = bool(rng.random() < 0.5) and modes > 1 == m
        D = rng.uniform(0.1, 0.6, (modes if self.per_mode else 1, m))
        self.D = np.broadcast_to(D, (modes, m))
        self.modes, self.n, self.m = modes, n, m

    def over(self, mode, x, u, time):
        """x after a while in a mode under a constant input."""
        Z = np.zeros((self.n + self.m,) * 2)
        Z[: self.n, : self.n], Z[: self.n, self.n :] = self.A[mode], self.B[mode]
        return (expm(Z * time) @ np.concatenate((x, u)))[: self.n]

    def period(self, k, x, sent, times, modes):
        """x a period later; `sent[k]` is u_k, the signal is `modes[i]` from `times[i]` on."""
        start, stop = k * H, (k + 1) * H
        arrivals = (np.arange(k + 2)[-30:, None, None] * H + self.D).ravel()
        cuts = np.concatenate((times, arrivals))
        cuts = np.unique(cuts[(cuts > start + 1e-10) & (cuts < stop - 1e-10)])
        edges = np.concatenate(([start], cuts, [stop]))
        for a, b in itertools.pairwise(edges):
            middle = 0.5 * (a + b)
            i = modes[np.searchsorted(times, middle) - 1]
            late = np.floor((middle - self.D[i]) / H).astype(int)
            u = [sent[q][j] if q >= 0 else 0.0 for j, q in enumerate(late)]
            x = self.over(i, x, u, b - a)
        return x


def signal(rng, modes, dwell, end, mean):
    """Sojourns of the dwell time and an exponential one more."""
    count = int(end / dwell) + 2
    lasts = dwell * (1.0 + 1e-6) + mean * rng.standard_exponential(count)
    steps = rng.integers(1, modes, count) if modes > 1 else np.zeros(count, int)
    times = np.concatenate(([0.0], np.cumsum(lasts)[:-1]))
    return times, (rng.integers(modes) + np.cumsum(steps)) % modes


def logged(plant, rng, dwell):
    """Runs from rest with white inputs, noise of the plant in its states."""
    noise = 10.0 ** rng.uniform(-2.5, -0.5) * np.sqrt(H)
    found = []
    for _ in range(int(rng.integers(2, 11))):
        times, modes = signal(rng, plant.modes, dwell, RUN * H, dwell)
        x, u = np.zeros((RUN, plant.n)), rng.standard_normal((RUN, plant.m))
        for k in range(RUN - 1):
            x[k + 1] = plant.period(k, x[k], u, times, modes) + noise * rng.standard_normal(plant.n)
        t = H * np.arange(RUN)
        columns = {"t": t, "mode": modes[np.searchsorted(times, t, side="right") - 1]}
        columns |= {f"x{i + 1}": one for i, one in enumerate(x.T)}
        found.append(pd.DataFrame(columns | {f"u{j + 1}": one for j, one in enumerate(u.T)}))
    return found


def judged(fit, dwell, cheap):
    """A law for what was identified, and whether the verdict passes it; why not."""
    gains = dt.lqr(fit.plant, np.eye(fit.plant.states), cheap * np.eye(fit.plant.inputs))
    law = dt.AveragedPredictor(fit.plant, gains)
    said = fit.verdict(dt.delay_margin(fit.plant, law, fit.step), law)
    designed = False
    if "ot enough" in said or "no delay at all" in said:
        apart = np.abs(fit.delay_interval / fit.delays[..., None] - 1.0).max()
        found = dt.design(fit.plant, delay_margin=min(2.0 * apart, 0.9), step=fit.step, budget=60)
        law, designed = found.law, True
        said = fit.verdict(dt.delay_margin(fit.plant, law, fit.step), law)
    if "ot enough" in said or "no delay at all" in said:
        return law, designed, "margin"
    for one in (fit.plant, *fit.uncertain.draw(DRAWN, seed=1)):
        if not dt.certify(one, law, dwell, H, decay_rate=0.0, search_signals=False).proven:
            return law, designed, "certificate"
    return law, designed, ""


class Controller:
    """The exported C, compiled."""

    def __init__(self, law, folder):
        written = dt.Controller(law, H).export_c(folder)
        assert written.check.passed, written.check
        source, self.m = folder / "controller.c", law.plant.inputs
        command = [*(compiler() or ["gcc"]), "-std=c99", "-O2", "-fPIC", "-shared"]
        subprocess.run([*command, str(source), "-o", str(folder / "c.so")], check=True)
        self.library, self.memory = (
            ctypes.CDLL(str(folder / "c.so")),
            ctypes.create_string_buffer(1 << 20),
        )

    def reset(self):
        self.library.controller_reset(self.memory, None, 0)

    def update(self, x, mode):
        u = (ctypes.c_double * self.m)()
        given = (ctypes.c_double * len(x))(*x)
        status = self.library.controller_update(self.memory, given, int(mode), None, None, u)
        assert status in (0, 5), status
        return list(u)


def falls(plant, controller, times, modes, rng):
    """Whether |x| falls to a millionth of its largest under the C."""
    controller.reset()
    x, sent = rng.standard_normal(plant.n), []
    top, window = 0.0, []
    for k in range(LONG):
        sent.append(controller.update(x, modes[np.searchsorted(times, k * H + 1e-9) - 1]))
        x = plant.period(k, x, sent, times, modes)
        size = float(np.abs(x).max())
        top, window = max(top, size), [*window[-39:], size]
        if size > GROWN:
            return False
        if max(window) < FALLEN * top:
            return True
    return bool(max(window) < 0.1 * top)


def stable(plant, law, controller, dwell, rng):
    """Under modes held, the fastest switching, random signals, and the worst one found."""
    signals = [(np.array([0.0]), np.array([i])) for i in range(plant.modes)]
    if plant.modes > 1:
        signals += [signal(rng, plant.modes, dwell, LONG * H, mean) for mean in (0.0, dwell)]
        truth = dt.SwitchedSystem(plant.A, plant.B, plant.D)
        worst = dt.falsify(truth, law, dwell, H)
        run = worst.simulate(int(np.ceil(LONG * H / worst.length)) + 1).signal
        signals.append((run.times, run.modes))
    return all(falls(plant, controller, *one, rng) for one in signals)


def draw(seed):
    """What becomes of one plant: passed or why not, whether it is stable, whether designed."""
    rng = np.random.default_rng(seed)
    plant, dwell = Hidden(rng), float(rng.uniform(0.4, 1.5))
    try:
        fit = dt.identify(
            logged(plant, rng, dwell), delay=(0.0, 0.8), noise=False, per_mode=plant.per_mode
        )
        if fit.plant.modes < plant.modes:
            return "a mode that was not logged", None, False
        law, designed, why = judged(fit, dwell, 10.0 ** rng.uniform(-2.0, 1.0))
    except dt.DeadtimeError as error:
        return f"refused: {error}"[:70], None, False
    with tempfile.TemporaryDirectory() as place:
        return why, stable(plant, law, Controller(law, Path(place)), dwell, rng), designed


def main():
    parser = argparse.ArgumentParser(description="From hidden plants to the C that controls them.")
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    began, rows = time.process_time(), []
    for seed in range(given.first, given.first + given.draws):
        rows.append(draw(seed))
        why, fine, designed = rows[-1]
        end = {None: "–", True: "stable", False: "UNSTABLE"}[fine]
        print(f"{seed}: {why or 'passed'}{', designed' * designed}; {end}", flush=True)
    passed = [fine for why, fine, _ in rows if not why]
    others = [fine for why, fine, _ in rows if why and fine is not None]
    print(f"the verdict passes {len(passed)} of {len(rows)}, of which {sum(passed)} are stable")
    print(f"of {len(others)} others that have a law {sum(others)} are stable")
    print(f"{time.process_time() - began:.0f} s of a processor")
    sys.exit(int(not all(passed)))


if __name__ == "__main__":
    main()
