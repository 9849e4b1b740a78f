"""An upright arm that picks up a load and sets it down: is it stable, whenever it does so?

Two modes, empty and loaded; gravity tips the arm over, and the motor answers 0.3 s late. The
numbers are made up. What one learns: a certificate speaks about every signal with a dwell time,
a witness about one; and a stability margin, here of the load, lies between the two.
"""

import deadtime as dt
from deadtime.witness_plot import plot_witness

DELAY, DWELL_TIME, STEP = 0.3, 0.4, 0.02


def arm(load):
    """The arm and its law; `load` is the inertia that the load adds, the arm's own being 1."""
    inertias = (1.0, 1.0 + load)
    A = [[[0.0, 1.0], [1.0, -0.2 / inertia]] for inertia in inertias]
    B = [[[0.0], [1.0 / inertia]] for inertia in inertias]
    plant = dt.SwitchedSystem(A, B, DELAY)
    return plant, dt.AveragedPredictor(plant, dt.place(plant, [-2.0, -3.0]))


plant, law = arm(load=0.5)
certificate = dt.certify(plant, law, DWELL_TIME, STEP)
print(f"load 0.5: {certificate.message}")
print(f"load 0.5: {dt.delay_margin(plant, law, STEP).message}")

margin = dt.stability_margin(arm, (0.1, 10.0), DWELL_TIME, STEP)
print(f"load: {margin.message}")
figure = plot_witness(margin.witness, f"Load {margin.refuted:.3g}", ["empty", "loaded"])
figure.savefig("certificates.png")
