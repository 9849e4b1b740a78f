"""Certificates for other signals, delays and plants hold, and what is out of reach is left open."""

import itertools
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

import certificate_reference as reference
import deadtime as dt
import exponential_products as products
import plants
from certificate_corpus import CORPUS
from certificate_reference import Loop
from certified_loops import (
    ALONE,
    GENERIC,
    MILD,
    PAIR,
    PAPER,
    WEAK,
    assert_runs_decrease,
    assert_steps_decrease,
    designed,
    free,
    proved,
    undecided,
    with_delay,
)
from deadtime.base.errors import ArgumentError
from deadtime.certificates import Certificate
from deadtime.certificates.proof.archive import load_evidence
from deadtime.certificates.proof.check import Check
from deadtime.certificates.proof.transitions import SwitchGraph, interpolation
from exponential_products import ellipses

LAW = dt.AveragedPredictor(PAIR, plants.gains(PAIR))


# -- other signals, delays and plants ------------------------------------------------------


def test_an_unstable_mode_that_must_be_left_is_certified_and_not_beyond_the_true_limit():
    A = np.array([[[0.1, 1.0], [-1.0, 0.1]], [[-0.5, 0.3], [-0.3, -0.5]]])
    limit = products.critical(
        lambda longest: products.worst_multiplier(A, [1.0, 1.0], [longest] * 2), 3.0, 6.0
    )
    assert limit == pytest.approx(5.0, rel=1e-4)  # by hand: 0.1 · 5 = 0.5 · 1
    plant, law = free(A)
    certificate = proved(plant, law, 1.0, 0.1, maximum_dwell=1.8)
    assert "sojourns last between 1.0 s and 1.8 s" in certificate.statement[0]
    assert dt.certify(plant, law, 1.0, 0.1, maximum_dwell=1.02 * limit).stable is False
    plant, law = designed(PAPER.apart(0.65))
    signal = reference.random_signal(np.random.default_rng(6), 2, 0.2, 12.0, 0.7)
    certificate = proved(plant, law, 0.2, 0.1, maximum_dwell=0.7)
    assert certificate.decay_rate > 0.005
    assert_runs_decrease(certificate, plant, law, dt.SwitchingSignal(*signal), 110)


def test_with_an_average_dwell_time_the_function_falls_along_bursts_of_switches():
    (plant, law), average, chatter = free(ellipses(4.0, 0.8)), 4.0, 2
    linear = load_evidence(CORPUS / "average-free.json").evidence  # by the level of a bucket
    assert dt.verify(CORPUS / "average-free.json", plant, law, dwell_time=average).proven
    certificate = Certificate.of(linear, Check(True))
    assert "average dwell time of 4.0 s (at most 2 + T/4.0 s switches" in certificate.statement[0]

    def level(sampled):
        """What is left of the switches that a window may hold, in samples, rounded up."""
        levels = [80]
        for before, now in itertools.pairwise(sampled):
            levels.append(min(80, levels[-1] + 1 - 39 * (before != now)))
        return levels

    signal = reference.bursts(np.random.default_rng(7), 2, average, chatter, 60.0, 0.1)
    assert_runs_decrease(certificate, plant, law, dt.SwitchingSignal(*signal), 590, level)
    # No sojourns of 1 s or more make this loop grow, unequal ones of 1 s on average do.
    A = ellipses(9.0, 1.0)
    assert products.worst_multiplier(A, [1.0, 1.0], [6.0, 6.0]) < 0.5
    assert max(products.multiplier(A, [(0, t), (1, 2.0 - t)]) for t in np.arange(0.2, 1, 0.05)) > 1
    assert dt.certify(*free(A), 1.0, 0.1, chatter=2, search_signals=False).stable is None


def test_ranges_of_delays_and_polytopes_of_plants_are_certified_at_every_point_in_them():
    law, low, high = dt.DelayedStateFeedback(MILD, WEAK), 0.2, 0.29  # from φ = 0 to φ = 0.09
    certificate = proved(MILD, law, 0.3, 0.1, delays=(low, high))
    assert f"any constant value in [{low}, {high}] s" in certificate.statement[1]
    assert "every constant delay from 0.2 s to 0.29 s" in certificate.message
    for delay in (low + 1e-9, high, *np.random.default_rng(8).uniform(low, high, 3)):
        loop = Loop(MILD.A, MILD.B, float(delay), law.digital(0.1))
        assert loop.plant.count == 3
        assert_steps_decrease(certificate, loop, 2)
    factors = ((1.0, 1.0), (1.1, 1.0), (1.0, 0.9))
    corners = [dt.SwitchedSystem(a * MILD.A, b * MILD.B, MILD.delay) for a, b in factors]
    law = dt.AveragedPredictor(MILD, WEAK)
    certificate = proved(corners, law, 0.3, 0.1)
    assert "any plant in the polytope" in certificate.statement[0]
    assert "and every plant in the polytope" in certificate.message
    for weights in (*np.eye(3), *np.random.default_rng(9).dirichlet(np.ones(3), 3)):
        a, b = weights @ factors
        loop = Loop(a * MILD.A, b * MILD.B, MILD.delay, law.digital(0.1))
        assert_steps_decrease(certificate, loop, 2)


# -- the graph of steps --------------------------------------------------------------------


@pytest.mark.parametrize("longest", [None, 0.93, 0.9])
@pytest.mark.parametrize("dwell_time", [0.11, 0.17, 0.3, 0.449])
def test_every_step_of_signals_in_real_time_is_in_the_graph(longest, dwell_time):
    rng, most = np.random.default_rng(0), longest or dwell_time + 0.9
    shortest = dwell_time * (1.0 - 0.9e-5)  # by a clock that is off
    times, modes = reference.random_signal(rng, 3, shortest, 40.0, most)
    # From just after a sample to the last one by which the mode may be left; from just before a
    # sample for as long as it may last.
    sample = math.ceil(times[-1] / 0.1 + 5.0) * 0.1
    times += [sample + 1e-7, sample + 1e-7 + shortest]
    end = math.ceil(times[-1] / 0.1 + 5.0) * 0.1 - 1e-7
    times += [end, end + (longest or most) * (1.0 + 0.9e-5)]
    modes += [(modes[-1] + k) % 3 for k in (1, 2, 0, 1)]
    signal = dt.SwitchingSignal(times, modes)
    sampled = signal(np.arange(0.0, times[-1] + 0.2, 0.1) + 1e-12).tolist()
    seen = reference.ages(sampled)
    fractions = {math.floor(t / 0.1 - 1e-12): t / 0.1 % 1.0 for t in times[1:]}
    for context, rows in (("none", 1), ("mode", 1), ("mode_age", 7)):
        graph = SwitchGraph.of(3, dt.SignalClass(dwell_time, longest), 0.1, context, rows)
        for k, (age, later) in enumerate(itertools.pairwise(seen)):
            (low, high) = graph.switches(0, age, 0)[0].instants if not later and k else (0.0, 1.0)
            assert low <= fractions.get(k, low) <= high
        knots = tuple(sorted({0, graph.last // 3, graph.last}))
        found = reference.by_age(graph.all(knots))
        for (i, j), age, later in zip(itertools.pairwise(sampled), seen, seen[1:], strict=False):
            row = {"none": 0, "mode": i, "mode_age": i * rows + min(age, rows - 1)}[context]
            step = (i, min(age, graph.last), row, j, min(later, graph.last))
            assert reference.covered(found, knots, step, interpolation), step
        assert any(age == graph.first and not later for age, later in itertools.pairwise(seen))


@pytest.mark.parametrize("chatter", [2, 3])
@pytest.mark.parametrize("average", [0.17, 0.3, 0.75])
def test_every_step_of_bursts_within_an_average_dwell_time_is_in_the_graph(average, chatter):
    graph = SwitchGraph.of(3, dt.SignalClass(average, chatter=chatter), 0.1, "mode", 1)
    knots, level = tuple(sorted({0, graph.last // 2, graph.last})), graph.last
    found = reference.by_age(graph.all(knots))
    signal = reference.bursts(np.random.default_rng(1), 3, average, chatter, 60.0, 0.1)
    assert -1e-9 <= reference.room(signal[0], average, chatter) < 0.1
    sampled = dt.SwitchingSignal(*signal)(np.arange(600) * 0.1 + 1e-12)
    for i, j in itertools.pairwise(sampled.tolist()):
        after = min(level + 1, graph.last) if i == j else level - graph.bucket
        assert reference.covered(found, knots, (i, level, i, j, after), interpolation)
        level = after


# -- what is left open, and what is refused ------------------------------------------------


def test_loops_out_of_reach_are_left_open_with_the_reason():
    oracle = dt.ExactPredictor(PAIR, plants.gains(PAIR))
    assert "no fixed controller to certify" in undecided(PAIR, oracle, 0.3, 0.1)
    rule = dt.HalfSpace([1.0, 0.0], 0.0)
    dependent = dt.StateDependentPredictor(PAIR, plants.gains(PAIR), rule)
    assert "is no table but a nonlinear law" in undecided(PAIR, dependent, 0.3, 0.1)
    assert "is not above one period of 0.1 s" in undecided(PAIR, LAW, 0.09, 0.1)
    assert "two switches may fall into a step" in undecided(PAIR, LAW, 0.1, 0.1)
    message = undecided(PAPER, designed(PAPER)[1], 0.3, 0.0003)
    assert re.search(r"has order 3,336: .* take about \d+\.\d GB and \d+ min, and 3,000", message)
    proved(*designed(ALONE), 0.05, 0.1)  # one mode needs no dwell time


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"maximum_dwell": 0.29}, "maximum_dwell must be at least dwell_time = 0.3 s, got 0.29"),
        ({"chatter": 2, "maximum_dwell": 1.0}, "chatter > 1 and maximum_dwell exclude each other"),
        ({"chatter": 0}, "chatter must be"),
        ({"decay_rate": -0.1}, "decay_rate must be ≥ 0"),
        ({"delays": (0.25, 0.21)}, "delays must ascend"),
        ({"delays": (0.19, 0.21)}, "delays must lie within one period"),
        ({"delays": (0.0, 0.1)}, "delays must be"),
        ({"dwell_time": 0.0}, "dwell_time must be"),
        ({"clock_tolerance": 0.0}, "clock_tolerance must be a part from 1e-08 to 0.1, got 0"),
        ({"step": -0.1}, "step must be"),
        ({"plant": GENERIC}, "law must be made for a plant with 3 modes, got a law for 2"),
        ({"plant": [PAIR, with_delay(PAIR, 0.2)]}, "the same delays at all corners"),
        ({"plant": []}, "plant must be a SwitchedSystem or a sequence of them, got none"),
        ({"plant": 3}, "plant must be a SwitchedSystem or a sequence of them, got int"),
        ({"delays": (0.19, 0.21)}, "the parts below and above 0.2 s one after the other with"),
    ],
)
def test_malformed_requests_are_refused_by_name(options, message):
    arguments = {"plant": PAIR, "law": LAW, "dwell_time": 0.3, "step": 0.1} | options
    with pytest.raises(ArgumentError, match=re.escape(message)):
        dt.certify(**arguments)


class PanicError(BaseException):
    """What compiled code raises when it panics: no Exception."""


def panics(cost):
    raise PanicError("index out of bounds")


def says_nan(cost):
    return SimpleNamespace(x=[math.nan] * len(cost), status="Solved")


@pytest.mark.parametrize(("answer", "search"), [(panics, True), (says_nan, False)])
def test_a_solver_that_fails_leaves_the_question_open(monkeypatch, answer, search):
    monkeypatch.setattr(
        "clarabel.DefaultSolver", lambda P, q, *_: SimpleNamespace(solve=lambda: answer(q))
    )
    # Signals are sought at the delays in question, not at the plant's own, where the loop grows.
    far = with_delay(PAIR, 0.8)
    assert dt.growth_rate(far, LAW, 0, 0.1) > 0.1
    message = undecided(far, LAW, 0.3, 0.1, delays=(0.23, 0.24), search_signals=search)
    assert message.startswith("Inconclusive: no Lyapunov function of the kinds tried was found")
