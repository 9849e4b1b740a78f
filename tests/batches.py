"""Batches of switching signals, compared; and of scenarios, with single runs."""

import numpy as np
import pytest

import deadtime as dt
import plants
from deadtime.scenarios import draw_signals, scenario_seed

H, HORIZON, COUNT, SEED = 0.1, 6.03, 11, 5
SHORT = 0.1, 0.47, 1.95  # of few samples in the second half
X0 = (0.3, -0.6, 0.9)


def equal(one, other):
    """Whether two batches are the same, bit for bit."""
    return all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("first", "times", "modes", "end", "initial_age")
    )


def require_single_runs(plant, laws, given, rows=(0, 8, 10), horizon=HORIZON, x0=X0, short=SHORT):
    """Every law's scenarios are those of `simulate`, to 1e-12 of the largest; so are short runs."""
    model, x0 = dt.Markov(2.0 * (1.0 - np.eye(plant.modes))), list(x0[: plant.states])
    for end in (horizon, *short):
        data = dt.monte_carlo(
            plant, laws, model, x0, end, H, COUNT, SEED, imperfections=given, trajectories=True
        )
        assert data.attrs["one_by_one"] == []
        signals = draw_signals(model, end + 1.0, SEED, count=COUNT)
        for name, law in laws.items():
            for i in rows:
                run = dt.simulate(
                    plant, law, signals[i], x0, end, H, imperfections=given,
                    seed=scenario_seed(SEED, i),
                )  # fmt: skip
                found, where = data.sel(law=name).isel(scenario=i), (name, i, end)
                samples = found.time.size
                plants.close(found.x.values, run.states[:, :samples], 1e-12)
                plants.close(found.u.values, run.inputs[:, :samples], 1e-12)
                for metric, value in run.metrics().items():
                    assert found[metric].item() == pytest.approx(value, rel=1e-10), (metric, *where)
