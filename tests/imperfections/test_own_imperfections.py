"""Limits and noise of a user's own: engines go by what they say of themselves, not by class."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import deadtime as dt
import plants
from by_period import MODEL, PLANT, SIGNAL, X0, require_same
from deadtime.cli.export import _controller
from deadtime.imperfections import (
    ActuatorImperfection,
    Additive,
    Disturbance,
    Limiting,
    Limits,
    Relaying,
    Saturation,
    SensorImperfection,
    StepDisturbance,
    TimingImperfection,
)
from deadtime.simulation.outcome import is_pushed

LAW = plants.LAWS["averaged"](MODEL)


@dataclass(frozen=True)
class Valve(Limiting, ActuatorImperfection):
    """A valve that closes faster than it opens."""

    opens: float
    closes: float

    def limits(self, sizes):
        ones = np.ones(sizes.inputs) * sizes.step
        return Limits(-self.closes * ones, self.opens * ones, True)


@dataclass(frozen=True)
class Fuse(Limiting, ActuatorImperfection):
    """At most so much of any input."""

    most: float

    def limits(self, sizes):
        most = np.full(sizes.inputs, self.most)
        return Limits(-most, most, False)


@dataclass(frozen=True)
class Deadband(ActuatorImperfection):
    """Small inputs do nothing: this is no limit."""

    width: float

    def actuator(self, sizes):
        return lambda asked, before: np.where(np.abs(asked) < self.width, 0.0, asked)


@dataclass(frozen=True)
class Drift(Additive, SensorImperfection):
    """The sensors walk away at random."""

    std: float

    def sampler(self, sizes, rng):
        offset = np.zeros(sizes.states)

        def draw(count):
            path = offset + np.cumsum(self.std * rng.standard_normal((count, sizes.states)), axis=0)
            offset[:] = path[-1]
            return path

        return draw


@dataclass(frozen=True)
class Push(Disturbance):
    """A constant force, given stretch by stretch."""

    force: StepDisturbance

    def draws(self, sizes, lengths, steps, rng):
        return self.force.draws(sizes, lengths, steps, rng)

    def spread(self, sizes, pieces):
        return self.force.spread(sizes, pieces)


@dataclass(frozen=True)
class Alternating(TimingImperfection):
    """Every other sample is taken early."""

    waits = False
    early: float

    def lags(self, sizes, samples, rng):
        return self.early * (np.arange(samples) % 2)


@dataclass(frozen=True)
class EveryOther(Relaying, SensorImperfection):
    """Every other sample is the one before it."""

    def relay(self, heard, sizes, rng):
        each = np.arange(heard.sample.size)
        return heard.at(each - each % 2)


OWN = [Drift(0.01), Valve(9.0, 20.0), Fuse(2.0)]


def refuse_by_periods(monkeypatch):
    def refuse(self, step, signal, steps):
        raise AssertionError("called by periods")

    monkeypatch.setattr(type(LAW), "online", refuse)


def test_own_limits_and_noise_in_the_compiled_loop_are_as_by_periods():
    run = require_same(LAW, OWN)
    change = np.diff(run.record.inputs[run.record.past :], axis=0)
    assert change.max() <= 0.9 * (1 + 1e-12)
    assert -2.0 * (1 + 1e-12) <= change.min() < -0.9


def test_a_force_of_ones_own_acts_as_one_that_is_stacked():
    force = StepDisturbance([0.4, -1.0, 0.7])
    own, stacked = (
        dt.simulate(PLANT, LAW, SIGNAL, X0, 2.0, 0.1, imperfections=[kind])
        for kind in (Push(force), force)
    )
    assert (own.states == stacked.states).all()


def test_own_timing_and_relaying_in_the_compiled_loop_are_as_by_periods():
    run = require_same(LAW, [Alternating(0.04), EveryOther()], horizon=3.0)
    assert (
        run.measured[:, 1::2] == run.measured[:, : 2 * run.measured[:, 1::2].shape[1] : 2]
    ).all()
    assert (run.measured[:, 0::2] == run.states[:, 0::2]).all()


def test_own_limits_and_noise_run_in_the_compiled_loop(monkeypatch):
    refuse_by_periods(monkeypatch)
    dt.simulate(PLANT, LAW, SIGNAL, X0, 1.0, 0.1, imperfections=OWN)


def test_an_actuator_that_is_no_limit_runs_by_periods(monkeypatch):
    kinds = [Deadband(0.4), Fuse(2.0)]
    run = dt.simulate(PLANT, LAW, SIGNAL, X0, 1.0, 0.1, imperfections=kinds)
    inputs = run.inputs[np.isfinite(run.inputs)]
    assert ((inputs == 0.0) | (np.abs(inputs) >= 0.4)).all()
    refuse_by_periods(monkeypatch)
    with pytest.raises(AssertionError, match="called by periods"):
        dt.simulate(PLANT, LAW, SIGNAL, X0, 1.0, 0.1, imperfections=kinds)


def test_many_signals_under_own_limits_run_at_once_and_are_as_simulated():
    signals = [plants.off_grid(), dt.SwitchingSignal.constant(1)]
    limits = [Valve(9.0, 20.0), Fuse(2.0)]
    data = dt.monte_carlo(PLANT, [LAW], signals, X0, 6.0, 0.1, imperfections=limits)
    assert data.attrs["one_by_one"] == []
    for i, signal in enumerate(signals):
        run = dt.simulate(PLANT, LAW, signal, X0, 6.0, 0.1, imperfections=limits)
        assert data.cost.values[0, i] == pytest.approx(run.metrics()["cost"], rel=1e-11)


def test_an_actuator_that_is_no_limit_runs_one_by_one():
    signals = [plants.off_grid()]
    data = dt.monte_carlo(PLANT, [LAW], signals, X0, 6.0, 0.1, imperfections=[Deadband(0.1)])
    assert data.attrs["one_by_one"] == ["averaged"]


def test_a_loop_with_noise_of_ones_own_is_pushed():
    assert is_pushed(LAW, [Drift(0.1)])
    assert not is_pushed(LAW, [Fuse(1.0)])


def test_an_exported_controller_clips_within_own_limits():
    paper = dt.problems.paper()
    problem = replace(paper, imperfections=(Saturation(-5.0, 1.0), Fuse(2.0), Valve(9.0, 20.0)))
    controller = _controller(problem, problem.laws["averaged"], 0.05)
    assert (controller.low.tolist(), controller.high.tolist()) == ([-2.0], [1.0])
