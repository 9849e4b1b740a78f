"""Certificates of plants whose inputs and modes have delays of their own."""

from dataclasses import replace
from fractions import Fraction
from functools import cache

import mpmath
import numpy as np
import pytest
from flint import arb

import certificate_corpus as corpus
import certificate_reference as reference
import deadtime as dt
import delayed_loops
from certified_loops import assert_runs_decrease, assert_steps_decrease, proved
from deadtime.base.errors import ArgumentError
from deadtime.certificates.proof import check
from deadtime.certificates.proof.delays import Delays
from deadtime.certificates.proof.family import Family
from deadtime.certificates.proof.step_enclosure import Enclosures, cells_of
from deadtime.numerics.precision import precision
from deadtime.plant.plant_set import Polytope
from shares import mostly_long

CASES = [name for name in corpus.CASES if name.startswith("delays-")]


@cache
def certified(name):
    loop, dwell_time, step, options = corpus.CASES[name]
    plant, law = loop()
    return plant, law, proved(plant, law, dwell_time, step, **options)


# -- what is proved, against the definition ----------------------------------------------------


@pytest.mark.parametrize("name", mostly_long(CASES, "delays-short", "delays-both"))
def test_the_function_falls_at_every_step_of_the_loop_by_definition(name):
    plant, law, certificate = certified(name)
    loop = delayed_loops.Loop(plant, law.digital(certificate.evidence.setting.step))
    assert loop.order == certificate.evidence.setting.order
    maximum = reference.longest_of(certificate.evidence.setting)
    assert_steps_decrease(certificate, loop, 6, maximum, most=40)


def test_it_falls_by_fifty_digits_too():
    plant, law, certificate = certified("delays-both")
    loop = delayed_loops.Loop(plant, law.digital(0.1), digits=True)
    with mpmath.workdps(50):
        assert_steps_decrease(certificate, loop, 2, most=4)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", CASES)
def test_it_falls_along_runs(name):
    plant, law, certificate = certified(name)
    setting, rng = certificate.evidence.setting, np.random.default_rng(7)
    samples = 60
    longest = reference.longest_of(setting) or 2.0 * setting.signals.dwell_time
    times, modes = reference.random_signal(
        rng, plant.modes, setting.signals.dwell_time, samples * setting.step, longest
    )
    assert_runs_decrease(certificate, plant, law, dt.SwitchingSignal(times, modes), samples)


@pytest.mark.parametrize(
    "name", mostly_long(["delays-inputs", "delays-modes", "delays-both"], "delays-both")
)
def test_no_signal_is_found_that_decays_slower_than_certified(name):
    plant, law, certificate = certified(name)
    setting = certificate.evidence.setting
    worst = dt.falsify(plant, law, setting.signals.dwell_time, setting.step)
    assert worst.growth_rate <= -certificate.decay_rate + 1e-9


def test_between_certified_and_refuted_is_little():
    base = dt.problems.paper().plant

    def problem(alpha):
        plant = base.apart(alpha)
        plant = dt.SwitchedSystem(plant.A, plant.B, [[0.3], [0.2]])
        return plant, dt.AveragedPredictor(plant, dt.place(plant, (-1.0, -2.0)))

    margin = dt.stability_margin(problem, (0.3, 1.0), 0.3, 0.1)
    assert margin.certified is not None
    assert margin.refuted is not None
    assert 0.98 * margin.refuted <= margin.certified < margin.refuted


# -- the steps of the plant --------------------------------------------------------------------

DELAYS = np.array([[0.34, 0.17], [0.22, 0.27]])


def generic(corners=1):
    rng = np.random.default_rng(3)
    A = rng.normal(size=(2, 3, 3)) + 0.1 * rng.normal(size=(corners, 2, 3, 3))
    B = rng.normal(size=(2, 3, 2)) + 0.1 * rng.normal(size=(corners, 2, 3, 2))
    return A, B


def place(family, cell, u):
    """The instant of a switch, as an exact fraction of the period of 0.1."""
    marks = [Fraction(0), *sorted({reference.decimal(d) % Fraction(1, 10) for d in DELAYS.flat})]
    marks.append(Fraction(1, 10))
    assert len(marks) == len(family.marks)
    part = next((part for part in cell.order if part.share == "before"), None)
    if part is None:
        return 1
    a, b = marks[part.start], marks[part.stop]
    return (a + Fraction(u) * (b - a)) * 10


@pytest.mark.few(1)
@pytest.mark.parametrize("corners", [1, 2])
def test_enclosures_hold_the_plant_cut_at_every_arrival(corners):
    A, B = generic(corners)
    family = Family.of(Polytope(A, B), DELAYS, 0.1)
    columns = [*range(3), *(3 + 2 * lag + j for lag, j in family.reads)]
    cells = [*cells_of(family, 0, 0), *cells_of(family, 0, 1), *cells_of(family, 1, 0)]
    assert len(cells) == 1 + 2 * 4  # φ = 0.04 and 0.07 of mode 0, 0.02 and 0.07 of mode 1
    rng = np.random.default_rng(1)
    for cell in cells:
        half = cell.halves(0)[int(rng.integers(2))]
        with precision():
            found = Enclosures(family).of(half)
        mean = half.corners.mean(axis=0)
        for reading in (lambda X: X, np.vectorize(reference.decimal, otypes=[object])):
            with mpmath.workdps(60), precision(256):
                mixed = [
                    np.tensordot(reference.many_digits(mean), reference.many_digits(reading(X)), 1)
                    for X in (A, B)
                ]
                plant = delayed_loops.Plant(*mixed, DELAYS, 0.1, digits=True)
                s = place(family, half, np.mean(half.u))
                E = plant.rows(half.order[0].mode, half.order[-1].mode, s)
                rest = np.delete(E, columns, axis=1)
                assert not any(map(bool, rest.flat))  # what is not read does not act
                exact = [arb(mpmath.nstr(y, 60, strip_zeros=False)) for y in E[:, columns].flat]
                assert all(
                    x.contains(y) for x, y in zip(found.centre.entries(), exact, strict=True)
                )


def test_one_delay_told_one_by_one_is_that_delay():
    A, B = generic()
    for delay in (0.234, 0.3, 0.04):
        one = Family.of_range(Polytope(A, B), delay, delay, 0.1)
        each = Family.of(Polytope(A, B), np.full((2, 2), delay), 0.1)
        assert (one.reads, one.marks, one.lags) == (each.reads, each.marks, each.lags)
        for i, j in ((0, 0), (0, 1)):
            assert one.orders(i, j) == each.orders(i, j)
            for order in one.orders(i, j):
                assert np.array_equal(one.sample(order, 0.3), each.sample(order, 0.3))


def test_arrivals_that_differ_by_rounding_alone_are_one():
    A, B = generic()
    assert 0.37 - 3 * 0.1 != 0.27 - 2 * 0.1
    assert len(Family.of(Polytope(A, B), np.array([[0.37, 0.27]] * 2), 0.1).marks) == 3
    assert len(Family.of(Polytope(A, B), np.array([[0.37, 0.271]] * 2), 0.1).marks) == 4


# -- evidence, files and refusals --------------------------------------------------------------


def test_evidence_about_other_delays_is_no_proof():
    certificate = certified("delays-both")[2]
    evidence, setting = certificate.evidence, certificate.evidence.setting
    assert check(evidence).proven
    own = setting.delays.ends
    for delays in (own[:, ::-1], own - 0.02):
        outcome = check(replace(evidence, setting=replace(setting, delays=Delays(delays.copy()))))
        assert not outcome.proven
    for delays, reason in (
        (own * np.array([1.0, np.nan]), "delays[0, 1] is not a positive"),
        (-own, "delays[0, 0] is not a positive"),
    ):
        outcome = check(replace(evidence, setting=replace(setting, delays=Delays(delays.copy()))))
        assert not outcome.proven
        assert outcome.reason.startswith(reason)


def test_the_file_is_about_these_delays_alone(tmp_path):
    plant, law, certificate = certified("delays-both")
    path = certificate.save(tmp_path / "a.json")
    found = dt.verify(path, plant, law, dwell_time=0.3)
    assert found.proven
    assert found.decay_rate == certificate.decay_rate
    text = "[[0.34, 0.17], [0.22, 0.26]] s"
    assert f"input delays {text}" in found.statement[1]
    assert f"delays {text}" in found.about[0]
    for delays in (0.34, [0.34, 0.17], [[0.34, 0.17], [0.22, 0.25]]):
        other = dt.verify(path, dt.SwitchedSystem(plant.A, plant.B, delays))
        assert not other.proven
        assert other.message.endswith(f"about a plant with the delays {text}.")


def test_a_range_of_one_delay_says_nothing_of_several(tmp_path):
    plant, law = corpus.CASES["range"][0]()
    path = dt.certify(plant, law, 0.3, 0.1, delays=(0.2, 0.29)).save(tmp_path / "a.json")
    assert dt.verify(path, dt.SwitchedSystem(plant.A, plant.B, 0.25)).proven
    within = dt.verify(path, dt.SwitchedSystem(plant.A, plant.B, [[0.25], [0.26]]))
    assert "a delay in [0.2, 0.29] s" in within.message


def test_corners_of_a_polytope_have_the_same_delays():
    plant, law, _ = certified("delays-both")
    others = dt.SwitchedSystem(plant.A, plant.B, 0.3)
    with pytest.raises(ArgumentError, match="the same delays at all corners"):
        dt.certify([plant, others], law, 0.3, 0.1)
