"""Public logs: fit on the first half, free run over the second, beside ARX and FOPDT.

    python benchmarks/public_logs.py FOLDER

The logs are not part of this repository. FOLDER holds, under these names:

- `heating_system.dat`, `exchanger.dat`, `hairdryer.mat`, `ballbeam.mat`: the database DaISy (De
  Moor, KU Leuven): a halogen lamp over a plate, a steam heat exchanger, a laboratory hair dryer, a
  ball on a beam;
- `tclab.csv`: columns Time, Q1, Q2, T1, T2 of the thermal lab kit of APMonitor
  (SerfinHub/PIDNN, `tclab_data.csv`);
- `steering.csv`: sines of steering of a model car (Lorenzo-Lyons/DART, MIT licence,
  `40_sinusoidal_steering_data/car_1_Datarecording_01_22_2024_11_45_12.csv`), steering to yaw rate
  while its motor runs.

Fit: 100 (1 − ‖y − ŷ‖/‖y − mean(y)‖) over the second half, simulated from inputs alone; of the ball,
which rolls away by itself, over as many rows ahead as `Validation.horizon` has, for all three. ARX
has a constant, orders up to 6 and an input delay, chosen by Akaike's criterion on the first half;
FOPDT is fitted by `scipy.optimize.least_squares` from several starts. `dt.identify` takes the
order, 1 or 2, with the least BIC on the first half.
"""

import argparse
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.io import loadmat
from scipy.optimize import least_squares

import deadtime as dt

MOST_ORDER, ORDERS = 6, (1, 2)


class Log(NamedTuple):
    """Rows at an even step, the longest delay searched, and whether a free run is meaningful."""

    step: float
    u: np.ndarray
    y: np.ndarray
    longest: float
    free: bool = True

    def table(self, rows):
        u = np.atleast_2d(self.u.T)[:, rows]
        columns = {"t": self.step * np.arange(self.y.size)[rows], "y1": self.y[rows]}
        return pd.DataFrame(columns | {f"u{j + 1}": one for j, one in enumerate(u)})


def heating(folder):
    columns = np.loadtxt(folder / "heating_system.dat")
    return Log(2.0, columns[:, 1], columns[:, 2], 40.0)


def exchanger(folder):
    columns = np.loadtxt(folder / "exchanger.dat")
    return Log(1.0, columns[:, 1], columns[:, 2], 40.0)


def dryer(folder):
    columns = loadmat(folder / "hairdryer.mat")["hairdryer"]
    return Log(0.08, columns[:, 0], columns[:, 1], 0.8)


def ball(folder):
    columns = loadmat(folder / "ballbeam.mat")["ballbeam"]
    return Log(0.1, columns[:, 0], columns[:, 1], 1.0, free=False)


def kit(folder):
    table = pd.read_csv(folder / "tclab.csv")
    return Log(2.0, table[["Q1", "Q2"]].to_numpy(), table["T1"].to_numpy(), 60.0)


def steering(folder):
    table = pd.read_csv(folder / "steering.csv")
    table = table[table["safety_value"] == 1.0]
    t = table["elapsed time sensors"].to_numpy()
    t, own = np.unique(t, return_index=True)
    even = np.arange(t[0], t[-1], 0.1)
    held = own[np.searchsorted(t, even, side="right") - 1]
    yaw = np.interp(even, t, table["W (IMU)"].to_numpy()[own])
    return Log(0.1, table["steering"].to_numpy()[held], yaw, 1.0)


LOGS = {
    "heating system": heating,
    "heat exchanger": exchanger,
    "hair dryer": dryer,
    "thermal lab kit": kit,
    "steering of a model car": steering,
    "ball and beam": ball,
}


def fit_percent(y, simulated):
    return 100.0 * (1.0 - np.linalg.norm(y - simulated) / np.linalg.norm(y - y.mean()))


class ARX:
    """y_k = Σ a_i y_{k−i} + Σ b_i u_{k−d−i} + c."""

    def __init__(self, log, half):
        u = np.atleast_2d(log.u.T).T
        first = MOST_ORDER + int(np.ceil(log.longest / log.step))
        tried = []
        for order in range(1, MOST_ORDER + 1):
            for lag in range(first - MOST_ORDER + 1):
                z = self.regressors(log.y, u, np.arange(first, half), order, lag)
                weights, *_ = np.linalg.lstsq(z, log.y[first:half], rcond=None)
                rest = log.y[first:half] - z @ weights
                criterion = rest.size * np.log(np.mean(rest**2)) + 2.0 * weights.size
                tried.append((criterion, order, lag, weights))
        _, self.order, self.lag, self.weights = min(tried, key=lambda one: one[0])
        self.delay = (self.lag + 0.5) * log.step

    @staticmethod
    def regressors(y, u, k, order, lag):
        past = [y[k - 1 - i] for i in range(order)]
        inputs = [u[k - 1 - lag - i, j] for j in range(u.shape[1]) for i in range(order)]
        return np.column_stack([*past, *inputs, np.ones(k.size)])

    def simulated(self, log, start, stop, state=None):
        """Outputs from `start` to `stop`; before them they are as measured."""
        u, y = np.atleast_2d(log.u.T).T, log.y.copy()
        for k in range(start, stop):
            y[k] = (self.regressors(y, u, np.array([k]), self.order, self.lag) @ self.weights)[0]
        return y[start:stop]


class FOPDT:
    """τ dy/dt = −y + Σ_j K_j u_j(t − D) + c, by least squares on the first half."""

    def __init__(self, log, half):
        u = np.atleast_2d(log.u.T).T
        span, best = log.step * half, None
        for tau in np.geomspace(2.0 * log.step, 0.3 * span, 6):
            for delay in np.linspace(0.0, log.longest, 5):
                start = np.concatenate(([np.log(tau), delay], np.zeros(u.shape[1]), [0.0]))
                start[2:] = self._linear(log, u, half, tau, delay)
                found = least_squares(
                    lambda p: self._run(log, u, p, 0, half, log.y[0]) - log.y[:half],
                    start,
                    bounds=(
                        [-20.0, 0.0, *[-np.inf] * (u.shape[1] + 1)],
                        [20.0, log.longest, *[np.inf] * (u.shape[1] + 1)],
                    ),
                    x_scale="jac",
                )
                if best is None or found.cost < best.cost:
                    best = found
        self.p, self.delay = best.x, float(best.x[1])

    def _linear(self, log, u, half, tau, delay):
        """Gains and constant for given τ and D, by linear least squares."""
        columns = []
        for j in range(u.shape[1] + 1):
            p = np.concatenate(([np.log(tau), delay], np.zeros(u.shape[1] + 1)))
            p[2 + j] = 1.0
            columns.append(self._run(log, u, p, 0, half, 0.0))
        return np.linalg.lstsq(np.column_stack(columns), log.y[:half], rcond=None)[0]

    @staticmethod
    def _run(log, u, p, start, stop, y0):
        """Held inputs, exactly: the delay cuts a period in two."""
        tau, whole = np.exp(p[0]), int(np.floor(p[1] / log.step))
        share = p[1] / log.step - whole
        keep, late = np.exp(-log.step / tau), np.exp(-(1.0 - share) * log.step / tau)
        drive = u @ p[2:-1] + p[-1]
        k = np.arange(start, stop)
        older, newer = (drive[np.maximum(k - whole - i, 0)] for i in (1, 0))
        added = late * (1.0 - keep / late) * older + (1.0 - late) * newer
        y = np.empty(stop - start)
        y[0] = y0
        for i in range(1, y.size):
            y[i] = keep * y[i - 1] + added[i - 1]
        return y

    def simulated(self, log, start, stop):
        u = np.atleast_2d(log.u.T).T
        return self._run(log, u, self.p, start, stop, log.y[start])


def peer_fit(model, log, half, ahead):
    if log.free:
        return fit_percent(log.y[half:], model.simulated(log, half, log.y.size))
    rows = np.arange(half, log.y.size - ahead)
    far = [model.simulated(log, k, k + ahead + 1)[-1] for k in rows]
    return fit_percent(log.y[rows + ahead], np.array(far))


def identified(log, half):
    """The order with the least BIC, the plant, and its validation."""
    first, last = log.table(slice(0, half)), log.table(slice(half, None))
    fits = {}
    for order in ORDERS:
        try:
            fits[order] = dt.identify(first, modes=None, delay=(0.0, log.longest), order=order)
        except dt.ArgumentError as error:
            print(f"<!-- order {order}: {error} -->")

    def criterion(order):
        return len(fits[order].names) * np.log(half) - 2.0 * fits[order].log_likelihood

    order = min(fits, key=criterion)
    return order, fits[order], fits[order].compare(last)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--log", nargs="+", choices=LOGS, default=LOGS)
    parser.add_argument("--messages", action="store_true", help="print what identify says")
    given = parser.parse_args()
    print("| log | rows | identify: order, fit % | ARX: order, fit % | FOPDT: fit % |", end="")
    print(" delays, s | s |\n|---|---|---|---|---|---|---|")
    for name in given.log:
        log = LOGS[name](given.folder)
        half, began = log.y.size // 2, time.perf_counter()
        order, fit, validation = identified(log, half)
        seconds = time.perf_counter() - began
        arx, fopdt = ARX(log, half), FOPDT(log, half)
        ahead = round(validation.horizon / log.step)
        own = validation.free_run if log.free else validation.several_steps
        fits = (f"{peer_fit(one, log, half, ahead):.1f}" for one in (arx, fopdt))
        ends = ", ".join(f"{a:.3g} … {b:.3g}" for a, b in fit.delay_interval[0])
        print(
            f"| {name} | {log.y.size} | {order}, {own[0]:.1f} | {arx.order}, {next(fits)} | "
            f"{next(fits)} | {ends}; {arx.delay:.3g}; {fopdt.delay:.3g} | {seconds:.1f} |",
            flush=True,
        )
        if given.messages:
            print(fit.message, validation.message, sep="\n", flush=True)


if __name__ == "__main__":
    main()
