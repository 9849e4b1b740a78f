"""Certificates of plants whose delays each range in an interval of their own."""

import re
from dataclasses import replace
from fractions import Fraction
from functools import cache

import numpy as np
import pytest

import certificate_corpus as corpus
import certificate_reference as reference
import deadtime as dt
import delayed_loops
from certified_loops import assert_runs_decrease, proved
from deadtime.base.errors import ArgumentError
from deadtime.certificates.proof import check
from deadtime.certificates.proof.box import FIRST, Box
from deadtime.certificates.proof.covering import enclosures_of
from deadtime.certificates.proof.delays import Delays
from deadtime.certificates.proof.step_enclosure import cells_of
from deadtime.numerics.precision import precision
from deadtime.plant.plant_set import Polytope
from shares import mostly_long

STEP, NEAR = 0.1, 1e-10
# Intervals that overlap, touch both ends of a period, lie apart, and one that is a point.
LOW = np.array([[0.31, 0.1, 0.22], [0.2, 0.15, 0.24]])
HIGH = np.array([[0.36, 0.2, 0.22], [0.28, 0.19, 0.26]])


@cache
def certified(name):
    loop, dwell_time, step, options = corpus.CASES[name]
    plant, law = loop()
    return plant, law, proved(plant, law, dwell_time, step, **options)


def generic():
    rng = np.random.default_rng(3)
    A, B = rng.normal(size=(2, 3, 3)), rng.normal(size=(2, 3, 3))
    return A, B, Box.of(Polytope(A[None], B[None]), np.stack([LOW, HIGH]), STEP)


def drawn(rng, low=LOW, high=HIGH):
    """Delays in their ranges, some at the ends."""
    share = rng.choice([0.0, 1.0, -1.0], size=low.shape)
    share = np.where(share < 0.0, rng.uniform(size=low.shape), share)
    return np.minimum(low + share * (high - low), high)


def parameters(box, cell, delays, s):
    """u, and f of every delay that the cell depends on, by the definition of τ."""
    order = cell.order
    u = (s - order.start) / (order.stop - order.start)
    f = []
    for mode, c in box.moving(order):
        one, switches = box.intervals[mode][c], order.mode != order.after
        phase = delays[mode, c] - (one.count - 1) * box.step
        share = (phase - one.low) / (one.high - one.low)
        if switches and mode == order.mode and one.low - NEAR < order.start < one.high - NEAR:
            share = (min(s, phase) - one.low) / max(s - one.low, 1e-300)
        if switches and mode == order.after and one.low + NEAR < order.stop < one.high + NEAR:
            share = (max(s, phase) - s) / max(one.high - s, 1e-300)
        f.append(min(max(share, 0.0), 1.0))
    return u, tuple(f)


# -- the steps of the plant --------------------------------------------------------------------


@pytest.mark.few(10)
@pytest.mark.parametrize("seed", range(40))
def test_every_step_at_delays_in_their_ranges_is_a_point_of_the_box(seed):
    A, B, box = generic()
    rng = np.random.default_rng(seed)
    delays = drawn(rng)
    plant = delayed_loops.Plant(A, B, delays, STEP)
    columns = [*range(3), *(3 + 3 * lag + c for lag, c in box.reads)]
    for mode, after in ((0, 0), (0, 1), (1, 0)):
        part = float(rng.uniform())
        (cell,) = cells_of(box, mode, after, (part, part))[:1]
        E = plant.rows(mode, None if mode == after else after, Fraction(part))
        u, f = parameters(box, cell, delays, part * STEP)
        assert box.sample(cell.order, u, f) == pytest.approx(E[:, columns], rel=1e-9, abs=1e-12)
        assert not np.delete(E, columns, axis=1).any()


@pytest.mark.parametrize("seed", range(6))
def test_enclosures_hold_all_of_their_cell(seed):
    box, rng = generic()[2], np.random.default_rng(seed)
    for mode, after in ((0, 0), (0, 1), (1, 0)):
        cells = cells_of(box, mode, after)
        cell = cells[rng.integers(len(cells))]
        for _ in range(int(rng.integers(6))):
            directions = [0] * (mode != after) + [FIRST + k for k in range(len(cell.f))]
            cell = cell.halves(int(rng.choice(directions)))[int(rng.integers(2))]
        with precision():
            found = enclosures_of(box).of(cell)
        centre = np.array([float(x.mid()) for x in found.centre.entries()]).reshape(3, -1)
        reach = np.zeros_like(centre)
        for _, slope in found.slopes:
            reach += np.array([float(x.abs_upper()) for x in slope.entries()]).reshape(3, -1)
        for _ in range(30):
            u, *f = (
                float(a + rng.choice([0, 1, rng.uniform()]) * (b - a)) for a, b in (cell.u, *cell.f)
            )
            E = box.sample(cell.order, u, tuple(f))
            assert (np.abs(E - centre) <= reach + 1e-13).all()


@pytest.mark.parametrize("seed", range(6))
def test_slopes_are_those_of_differences(seed):
    box, rng = generic()[2], np.random.default_rng(seed)
    for mode, after in ((0, 0), (0, 1), (1, 0)):
        cells = cells_of(box, mode, after)
        cell = cells[rng.integers(len(cells))]
        for _ in range(24):
            directions = [0] * (mode != after) + [FIRST + k for k in range(len(cell.f))]
            for direction in directions:
                cell = cell.halves(direction)[int(rng.integers(2))]
        with precision():
            found = enclosures_of(box).of(cell)
        middle = [0.5 * (a + b) for a, b in (cell.u, *cell.f)]
        for k, slope in found.slopes:
            at = k - FIRST + 1 if k >= FIRST else 0
            ends = []
            for sign in (-1.0, 1.0):
                p = list(middle)
                p[at] += sign * 1e-6
                ends.append(box.sample(cell.order, p[0], tuple(p[1:])))
            width = (cell.u, *cell.f)[at]
            rate = np.array([float(x.mid()) for x in slope.entries()]).reshape(3, -1)
            rate /= 0.5 * (width[1] - width[0])
            assert (ends[1] - ends[0]) / 2e-6 == pytest.approx(rate, rel=1e-4, abs=1e-6)


# -- what is proved ----------------------------------------------------------------------------

CASES = [name for name in corpus.CASES if name.startswith("ranges-")]


@pytest.mark.parametrize("name", mostly_long(CASES, "ranges-modes"))
def test_it_falls_along_runs_at_delays_drawn_from_the_ranges(name):
    plant, law, certificate = certified(name)
    setting, rng = certificate.evidence.setting, np.random.default_rng(7)
    plants = plant if isinstance(plant, list) else [plant]
    low, high = setting.delays.bounds
    for trial in range(12):
        delays = drawn(rng, low, high)
        truth = plants[trial % len(plants)]
        truth = dt.SwitchedSystem(truth.A, truth.B, delays)
        times, modes = reference.random_signal(
            rng, truth.modes, dwell := setting.signals.dwell_time, 60 * setting.step, 2.0 * dwell
        )
        signal = dt.SwitchingSignal(times, modes)
        assert_runs_decrease(certificate, truth, law, signal, 60)


def test_no_signal_at_delays_in_the_ranges_decays_slower_than_certified():
    plant, law, certificate = certified("ranges-modes")
    setting, rng = certificate.evidence.setting, np.random.default_rng(1)
    for _ in range(2):
        truth = dt.SwitchedSystem(plant.A, plant.B, drawn(rng, *setting.delays.bounds))
        worst = dt.falsify(truth, law, setting.signals.dwell_time, setting.step, budget=20_000)
        assert worst.growth_rate <= -certificate.decay_rate + 1e-9


def test_a_range_with_a_delay_at_which_the_loop_grows_is_not_proved():
    plant = dt.SwitchedSystem([[[2.0]]], [[[1.0, 0.1]]], 0.33)
    law = dt.SingleModePredictor(plant, dt.place(plant, [-8.0]), 0)
    margin = dt.delay_margin(plant, law, STEP, input=0)
    assert margin.longer < 0.06
    low = [0.32, 0.33]
    inside = dt.certify(plant, law, 0.2, STEP, delays=(low, [0.33 + 0.3 * margin.longer, 0.33]))
    assert inside.proven
    beyond = [0.33 + 1.02 * margin.longer, 0.33]
    assert not dt.certify(plant, law, 0.2, STEP, delays=(low, beyond)).stable
    setting = replace(inside.evidence.setting, delays=Delays(np.array([[low], [beyond]])))
    assert not check(replace(inside.evidence, setting=setting)).proven


def test_ranges_that_are_points_are_the_delays():
    plant, law, _ = certified("ranges-modes")
    each = dt.certify(plant, law, 0.23, STEP, delays=(plant.delays, plant.delays))
    known = dt.certify(plant, law, 0.23, STEP)
    assert each.decay_rate == known.decay_rate
    assert each.statement == known.statement


def test_the_file_is_about_these_ranges_alone(tmp_path):
    plant, law, certificate = certified("ranges-modes")
    path = certificate.save(tmp_path / "a.json")
    found = dt.verify(path, plant, law, dwell_time=0.23)
    assert found.proven
    assert (
        "any constant values from [[0.299], [0.268]] s to [[0.3], [0.272]] s" in found.statement[1]
    )
    other = dt.verify(path, dt.SwitchedSystem(plant.A, plant.B, [[0.3], [0.275]]))
    assert not other.proven
    assert "delays from [[0.299], [0.268]] to [[0.3], [0.272]] s" in other.message


@pytest.mark.parametrize(
    ("delays", "message"),
    [
        (([0.3, 0.1], [0.2, 0.1]), "delays of input 0 in mode 0 must ascend, got (0.3, 0.2)"),
        (([0.3, 0.1], [0.45, 0.1]), "delays of input 0 in mode 0 must lie within one period"),
        (([0.3], [0.4, 0.1]), "delays must be a number or have shape (m,) = (2,)"),
        (([0.3, -0.1], [0.4, 0.1]), "delays of input 1 in mode 0 must be positive"),
    ],
)
def test_ranges_that_are_none_are_refused(delays, message):
    plant = dt.SwitchedSystem([[[0.1]]], [[[1.0, 0.5]]], [0.3, 0.1])
    law = dt.AveragedPredictor(plant, dt.place(plant, [-1.0]))
    with pytest.raises(ArgumentError, match=re.escape(message)):
        dt.certify(plant, law, 0.2, STEP, delays=delays)
