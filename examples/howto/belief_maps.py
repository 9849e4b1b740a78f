"""
Where a belief does for a mode sensor
=====================================

The same law with its mode measured and with a belief in its place, over how long modes last, how
much noise there is, and how far apart the modes are: one sweep, kept as a dataset. Above, the cost
of the belief relative to a measured mode (medians of ``∫|x|²``); below, how many of a hundred
signals it stabilises, over how many a measured mode does.
"""

import itertools

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import deadtime as dt
from deadtime.imperfections import WhiteDisturbance

STEP, HORIZON, SIGNALS, X0 = 0.02, 15.0, 100, np.array([-1.0, 1.0])
AXES = {
    "noise": [0.003, 0.03, 0.1],
    "distance": [0.25, 0.5, 0.75, 1.0],
    "sojourn": [0.2, 0.4, 0.8, 1.6, 3.2],
}


def apart(plant, distance):
    """The plant with its modes moved to so many times their distance from the first."""
    A = plant.A[0] + distance * (plant.A - plant.A[0])
    return dt.SwitchedSystem(A, plant.B[0] + distance * (plant.B - plant.B[0]), plant.delay)


def cell(noise, distance, sojourn):
    """Median cost and share stabilised, measured and believed."""
    plant = apart(dt.problems.paper().plant, distance)
    model = dt.Markov([[0.0, 1.0 / sojourn], [1.0 / sojourn, 0.0]])
    law = dt.ExpectedPredictor(plant, dt.place(plant, [-1.0, -2.0]), model)
    filt = dt.ModeFilter(plant, model, STEP, disturbance=noise**2)
    laws = {"measured": law, "believed": dt.BeliefPredictor(law, filt)}
    push = [WhiteDisturbance(noise**2)]
    data = dt.monte_carlo(plant, laws, model, X0, HORIZON, STEP, SIGNALS, imperfections=push)
    stable = data.final_norm < np.linalg.norm(X0)
    found = {"cost": data.ise.median("scenario"), "stabilised": stable.mean("scenario")}
    return xr.Dataset(found).reset_coords(drop=True)


cells = [cell(*values) for values in itertools.product(*AXES.values())]
sweep = xr.concat(cells, "cell").assign_coords(
    xr.Coordinates.from_pandas_multiindex(
        xr.DataArray(0, coords=AXES, dims=list(AXES)).stack(cell=list(AXES)).indexes["cell"], "cell"
    )
)
sweep = sweep.unstack("cell")
print(sweep)

ratio = sweep.cost.sel(law="believed") / sweep.cost.sel(law="measured")
share = 100.0 * sweep.stabilised
figure = Figure(figsize=(7.2, 5.0), layout="constrained", dpi=150)
panels = figure.subplots(2, len(AXES["noise"]), sharex=True, sharey=True)
for column, noise in enumerate(AXES["noise"]):
    one = share.sel(noise=noise)
    for panel, values, look in (
        (panels[0, column], ratio.sel(noise=noise), {"cmap": "Oranges", "vmin": 1.0, "vmax": 1.4}),
        (panels[1, column], one.sel(law="believed"), {"cmap": "Greens", "vmin": 0.0, "vmax": 160}),
    ):
        values = values.transpose("distance", "sojourn").values
        image = panel.imshow(values, origin="lower", aspect="auto", **look)
        for (i, j), value in np.ndenumerate(values):
            text = f"{value:.2f}"
            if panel is panels[1, column]:
                measured = one.sel(law="measured").transpose("distance", "sojourn").values[i, j]
                text = f"{value:.0f}\n{measured:.0f}"
            panel.text(j, i, text, ha="center", va="center", fontsize=7)
        panel.set_xticks(range(len(AXES["sojourn"])), [f"{x:g}" for x in AXES["sojourn"]])
        panel.set_yticks(range(len(AXES["distance"])), [f"{y:g}" for y in AXES["distance"]])
    panels[0, column].set_title(f"noise s = {noise:g}", fontsize=9.5)
panels[0, 0].set_ylabel("cost, believed / measured", fontsize=9)
panels[1, 0].set_ylabel("stabilised of 100,\nbelieved over measured", fontsize=9)
figure.supylabel("distance of the modes", fontsize=10)
figure.supxlabel("mean sojourn in a mode, s", fontsize=10)
figure.savefig("belief_maps.png")
