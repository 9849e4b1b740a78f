r"""
An embedded engineer: from a data sheet to tested C
===================================================

A turntable is driven by a motor, with or without a part clamped on it, and its camera reports the
angle 250 ms late. You have a microcontroller, a timer and a budget of bytes. After this page you
can choose the period and the number format, write the C, and run that C against the plant on this
machine before it goes to the target.

**Source.** A motor as inertia and friction: G. F. Franklin, J. D. Powell and A. Emami-Naeini,
*Feedback Control of Dynamic Systems*, 2010, chapter 2. Ours are all numbers.
"""

import subprocess
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import deadtime as dt
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH
from deadtime.imperfections import Saturation

A = [[[0.0, 1.0], [0.0, -2.0]], [[0.0, 1.0], [0.0, -1.25]]]
B = [[[0.0], [10.0]], [[0.0], [6.25]]]
plant = dt.SwitchedSystem(A, B, delay=0.25)  # angle, speed; bare, with a part
law = dt.AveragedPredictor(plant, dt.place(plant, [-4.0, -5.0]))

# %%
# Which period, which numbers
# ---------------------------
#
# A shorter period decays faster and costs memory: the controller keeps the inputs of one delay.
# The proof holds for the loop as it will run, at that period, for every change of the load that
# keeps it for 0.5 s or more; the margin is the longest delay of the camera in either mode held.

for step in (0.005, 0.01, 0.02, 0.05):
    proof = dt.certify(plant, law, 0.5, step)
    margin = dt.delay_margin(plant, law, step)
    controller = dt.Controller(law, step, limits=(-12.0, 12.0))
    written = controller.export_c(f"c_{1e3 * step:.0f}", precision="float", name="turntable")
    print(
        f"{1e3 * step:3.0f} ms: decay {proof.decay_rate:.2f} /s, delay up to {margin.upper:.3f} s, "
        f"{written.rom} bytes of ROM, {written.ram} of RAM"
    )

# %%
# The C against the simulation
# ----------------------------
#
# `export_c` checks the C by itself, and the folder has that check for the target. Here a short
# `main` calls it as the interrupt will, with the samples of a simulated run.

step, folder = 0.01, Path("c_10")
MAIN = r"""
#include <stdio.h>
#include "turntable.h"
int main(void)
{
    static turntable_controller c;
    float x[TURNTABLE_STATES], u[TURNTABLE_INPUTS];
    int mode;
    (void)turntable_reset(&c, 0, 0);
    while (scanf("%d %f %f", &mode, &x[0], &x[1]) == 3) {
        (void)turntable_update(&c, x, mode, 0, 0, u);
        printf("%.9g\n", (double)u[0]);
    }
    return 0;
}
"""
(folder / "main.c").write_text(MAIN)
build = ["cc", "-std=c99", "-O2", "-Wall", "-o", "loop", "main.c", "turntable.c"]
subprocess.run(build, cwd=folder, check=True)

signal = dt.SwitchingSignal.random(2, horizon=4.0, dwell_time=0.5, seed=1)
limits = [Saturation(-12.0, 12.0)]
run = dt.simulate(plant, law, signal, [3.0, 0.0], 3.0, step, imperfections=limits)
samples = zip(run.mode, *run.states, strict=True)
lines = "".join(f"{mode} {angle} {speed}\n" for mode, angle, speed in samples)
called = subprocess.run([folder / "loop"], input=lines, capture_output=True, text=True, check=True)
u = np.array(called.stdout.split(), float)
print(f"C in single precision: at most {abs(u - run.inputs[0]).max():.1e} V from the simulation")

with rc_context(STYLE):
    figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(run.time, run.states[0], color=COLOURS[0])
    above.set(ylabel="angle (rad)")
    below.step(run.time, run.inputs[0], where="post", color=COLOURS[0], label="simulation")
    few = slice(None, None, 5)
    below.plot(run.time[few], u[few], ".", color=COLOURS[1], label="C, single precision")
    below.set(xlabel="time (s)", ylabel="input (V)")
    below.legend()
figure.savefig("embedded.png", dpi=120)

# %%
# On the target
# -------------
#
# Copy `turntable.h`, `turntable.c` and `turntable_tables.h` into the firmware, call
# `turntable_update` in the interrupt of a timer, and run `turntable_check.c` there once.
