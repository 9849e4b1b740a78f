"""Make motor.csv: a DC motor whose arm is in or out, driven over a bus, by `scipy.solve_ivp`.

    python examples/logs/motor.py

    J dω/dt = k i − b ω + load,    L di/dt = V(t − 0.0263 s) − R i − k ω

R = 1 Ω, L = 0.05 H, k = 0.1 N m/A, b = 5e-4 N m s; J = 1e-3 kg m² with the arm in, 2.5e-3 with it
out. The voltage is white, 3 V rms, held for 0.01 s, and arrives 26.3 ms late; load and supply
jitter every 2 ms. Sampled every 0.01 s, written with six digits. No code of deadtime.
"""

from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

H, FINE, DELAY, COUNT = 0.01, 0.002, 0.0263, 900
R, L, k, b = 1.0, 0.05, 0.1, 5e-4
J = {"in": 1e-3, "out": 2.5e-3}


def main(path):
    """Integrate from jump to jump of voltage and noise."""
    rng = np.random.default_rng(11)
    volts = 3.0 * rng.standard_normal(COUNT)
    arm = np.repeat(["in", "out"] * COUNT, rng.integers(20, 60, 2 * COUNT))[:COUNT]
    x, rows = np.zeros(2), ["t,speed,current,voltage,arm"]
    for row in range(COUNT):
        rows.append(f"{H * row:.2f},{x[0]:.6g},{x[1]:.6g},{volts[row]:.6g},{arm[row]}")
        start = row * H
        arrival = start + (DELAY % H)
        marks = np.unique(np.append(start + FINE * np.arange(6), arrival))
        for begin, end in pairwise(marks):
            sent = int(np.floor((0.5 * (begin + end) - DELAY) / H))
            V = (volts[sent] if sent >= 0 else 0.0) + 0.2 * rng.standard_normal()
            load = 2e-3 * rng.standard_normal()

            def motor(_, y, V=V, load=load, J=J[arm[row]]):
                return [(k * y[1] - b * y[0] + load) / J, (V - R * y[1] - k * y[0]) / L]

            x = solve_ivp(motor, (begin, end), x, rtol=1e-9, atol=1e-12).y[:, -1]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(__file__).with_name("motor.csv"))
