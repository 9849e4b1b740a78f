"""A study of a problem of one's own, swept without a cluster."""

from pathlib import Path

from scipy.stats import expon

import deadtime as dt
from deadtime.scenarios.sweeps import load_study
from deadtime.scenarios.sweeps.run_sweep import prepare, run_block

# Three modes, two inputs, a delay that is no multiple of the period; laws with gains of their own.
PROBLEM = """\
title = "Three modes"

[plant]
delay = 0.234
A = [
  [[0.2, 1.0, 0.0], [0.0, 0.4, 1.0], [0.3, 0.0, -0.5]],
  [[0.3, 1.1, 0.0], [0.1, 0.3, 0.9], [0.2, 0.0, -0.4]],
  [[0.1, 0.9, 0.1], [0.0, 0.5, 1.1], [0.4, 0.1, -0.6]],
]
B = [
  [[0.0, 1.0], [1.0, 0.0], [0.2, 1.0]],
  [[0.1, 1.0], [1.1, 0.0], [0.2, 0.9]],
  [[0.0, 0.9], [0.9, 0.1], [0.3, 1.1]],
]

[gains]
poles = [-1.5, -2.0, -2.5]

[[law]]
kind = "averaged"

[[law]]
kind = "averaged"
name = "told"
dwell_time = 0.1

[[law]]
kind = "expected"

[[law]]
kind = "exact"
name = "oracle"

[switching]
kind = "markov"
rates = [[0.0, 1.0, 2.0], [1.5, 0.0, 0.5], [1.0, 1.0, 0.0]]

[signal]
kind = "constant"
mode = 0

[run]
x0 = [1.0, -1.0, 0.5]
horizon = 2.0
step = 0.02
"""
STUDY = """\
title = "Own laws"
problem = "own.toml"
scenarios = 12
seed = 3

[grid]
plant.delay = [0.234, 0.31]
law.told.dwell_time = [0.1, 0.15]
delay_error = [-0.1, 0.0, 0.1]
"""


def load(folder, text=STUDY, problem=PROBLEM):
    (folder / "own.toml").write_text(problem, encoding="utf-8")
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return load_study(folder / "study.toml")


def filled(study, store):
    """The store of a study, its blocks computed one by one without a cluster."""
    target = prepare(study, str(store))
    for number in target.missing():
        run_block(study, target.url, target.key, number)
    return dt.open_sweep(store)


def tree(store):
    """Every file of a store."""
    root = Path(store)
    return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def make_loop(delay, weight):
    plant = dt.problems.paper().plant
    plant = dt.SwitchedSystem(plant.A, plant.B, delay)
    laws = {"mine": dt.AveragedPredictor(plant, dt.place(plant, [-1, -2]), [weight, 1.0 - weight])}
    model = dt.SemiMarkov(expon(0.1, 0.2), modes=2)
    x0 = [1.0, 0.0]
    return {"plant": plant, "laws": laws, "model": model, "x0": x0, "horizon": 1.5, "step": 0.05}
