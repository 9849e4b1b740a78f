"""Print 644 figures of the package to the last bit, one a line; to compare two versions of it.

    python scripts/figures.py > before    (another version)    python scripts/figures.py > after
    diff before after

Runs, margins, certificates, many signals, sweeps and exports of five plants, by the public names
alone. A figure is printed as a hexadecimal float, so that no digit is lost; a file by its digest.
"""

from __future__ import annotations

import hashlib
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

import deadtime as dt

RUN = ("ise", "energy", "cost", "peak", "settling_time", "decay_rate", "final_norm")
SWITCHES = (0.0, 0.3718, 0.81, 1.3727, 1.8, 2.5234, 3.16)


class Case(NamedTuple):
    """A plant with what else a figure of it needs."""

    name: str
    plant: dt.SwitchedSystem
    gains: np.ndarray
    x0: np.ndarray
    step: float


def cases() -> Iterator[Case]:
    """Three plants from the literature, and two with two inputs and a fractional delay."""
    for make, step in (
        (dt.problems.paper, 0.05),
        (dt.problems.three_mode, 0.1),
        (dt.problems.follower, 0.1),
    ):
        problem = make()
        yield Case(make.__name__, problem.plant, problem.gains, problem.x0, step)
    for name, modes, seed, delay in (("two inputs", 3, 4, 0.234), ("one mode", 1, 9, 0.57)):
        rng = np.random.default_rng(seed)
        A, B = rng.normal(size=(modes, 3, 3)), rng.normal(size=(modes, 3, 2))
        plant = dt.SwitchedSystem(A, B, delay)
        yield Case(name, plant, dt.place(plant, [-1.0, -1.5, -2.0]), np.ones(3), 0.1)


def laws(case: Case) -> dict[str, dt.Law]:
    """Laws of every kind of row: one, by mode, by mode and age, and by sample."""
    plant, K = case.plant, case.gains
    poles = np.linalg.eigvals(plant.A[0] + plant.B[0] @ K[0])
    mean = dt.place(plant.mean(), poles)[0]
    filtered = 0.05 * np.eye(plant.inputs)
    found: dict[str, dt.Law] = {
        "averaged": dt.AveragedPredictor(plant, K),
        "dwell-aware": dt.AveragedPredictor(plant, K, None, 0.31),
        "mean": dt.MeanPredictor(plant, mean),
        "single": dt.SingleModePredictor(plant, K, plant.modes - 1),
        "oracle": dt.ExactPredictor(plant, K),
        "delayed": dt.DelayedStateFeedback(plant, K),
        "low-pass": dt.LowPassPredictor(dt.AveragedPredictor(plant, K), filtered),
    }
    if plant.modes > 1:
        found["expected"] = dt.ExpectedPredictor(plant, K, model(plant.modes))
        cost = np.eye(plant.states), np.eye(plant.inputs)
        found["optimal"] = dt.OptimalPredictor(plant, model(plant.modes), *cost, ages=20)
    return found


def model(modes: int) -> dt.Markov:
    """A Markov model without symmetry."""
    rates = 0.2 + np.random.default_rng(2).random((modes, modes))
    return dt.Markov(rates * (1.0 - np.eye(modes)))


def runs(case: Case) -> Iterator[tuple[str, float]]:
    """What every law costs along switches off the grid, alone and with all imperfections."""
    signal = dt.SwitchingSignal(SWITCHES, [k % case.plant.modes for k in range(len(SWITCHES))])
    if case.plant.modes == 1:
        signal = dt.SwitchingSignal.constant(0)
    i = dt.imperfections
    late = i.MeasurementDelay(case.step)
    imperfect = (i.Noise(0.01), late, i.Saturation(-5.0, 5.0), i.Dropout(0.1))
    for name, law in laws(case).items():
        run = dt.simulate(case.plant, law, signal, case.x0, 4.0, case.step)
        for metric in RUN:
            yield f"{name}: {metric}", run.metrics()[metric]
        if name not in ("low-pass", "optimal"):  # these have no form without a step
            run = dt.simulate(case.plant, law, signal, case.x0, 4.0, None)
            yield f"{name}: ideal cost", run.metrics()["cost"]
        run = dt.simulate(
            case.plant, law, signal, case.x0, 4.0, case.step, imperfections=imperfect, seed=3
        )
        yield f"{name}: imperfect cost", run.metrics()["cost"]


def margins(case: Case) -> Iterator[tuple[str, float]]:
    """Growth, roots and margins in one mode, and a proof for a law that has one."""
    made = laws(case)
    for name in ("averaged", "mean", "single", "delayed", "low-pass"):
        law = made[name]
        for mode in range(case.plant.modes):
            yield f"{name}: growth in mode {mode}", dt.growth_rate(case.plant, law, mode, case.step)
    roots = dt.characteristic_roots(case.plant, made["averaged"], 0).roots
    yield "largest root", float(max(roots.real))
    margin = dt.delay_margin(case.plant, made["averaged"], case.step)
    for side in ("lower", "upper"):
        yield f"{side} delay margin", float(getattr(margin, side) or np.nan)


def many_signals(case: Case) -> Iterator[tuple[str, float]]:
    """Mean costs over random signals, on a plant that is not the law's."""
    if case.plant.modes == 1:
        return
    truth = dt.SwitchedSystem(1.01 * case.plant.A, case.plant.B, case.plant.delay)
    made = laws(case)
    table = dt.monte_carlo(truth, made, model(case.plant.modes), case.x0, 3.0, case.step, 40)
    for name in made:
        for metric in ("cost", "peak"):
            yield f"{name}: mean {metric}", float(table[metric].sel(law=name).mean())


def files(case: Case) -> Iterator[tuple[str, str]]:
    """The exported C of laws with one row and with rows by mode."""
    for name in ("averaged", "low-pass", "delayed"):
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder) / "c"
            dt.Controller(laws(case)[name], case.step).export_c(place)
            for path in sorted(place.iterdir()):
                yield f"{name}: {path.name}", hashlib.sha256(path.read_bytes()).hexdigest()


def certificates() -> Iterator[tuple[str, float]]:
    """Of plants and dwell times where something is proved, or refuted."""
    problem = dt.problems.paper()
    law = dt.AveragedPredictor(problem.plant, problem.gains)
    found = dt.theorem_bound(problem.plant, problem.gains, 10.0)
    yield "theorem's bound", float(found.epsilon_star)
    slow = dt.SwitchedSystem(0.2 * problem.plant.A, problem.plant.B, 0.3)
    K = dt.place(slow, [-1.0, -1.5])
    law = dt.AveragedPredictor(slow, K)
    proof = dt.certify(slow, law, 1.0, 0.1)
    yield "proved", float(bool(proof))
    yield "proved decay rate", float(proof.decay_rate)
    worst = dt.falsify(slow, law, 1.0, 0.1)
    yield "worst growth rate", float(worst.growth_rate)


def main() -> None:
    for case in cases():
        for part in (runs, margins, many_signals, files):
            for name, figure in part(case):
                text = figure if isinstance(figure, str) else float(figure).hex()
                print(f"{case.name}: {name}: {text}", flush=True)
    for name, figure in certificates():
        print(f"certificates: {name}: {float(figure).hex()}")


if __name__ == "__main__":
    sys.exit(main())
