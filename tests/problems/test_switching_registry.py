"""The registry of switching models: one entry makes a model known to files, what a model writes of
itself is read back as that model, and laws take whoever keeps to the interface."""

import tomllib
from pathlib import Path
from types import ModuleType
from typing import Literal

import numpy as np
import pytest
from pydantic import TypeAdapter
from scipy import stats

import deadtime as dt
from deadtime.problems.file.schema import Switching
from deadtime.problems.switching_registry import (
    ENTRIES,
    SwitchingSection,
)
from deadtime.problems.toml.sections import collect
from deadtime.switching import SwitchingModel
from deadtime.switching.models.model import SampledChain

TURNS = [[0.0, 0.3, 0.7], [0.5, 0.0, 0.5], [1.0, 0.0, 0.0]]
MODELS = {
    "markov": dt.Markov([[0.0, 2.0], [1.0, 0.0]]),
    "markov-chain": dt.MarkovChain([[0.9, 0.1], [0.25, 0.75]], 0.05),
    "semi-markov": dt.SemiMarkov(
        [stats.gamma(3.0, scale=0.2), 0.4, stats.expon(loc=0.3, scale=0.5)],
        TURNS,
        dwell_time=0.1,
        maximum_dwell=[1.5, 0.4, np.inf],
    ),
}


class HeldSwitching(SwitchingSection):
    """An entry that is whole."""

    kind: Literal["held"]

    def build(self, modes, folder):
        return dt.Markov(np.zeros((modes + 1, modes + 1)))

    def promise(self, model):
        return None, None, model.transitions


def module(*entries):
    result = ModuleType("mine")
    for one in entries:
        one.__module__ = "mine"
        setattr(result, one.__name__, one)
    return result


def test_every_kind_but_the_one_that_reads_logs_is_tried_here():
    kinds = {entry.model_fields["kind"].annotation.__args__[0] for entry in ENTRIES}
    assert kinds == {*MODELS, "fitted"}


@pytest.mark.parametrize("kind", MODELS)
def test_what_a_model_writes_of_itself_is_read_as_the_same_model(kind):
    model = MODELS[kind]
    table = tomllib.loads(model.section())["switching"]
    assert table["kind"] == kind
    read = TypeAdapter(Switching).validate_python(table).model(model.modes, Path())
    assert type(read) is type(model)
    one, other = model.chain(0.05, 30), read.chain(0.05, 30)
    np.testing.assert_allclose(one.hazard, other.hazard, rtol=0.0, atol=1e-14)
    np.testing.assert_array_equal(one.jump, other.jump)
    np.testing.assert_array_equal(model.transitions, read.transitions)
    assert one.within == other.within
    np.testing.assert_allclose(model.sample(20.0, seed=3).times, read.sample(20.0, seed=3).times)


def test_a_distribution_without_a_name_is_refused_in_a_file():
    class Own:
        def cdf(self, t):
            return np.where(np.asarray(t) >= 0.3, 1.0, 0.0)

        def sf(self, t):
            return 1.0 - self.cdf(t)

    with pytest.raises(dt.ArgumentError, match=r"no name in scipy\.stats"):
        dt.SemiMarkov(Own()).section()


def test_an_entry_that_is_whole_is_taken():
    assert collect("switching model", SwitchingSection, [module(HeldSwitching)]) == (HeldSwitching,)


@pytest.mark.parametrize("name", ["build", "promise"])
def test_an_entry_that_lacks_something_is_refused_by_its_name(name):
    parts = {
        key: vars(HeldSwitching)[key] for key in ("__doc__", "build", "promise") if key != name
    }
    lacking = type(
        "Lacking", (SwitchingSection,), parts | {"__annotations__": {"kind": Literal["x"]}}
    )
    with pytest.raises(
        dt.ArgumentError, match=f"switching model entry Lacking in mine lacks {name}"
    ):
        collect("switching model", SwitchingSection, [module(lacking)])


def test_a_model_of_other_modes_than_the_plant_is_refused_by_its_kind():
    with pytest.raises(dt.ArgumentError, match="kind = 'held' describes 3 modes, the plant has 2"):
        HeldSwitching(kind="held").model(2, Path())


class Alternating(SwitchingModel):
    """Modes 0 and 1 in turn, each for as many periods: not known to the package."""

    step, periods = 0.05, 4
    modes, generator = 2, None
    transitions = ~np.eye(2, dtype=bool)
    mean = np.full(2, step * periods)

    def ages(self, step, most=None):
        return self.periods

    def chain(self, step, ages=1):
        hazard = np.where(np.arange(ages) + 1 >= self.periods, 1.0, 0.0)
        return SampledChain(np.tile(hazard, (2, 1)), 1.0 - np.eye(2), within=False)

    def switches(self, horizon, seed=0, first=0, count=1):
        return dt.SemiMarkov(self.step * self.periods).switches(horizon, seed, first, count)

    def section(self):
        return f'[switching]\nkind = "alternating"\nperiods = {self.periods}'


def test_laws_filters_and_batches_take_a_model_that_the_package_does_not_know():
    problem, model = dt.problems.paper(), Alternating()
    known = dt.SemiMarkov(model.step * model.periods)
    tables, beliefs = [], []
    for one in (model, known):
        tables.append(dt.ExpectedPredictor(problem.plant, problem.gains, one).digital(0.05))
        options = {"disturbance": 1e-4, "switches": "samples"}
        beliefs.append(dt.ModeFilter(problem.plant, one, 0.05, **options).form())
    np.testing.assert_array_equal(tables[0].input_gain, tables[1].input_gain)
    np.testing.assert_array_equal(tables[0].state_gain, tables[1].state_gain)
    np.testing.assert_array_equal(beliefs[0].hazard, beliefs[1].hazard)
    assert dt.ModeFilter(problem.plant, model, 0.05, disturbance=1e-4).switches == "samples"
    assert dt.ModeFilter(problem.plant, known, 0.05, disturbance=1e-4).switches == "anywhere"
    drawn = [dt.draw_signals(one, 2.0, seed=1, count=3) for one in (model, known)]
    np.testing.assert_array_equal(drawn[0].times, drawn[1].times)
