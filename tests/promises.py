"""What inputs promise of a plant of `synthetic_logs`, along modes, without a search."""

from typing import Any

import numpy as np

import deadtime as dt
from deadtime.identification.experiment import root_of
from deadtime.identification.experiment_information import (
    ExactStates,
    NoiseTables,
    NoisyStates,
    chain_of,
)
from deadtime.identification.input_design import Prospect
from deadtime.identification.parameters import Layout


def prospect(plant, mode, used, step, *, law=None, sensors: Any = 0.0):
    """That of a log of rows `mode`, of which the periods `used` count; `sensors` are deviations."""
    given = dt.SwitchedSystem(plant.A, plant.B, plant.D)
    per_mode = len(np.unique(plant.D, axis=0)) > 1
    layout = Layout(given.modes, given.states, given.inputs, per_mode)
    S = np.array([plant.covariance(i, step) for i in range(given.modes)])
    cells = np.ceil(plant.D / step - 1e-9).astype(int)
    deviation = np.broadcast_to(np.asarray(sensors, float), given.states)
    table = law and law.digital(step)
    chain = chain_of(given, step, mode, S, cells, layout, table, deviation**2)
    measured = ExactStates.of(chain, used, layout.size)
    if deviation.any():
        tables = NoiseTables.of(layout, given.A, root_of(plant.W, deviation, step), step)
        measured = NoisyStates.of(chain, used, layout.size, tables)
    return Prospect.of(chain, layout, measured)
