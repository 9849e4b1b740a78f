"""What is called immutable is: after pickle and deepcopy too, and nothing is compiled anew."""

import copy
import dataclasses
import pickle

import numpy as np
import pandas as pd
import pytest

import deadtime as dt
from deadtime.base.checks import read_only
from deadtime.base.frozen import Frozen
from deadtime.imperfections import Noise, Saturation, StepDisturbance

PAPER = dt.problems.paper()
PLANT, GAINS, H = PAPER.plant, PAPER.gains, 0.1
SIGNAL = dt.SwitchingSignal([0.0, 0.33, 0.9], [0, 1, 0], end=3.0, initial_age=0.2)
LAW = dt.AveragedPredictor(PLANT, GAINS)
SWITCHING = dt.Markov([[0.0, 1.0], [2.0, 0.0]])
ONE = dt.SwitchedSystem([[[-1.0, 1.0], [0.0, -2.0]]], [[[0.0], [1.0]]], 0.25)
HALF = dt.HalfSpace([1.0, 0.0], 0.0)
STABLE = dt.MeanPredictor(ONE, [[0.0, -0.5]])


def observer():
    return dt.luenberger(PLANT, [[1.0, 0.0]], [-3.0, -4.0], step=H)


def disturbed():
    wave = [StepDisturbance([0.0, 1.0], 0.3), Noise([0.1, 0.2]), Saturation(-50.0, 50.0)]
    return dt.simulate(PLANT, LAW, SIGNAL, [-1, 1], 2.0, step=H, imperfections=wave)


def predicted():
    controller = dt.Controller(LAW, H)
    controller.update([1.0, -1.0])
    return controller.prediction


def mode_filter():
    return dt.ModeFilter(PLANT, SWITCHING, H, disturbance=1e-3)


def identified():
    """Of a log whose sensors are noisy: a filter's tables are kept, too."""
    rng = np.random.default_rng(0)
    x, u = np.zeros(60), rng.standard_normal(60)
    for k in range(1, 59):
        x[k + 1] = 0.9 * x[k] + 0.05 * (u[k] + u[k - 1]) + 0.02 * rng.standard_normal()
    log = pd.DataFrame({"t": H * np.arange(60), "x": x + 0.02 * rng.standard_normal(60), "u": u})
    return dt.identify(log, modes=None, delay=(0.0, 0.3), noise=True, test=0.3)


def modes_identified():
    """Of a log without its modes: the likelihood of a chain is kept, too."""
    rng, mode = np.random.default_rng(0), (np.arange(160) // 20) % 2
    x, u = np.zeros(160), rng.standard_normal(160)
    for k in range(1, 159):
        push = 0.1 - 0.2 * mode[k]
        x[k + 1] = 0.9 * x[k] + push * (u[k] + u[k - 1]) + 0.01 * rng.standard_normal()
    log = pd.DataFrame({"t": H * np.arange(160), "x": x, "u": u})
    return dt.identify(log, modes=2, delay=(0.0, 0.3), switches="samples")


# What users hold: one of each kind, made in as little time as possible.
OBJECTS = {
    "SwitchedSystem": lambda: PLANT,
    "UncertainPlant": lambda: dt.UncertainPlant(ONE, 1e-4 * np.eye(7)),
    "SwitchingSignal": lambda: SIGNAL,
    "SignalBatch": lambda: dt.SignalBatch.of([SIGNAL, SIGNAL]),
    "Markov": lambda: dt.Markov([[0.0, 1.0], [2.0, 0.0]]),
    "MarkovChain": lambda: dt.MarkovChain([[0.9, 0.1], [0.2, 0.8]], 0.1),
    "SemiMarkov": lambda: dt.SemiMarkov([0.3, 0.5]),
    "HalfSpace": lambda: HALF,
    "Polyhedra": lambda: dt.Polyhedra([([[1.0, 0.0]], [0.0]), ([[-1.0, 0.0]], [0.0])]),
    "QuadraticRegions": lambda: dt.QuadraticRegions([np.eye(2), 2.0 * np.eye(2)]),
    "InitialStates": lambda: dt.InitialStates.box([1.0, 2.0]),
    "StationaryNoise": lambda: dt.StationaryNoise(0.1, [0.2, 0.3]),
    "Weight": lambda: dt.Weight([1.0, 2.0], 0.1),
    "AveragedPredictor": lambda: dt.AveragedPredictor(PLANT, GAINS, weights=[0.25, 0.75]),
    "SingleModePredictor": lambda: dt.SingleModePredictor(PLANT, GAINS, 0),
    "MeanPredictor": lambda: PAPER.laws["mean"],
    "ExactPredictor": lambda: dt.ExactPredictor(PLANT, GAINS, SIGNAL),
    "ExpectedPredictor": lambda: dt.ExpectedPredictor(PLANT, GAINS, dt.Markov([[0, 1], [2, 0]])),
    "DelayedStateFeedback": lambda: dt.DelayedStateFeedback(PLANT, GAINS),
    "StateDependentPredictor": lambda: dt.StateDependentPredictor(PLANT, GAINS, HALF),
    "LowPassPredictor": lambda: dt.LowPassPredictor(LAW, 0.1),
    "OptimalPredictor": lambda: dt.OptimalPredictor(
        PLANT, dt.SemiMarkov([0.3, 0.5]), np.eye(2), [[1.0]]
    ),
    "Observer": observer,
    "OutputFeedback": lambda: dt.OutputFeedback(LAW, observer()),
    "ModeFilter": mode_filter,
    "OutputModeFilter": lambda: dt.OutputModeFilter(
        PLANT, SWITCHING, H, [[1.0, 0.0]], covariance=1.0, disturbance=1e-3, noise=0.1
    ),
    "BeliefPredictor": lambda: dt.BeliefPredictor(
        dt.ExpectedPredictor(PLANT, GAINS, SWITCHING), mode_filter()
    ),
    "Prediction": predicted,
    "Identification": identified,
    "Validation": lambda: identified().validation,
    "Identification of modes": modes_identified,
    "Experiment": lambda: dt.design_experiment(
        dt.SwitchedSystem([[[-1.0]]], [[[1.0]]], 0.07), 3.0, H, 1.0, disturbance=1.0, effort=0
    ),
    "Feedback": lambda: LAW.digital(H),
    "Feedback of a user": lambda: dt.Feedback(np.ones((1, 1, 2)), np.ones((1, 3, 1, 1)), "none", H),
    "Problem": lambda: dataclasses.replace(
        PAPER, gains=np.array(GAINS), x0=np.array([1.0, 2.0]), notes=()
    ),
    "Noise": lambda: Noise(np.array([0.1, 0.2])),
    "a run": lambda: dt.simulate(PLANT, LAW, SIGNAL, [-1, 1], 2.0, step=H),
    "a run with imperfections": disturbed,
    "a run of a law that estimates": lambda: dt.simulate(
        PLANT, dt.OutputFeedback(LAW, observer()), SIGNAL, [-1, 1], 1.0, step=H
    ),
    "a run under a rule": lambda: dt.simulate(
        PLANT, LAW, HALF, [-1, 1], 1.0, step=H, times=[0.05, 0.5]
    ),
    "the ideal run": lambda: dt.simulate(PLANT, LAW, SIGNAL, [-1, 1], 1.0, step=None),
    "common_lyapunov": lambda: dt.common_lyapunov(ONE, [[[0.0, -0.5]]]),
    "characteristic_roots": lambda: dt.characteristic_roots(ONE, STABLE, 0),
    "delay_margin": lambda: dt.delay_margin(ONE, STABLE, step=H),
    "gain_margin": lambda: dt.gain_margin(ONE, STABLE, step=H),
    "delay_limit": lambda: dt.delay_limit(PLANT),
    "falsify": lambda: dt.falsify(ONE, STABLE, 0.5, step=H),
}


def arrays(value, path, seen):
    """Every array that can be reached from an object, by where it is."""
    if id(value) in seen:
        return
    seen[id(value)] = value
    if isinstance(value, np.ndarray):
        yield path, value
    elif isinstance(value, dict):
        for key, part in value.items():
            yield from arrays(part, f"{path}[{key!r}]", seen)
    elif isinstance(value, (list, tuple)):
        for i, part in enumerate(value):
            yield from arrays(part, f"{path}[{i}]", seen)
    elif dataclasses.is_dataclass(value):
        for name, part in vars(value).items():
            yield from arrays(part, f"{path}.{name}", seen)


def pickled(value):
    return pickle.loads(pickle.dumps(value))


@pytest.fixture(scope="module")
def made():
    """Each object made once, as used: an answer first, so that what it keeps is there."""
    kept = {}

    def make(name):
        if name not in kept:
            kept[name] = OBJECTS[name]()
            if isinstance(kept[name], dt.Trajectory):
                kept[name].metrics()
            elif isinstance(kept[name], dt.Law) and hasattr(kept[name], "online"):
                kept[name].online(H, SIGNAL, 3)
        return kept[name]

    return make


@pytest.mark.few(5)
@pytest.mark.parametrize("again", [lambda v: v, pickled, copy.deepcopy, copy.copy])
@pytest.mark.parametrize("name", OBJECTS)
def test_no_array_of_an_immutable_object_can_be_written_to(name, again, made):
    value = again(made(name))
    found = dict(arrays(value, name, {}))
    assert found or name in ("SemiMarkov",)
    assert [path for path, array in found.items() if array.flags.writeable] == []
    for array in found.values():
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_every_public_dataclass_with_arrays_is_among_those_tried(made):
    public = [getattr(dt, name) for name in dt.__all__]
    holding = {
        kind.__name__
        for kind in public
        if isinstance(kind, type)
        and dataclasses.is_dataclass(kind)
        and any("np.ndarray" in str(field.type) for field in dataclasses.fields(kind))
    }
    tried = {type(made(name)).__name__ for name in OBJECTS}
    untried = {"Design", "Servo", "Law", "FunctionRule", "WorstCase"}
    assert holding - tried - untried == set()
    assert all(issubclass(getattr(dt, name), Frozen) for name in holding)


def test_a_run_answers_alike_whatever_is_done_to_what_it_handed_out():
    run = dt.simulate(PLANT, LAW, SIGNAL, [-1, 1], 2.0, step=H)
    before = run.metrics()
    for frame in (run.to_pandas(), run.to_xarray().to_dataframe()):
        frame[:] = 0.0
    table = run.to_xarray(), run.to_pandas()
    table[0]["x"].values[:] = 0.0
    run.history[:] = 0.0
    assert run.metrics() == before


def test_an_object_takes_its_own_copy_of_what_can_be_written_to():
    x0 = np.array([1.0, 2.0])
    problem = dataclasses.replace(PAPER, x0=x0)
    x0[:] = 5.0
    assert problem.x0.tolist() == [1.0, 2.0]
    shared = read_only(x0)
    assert dataclasses.replace(PAPER, x0=shared).x0 is shared


@pytest.mark.parametrize("again", [pickled, copy.deepcopy])
def test_a_law_and_a_run_answer_alike_after_pickle_and_compile_nothing(monkeypatch, again):
    from deadtime.laws.tables import along_signal as rows
    from deadtime.numerics import exponential, kernels
    from deadtime.plant import pieces
    from deadtime.simulation import digital_kernel, record_kernel

    monkeypatch.setattr(kernels, "WISH", "always")
    compiled = [
        function.dispatcher
        for module in (digital_kernel, record_kernel, rows, pieces, exponential)
        for function in vars(module).values()
        if isinstance(function, kernels.Kernel)
    ]

    def ask(plant, law, signal):
        run = dt.simulate(plant, law, signal, [-1, 1], 1.25, step=H, times=[0.07, 1.0, 1.21])
        return law.digital(H).state_gain, run.states, run.metrics()

    law = dt.AveragedPredictor(PLANT, GAINS)
    first = ask(PLANT, law, SIGNAL)
    run = dt.simulate(PLANT, law, SIGNAL, [-1, 1], 1.25, step=H)
    figures = run.metrics()
    before = [len(function.signatures) for function in compiled]
    second = ask(*again((PLANT, law, SIGNAL)))
    third = again(run)
    assert third.metrics() == figures
    assert (
        third.record.states_at(np.array([0.61])) == run.record.states_at(np.array([0.61]))
    ).all()
    assert [len(function.signatures) for function in compiled] == before
    assert (first[0] == second[0]).all()
    assert (first[1] == second[1]).all()
    assert first[2] == second[2]
