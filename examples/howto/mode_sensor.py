"""
What is a mode sensor worth?
============================

The same law with its mode measured, reported late, and with a belief in its place, beside laws that
know nothing of the mode: over how long modes last, how much noise there is, and how far apart the
modes are.
The cost is the median of ``∫|x|²`` over 400 signals, relative to a measured mode.
"""

import numpy as np
from matplotlib.figure import Figure

import deadtime as dt
from deadtime.imperfections import ModeDelay, WhiteDisturbance

STEP, HORIZON, LATE, SIGNALS = 0.02, 15.0, 5, 400
NAMES = ("belief", f"reported {LATE} periods late", "averaged", "mean")


def costs(plant, poles, sojourn, noise, x0=(-1.0, 1.0)):
    """Median ∫|x|² by what is known of the mode, and the share of signals that are stabilised."""
    gains, count = dt.place(plant, poles), plant.modes
    rates = np.full((count, count), 1.0 / (sojourn * (count - 1)))
    model = dt.Markov(rates - np.diag(np.diag(rates)))
    law = dt.ExpectedPredictor(plant, gains, model)
    filt = dt.ModeFilter(plant, model, STEP, disturbance=noise**2)
    laws = {
        "measured": law,
        "belief": dt.BeliefPredictor(law, filt),
        "averaged": dt.AveragedPredictor(plant, gains),
        "mean": dt.MeanPredictor(plant, dt.place(plant.mean(), poles)[0], gains),
    }
    push, late = [WhiteDisturbance(noise**2)], {NAMES[1]: law}
    common = model, np.asarray(x0), HORIZON, STEP, SIGNALS
    parts = [
        dt.monte_carlo(plant, laws, *common, imperfections=push),
        dt.monte_carlo(plant, late, *common, imperfections=[*push, ModeDelay(LATE)]),
    ]
    cost, share = {}, {}
    for data in parts:
        for name in data.law.values.tolist():
            own = data.sel(law=name)
            cost[name] = float(own.ise.median())
            share[name] = float((own.final_norm < np.linalg.norm(x0)).mean())
    return cost, share


def apart(plant, distance):
    """The plant with its modes moved to so many times their distance from the first."""
    A = plant.A[0] + distance * (plant.A - plant.A[0])
    return dt.SwitchedSystem(A, plant.B[0] + distance * (plant.B - plant.B[0]), plant.delay)


paper, three = dt.problems.paper().plant, dt.problems.three_mode().plant
sojourns, noises, distances = (
    [0.2, 0.4, 0.8, 1.6, 3.2],
    [0.001, 0.003, 0.01, 0.03, 0.1],
    [0.1, 0.25, 0.5, 0.75, 1.0],
)
PANELS = {
    "two modes: mean sojourn (s)": [(s, paper, (-1, -2), s, 0.01) for s in sojourns],
    "three modes: mean sojourn (s)": [(s, three, (-2, -3), s, 0.01) for s in sojourns[1:]],
    "two modes, 0.8 s: noise": [(w, paper, (-1, -2), 0.8, w) for w in noises],
    "two modes, 0.8 s: distance": [(d, apart(paper, d), (-1, -2), 0.8, 0.01) for d in distances],
}
figure = Figure(figsize=(7.2, 5.4), layout="constrained", dpi=150)
panels = figure.subplots(2, 2, sharey=True).flat
for panel, (title, cells) in zip(panels, PANELS.items(), strict=True):
    found = [(cell[0], *costs(*cell[1:])) for cell in cells]
    print(title)
    for value, cost, share in found:
        ratios = ", ".join(f"{name} {cost[name] / cost['measured']:.3g}" for name in NAMES)
        stable = ", ".join(f"{name} {100 * part:.0f} %" for name, part in share.items())
        print(f"  {value:g}: measured {cost['measured']:.3g}; times as much: {ratios}; {stable}")
    for name, look in zip(NAMES, ("o-", "s--", "^-.", "v:"), strict=True):
        ratio = [cost[name] / cost["measured"] for _, cost, _ in found]
        panel.loglog([value for value, *_ in found], ratio, look, label=name)
    panel.axhline(1.0, color="black", linewidth=0.8)
    panel.set_title(title, fontsize=9.5, loc="left")
    panel.set_xticks([cell[0] for cell in cells], [f"{cell[0]:g}" for cell in cells])
    panel.set_yticks([1, 2, 5, 10, 20, 50], ["1", "2", "5", "10", "20", "50"])
    panel.minorticks_off()
figure.supylabel("cost, relative to a measured mode", fontsize=10)
figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
figure.savefig("mode_sensor.png")
