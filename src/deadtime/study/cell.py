"""One cell of a study: its plant, laws and signals, and what becomes of every law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from deadtime.errors import DeadtimeError
from deadtime.gains import place
from deadtime.laws import Law
from deadtime.monte_carlo import monte_carlo, scenario_seed
from deadtime.plant import SwitchedSystem
from deadtime.study.laws import Setting, kinds_of
from deadtime.study.sojourns import sojourn_of
from deadtime.study.study import Cell, Study
from deadtime.switching import SemiMarkov, SwitchingSignal

if TYPE_CHECKING:
    import xarray as xr

# Variables of the dataset, as `monte_carlo` calls them: (unit, long name).
VARIABLES = {
    "ise": ("x^2 s", "integral of |x|^2"),
    "energy": ("u^2 s", "integral of |u|^2"),
    "peak": ("x", "maximum of |x| over the samples"),
    "final_norm": ("x", "|x| at the end"),
}


@dataclass(frozen=True, eq=False)
class Outcome:
    """What was measured in one cell.

    Attributes
    ----------
    cell : Cell
    values : mapping
        From a variable to an array (law, scenario); NaN in the rows of laws that failed.
    diverged : (law, scenario) array
    reasons : mapping
        From the laws that could not be built to why.
    """

    cell: Cell
    values: Mapping[str, np.ndarray]
    diverged: np.ndarray
    reasons: Mapping[str, str]


def run_cell(study: Study, cell: Cell) -> Outcome:
    """Run every law of a study in one cell."""
    shape = (len(study.laws), study.scenarios)
    values = {name: np.full(shape, np.nan) for name in VARIABLES}
    diverged = np.zeros(shape, dtype=bool)
    try:
        setting = setting_of(study, cell)
        laws, reasons = laws_of(study, setting)
        if laws:
            data = _measured(study, setting, laws)
            rows = [study.laws.index(law) for law in laws]
            for name, array in values.items():
                array[rows] = data[name].values
            diverged[rows] = data.diverged.values
    except DeadtimeError as error:
        reasons = dict.fromkeys(study.laws, str(error))
    return Outcome(cell, values, diverged, reasons)


def _measured(study: Study, setting: Setting, laws: Mapping[str, Law]) -> xr.Dataset:
    """The metrics of every law on every signal, each different signal run once."""
    signals = signals_of(study, setting)
    run = partial(monte_carlo, setting.plant, laws, x0=study.x0, horizon=study.horizon)
    if study.imperfections:
        # Equal signals do not make equal runs.
        return run(signals, step=setting.step, seed=study.seed, imperfections=study.imperfections)
    places: dict[tuple[bytes, bytes], int] = {}
    which = [
        places.setdefault((signal.times.tobytes(), signal.modes.tobytes()), len(places))
        for signal in signals
    ]
    distinct = [signals[which.index(place)] for place in range(len(places))]
    return run(distinct, step=setting.step).isel(scenario=which)


def setting_of(study: Study, cell: Cell) -> Setting:
    """The plant, gains and switching of a cell."""
    apart = study.plant.apart(cell.distance)
    plant = SwitchedSystem(apart.A, apart.B, cell.delay)
    poles = np.array(study.poles)
    return Setting(
        plant=plant,
        gains=place(plant, poles),
        mean_gain=place(plant.mean(), poles)[0],
        model=SemiMarkov(sojourn_of(cell.sojourn, cell.dwell_time), modes=plant.modes),
        dwell_time=cell.dwell_time,
        step=cell.step,
    )


def laws_of(study: Study, setting: Setting) -> tuple[dict[str, Law], dict[str, str]]:
    """The laws with their tables filled; and why the others could not be built."""
    laws, reasons = {}, {}
    kinds = kinds_of(setting.plant.modes)
    for name in study.laws:
        try:
            law = kinds[name].make(setting)
            law.digital(setting.step, SwitchingSignal.constant(0), 1)
        except DeadtimeError as error:
            reasons[name] = str(error)
        else:
            laws[name] = law
    return laws, reasons


def signals_of(study: Study, setting: Setting) -> list[SwitchingSignal]:
    """The cell's signals, known up to the end of the oracle's last prediction."""
    end = study.horizon + setting.plant.delay
    return [
        setting.model.sample(end, seed=scenario_seed(study.seed, i)) for i in range(study.scenarios)
    ]
