"""Every cell of a sweep is Monte Carlo on its values, and whatever fails in it is its reason."""

import numpy as np

import deadtime as dt
from deadtime.scenarios.sweeps.cell import run_cell
from own_sweep import STUDY, filled, load, make_loop


def test_every_cell_is_monte_carlo_on_the_problem_with_its_values(own):
    study, data = own
    assert data.ise.dims == (
        "plant.delay", "law.told.dwell_time", "delay_error", "law", "scenario",
    )  # fmt: skip
    base = study.base
    plant = dt.SwitchedSystem(base.plant.A, base.plant.B, 0.31)
    gains = dt.place(plant, [-1.5, -2.0, -2.5])
    model = dt.Markov([[0.0, 1.0, 2.0], [1.5, 0.0, 0.5], [1.0, 1.0, 0.0]])
    laws = {
        "averaged": dt.AveragedPredictor(plant, gains),
        "told": dt.AveragedPredictor(plant, gains, dwell_time=0.15),
        "expected": dt.ExpectedPredictor(plant, gains, model),
        "oracle": dt.ExactPredictor(plant, gains),
    }
    truth = dt.SwitchedSystem(plant.A, plant.B, 0.31 * (1.0 - 0.1))
    direct = dt.monte_carlo(truth, laws, model, [1.0, -1.0, 0.5], 2.0, 0.02, scenarios=12, seed=3)
    here = data.isel({"plant.delay": 1, "law.told.dwell_time": 1, "delay_error": 0})
    for name in ("ise", "energy", "cost", "peak", "settling_time", "decay_rate", "final_norm"):
        np.testing.assert_array_equal(here[name].values, direct[name].values)
        assert here[name].attrs == direct[name].attrs
    assert data.attrs["oracle"] == "oracle"
    assert data.done.all()


def test_equal_signals_are_run_once_and_counted_as_often_as_they_come(tmp_path):
    text = STUDY.split("plant.delay")[0] + 'dwell_time = 0.3\nsojourn = "fixed"\n'
    text = text.replace("seed = 3", 'seed = 3\nlaws = ["averaged", "oracle"]')
    study = load(tmp_path, text.replace("12", "40"))
    outcome = run_cell(study, next(study.cells()))
    loop = study.loop(next(study.cells()))
    direct = dt.monte_carlo(
        loop.plant, loop.laws, loop.model, loop.x0, 2.0, 0.02, scenarios=40, seed=3
    )
    np.testing.assert_array_equal(outcome.metrics["cost"], direct.cost.values)


def test_a_law_that_cannot_be_built_in_a_cell_leaves_its_reason_and_the_others_run(tmp_path):
    text = STUDY.split("plant.delay")[0] + "law.told.dwell_time = [-1.0, 0.1]\n"
    study = load(tmp_path, text)
    data = filled(study, tmp_path / "x.zarr").load()
    bad = data.isel({"law.told.dwell_time": 0})
    assert "dwell_time" in bad.reason.sel(law="told").item()
    assert bad.ise.sel(law="told").isnull().all()
    assert bad.ise.drop_sel(law="told").notnull().all()
    assert (data.isel({"law.told.dwell_time": 1}).reason == "").all()
    assert data.done.all()


def test_a_diverging_loop_is_counted_in_its_reason(tmp_path):
    text = STUDY.split("plant.delay")[0] + "gain_error = [0.0, 8.0]\n"
    study = load(tmp_path, text.replace("seed = 3", 'horizon = 200.0\nlaws = ["averaged"]'))
    data = filled(study, tmp_path / "x.zarr").load()
    assert (data.reason.isel(gain_error=0) == "").all()
    count = int(data.diverged.isel(gain_error=1).sel(law="averaged").sum())
    text = data.reason.isel(gain_error=1).sel(law="averaged").item()
    assert count > 0
    assert text == f"diverged on {count} of 12 scenarios"


def failing(delay, weight):
    made = make_loop(delay, 0.5)
    if weight == 1:
        raise ValueError("no such weight")
    if weight == 2:
        made["laws"] = {"other": made["laws"]["mine"]}
    if weight == 3:
        made["laws"] = {}
    return made | ({"step": None} if weight == 4 else {})


def test_whatever_fails_in_a_cell_is_its_reason_and_the_others_run(tmp_path):
    study = dt.function_study(failing, {"delay": [0.1], "weight": [0, 1, 2, 3, 4]}, scenarios=3)
    data = filled(study, tmp_path / "x.zarr").load().squeeze()
    assert data.ise.notnull().all("scenario").values.tolist() == [True, *[False] * 4]
    for reason, start in zip(
        data.reason.values,
        ["", "function failed: ValueError: no such", "laws must be named alike", "laws must hold",
         "step must be a number"],
        strict=True,
    ):  # fmt: skip
        assert reason.startswith(start)
        assert bool(reason) == bool(start)


class Ages:
    """Signals that are equal but for how old their first mode is."""

    def sample(self, horizon, seed=0):
        return dt.SwitchingSignal([0.0, 0.4], [0, 1], initial_age=0.05 * (seed % 7))


def test_signals_of_different_ages_are_not_taken_for_equal_ones():
    def loop():
        made = make_loop(0.3, 0.5)
        plant = made["plant"]
        gains = dt.place(plant, [-1.5, -2.0, -2.5][: plant.states])
        return made | {
            "laws": {"aware": dt.AveragedPredictor(plant, gains, dwell_time=0.31)},
            "model": Ages(),
        }

    study = dt.function_study(loop, {}, scenarios=30)
    cell = next(study.cells())
    outcome, made = run_cell(study, cell), study.loop(cell)
    assert outcome.reasons == ("",)
    direct = dt.monte_carlo(
        made.plant, made.laws, made.model, made.x0, made.horizon, made.step, scenarios=30
    )
    assert np.unique(direct.cost).size == 7
    np.testing.assert_array_equal(outcome.metrics["cost"], direct.cost.values)
