"""
An epidemic, reported late
==========================

Authorities hold an epidemic at a level that hospitals can bear, by restrictions that people
follow more at some times than at others. What they see today is nine days old, and what they
decide takes another four. What one learns: reacting to the reports as if they were fresh makes
waves, of the authorities' own making; predicting over the thirteen days does not.

**Source.** F. Casella, "Can the COVID-19 epidemic be controlled on the basis of daily test
reports?", IEEE Control Systems Letters, arXiv 2003.06967 (2020), with the values that his model
library COVID19Control fits to Italy, spring 2020: R₀ = 4, latent rate ε = 0.23 per day, contact
rate 1.3 per day (hence γ = 1.3/4), 9 days until reports show, 4 days to decide and act. Ours are
the aim (to hold a level rather than suppress), half obedience in the second mode, when it comes,
and the gains.
"""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from scipy.linalg import expm

import deadtime as dt
from deadtime.base.figure_style import COLOURS, STYLE, WIDTH

LATENT, RECOVERY, R0 = 0.23, 1.3 / 4.0, 4.0  # 1/day, 1/day, -
DELAY, PERIOD = 9.0 + 4.0, 1.0  # days
OBEDIENCE = (1.0, 0.5)

# %%
# The model, and what is linearised
# ---------------------------------
#
# While nearly everybody is susceptible, exposed E and infectious I obey
#
#     dE/dt = R γ I − ε E,    dI/dt = ε E − γ I,    R = 1 + c u(t − D),
#
# u being the change of the reproduction number that is ordered and c the part of it that is
# obeyed. Relative to the level aimed at, e = E/E* − 1 and i = I/I* − 1 with γ I* = ε E*. The
# model is bilinear, in R I; what is dropped is the product u i of two deviations.


def rates(e, i, u, obedience):
    """de/dt and di/dt, per day, before linearisation."""
    return LATENT * ((1.0 + obedience * u) * (1.0 + i) - (1.0 + e)), RECOVERY * (e - i)


A = [[[-LATENT, LATENT], [RECOVERY, -RECOVERY]]] * 2
B = [[[LATENT * part], [0.0]] for part in OBEDIENCE]
plant = dt.SwitchedSystem(A, B, DELAY)
gains = dt.lqr(plant, np.diag([0.0, 3.0]), [[1.0]], step=PERIOD)
laws = {
    "predicted (averaged)": dt.AveragedPredictor(plant, gains),
    "as if reports were fresh": dt.DelayedStateFeedback(plant, gains),
}
for name, law in laws.items():
    growth = [dt.growth_rate(plant, law, mode, PERIOD) for mode in (0, 1)]
    print(f"{name:25s} growth {growth[0]:+.4f}, {growth[1]:+.4f} per day")
margin = dt.delay_margin(plant, laws["predicted (averaged)"], PERIOD)
print(f"predicted: stable for true delays from {margin.lower:.1f} to {margin.upper:.1f} days")

# %%
# On the model that is not linear
# -------------------------------
#
# ``Controller`` is what would run on the target. R cannot go beyond R₀, when nothing is
# restricted, nor below one half, which we take for the hardest lockdown: limits of the
# controller. R being constant over a day, the model moves by a matrix exponential each day, so
# that this simulation is exact, too.


def simulate_bilinear(law, obeyed, start, days):
    """Day by day the level (1 is the aim) and the R ordered, from (E/E*, I/I*) on day 0."""
    controller = dt.Controller(law, PERIOD, limits=(-0.5, R0 - 1.0))
    pipe, x = [0.0] * int(DELAY), np.array(start)
    levels, ordered = [], []
    for day in range(days):
        mode = int(obeyed(day))
        x = x * FESTIVAL if day == 150 else x
        u = float(controller.update(x - 1.0, mode)[0])
        pipe.append(u)
        R = 1.0 + OBEDIENCE[mode] * pipe.pop(0)
        levels.append(x[1])
        ordered.append(1.0 + u)
        x = expm(np.array([[-LATENT, LATENT * R], [RECOVERY, -RECOVERY]])) @ x
    return np.array(levels), np.array(ordered)


FESTIVAL = 1.3  # on day 150
obeyed = dt.SwitchingSignal([0.0, 120.0, 200.0], [0, 1, 0])
days, start = 300, [1.3, 1.3]
with rc_context(STYLE):
    figure = Figure(figsize=(1.3 * WIDTH, 4.4))
    upper, middle, lower = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2.2, 0.8))
    for colour, (name, law) in zip(COLOURS, laws.items(), strict=False):
        levels, ordered = simulate_bilinear(law, obeyed, start, days)
        upper.plot(levels, color=colour, label=name)
        middle.step(range(days), ordered, where="post", color=colour)
        print(f"{name:25s} peak {levels.max():.2f} times the aim, last 100 days "
              f"{levels[-100:].min():.2f} to {levels[-100:].max():.2f}")  # fmt: skip
    upper.set(ylabel="infectious / aim", title="30 % too many, on day 0 and on day 150")
    middle.set(ylabel="R ordered")
    lower.step(range(days), obeyed(np.arange(days)), where="post", color=COLOURS[6], linewidth=1)
    lower.set_yticks((0, 1), ("obeyed", "half obeyed"))
    lower.set(xlim=(0, days - 1), ylim=(-0.3, 1.3), xlabel="time (days)")
    figure.align_ylabels()
    figure.legend(loc="outside lower center", ncols=2)
figure.savefig("epidemic.png", dpi=110)

# %%
# What did linearisation cost? The same law, from the same start, on the linear model:

levels, _ = simulate_bilinear(laws["predicted (averaged)"], obeyed, start, 150)
linear = dt.simulate(plant, laws["predicted (averaged)"], obeyed, [0.3, 0.3], 149.0, PERIOD)
print(f"linear and bilinear model differ by {np.abs(levels - 1 - linear.states[1]).max():.3f}")
