"""Disturbances of plants whose modes read their inputs with delays of their own."""

import itertools

import numpy as np
import pytest
from scipy.linalg import expm

import deadtime as dt
import plants
from by_sample import by_sample
from deadtime.imperfections import (
    ColouredDisturbance,
    Noise,
    Sizes,
    StepDisturbance,
    WhiteDisturbance,
)
from deadtime.plant import SampledPlant
from deadtime.simulation.forcing import Forcing
from deadtime.switching.grid import cuts_of

H, X0 = 0.1, np.array([1.0, -1.0, 0.5])
FORCE = np.array([0.4, -1.0, 0.7])
W = np.array([[0.5, 0.2, 0.0], [0.2, 0.3, 0.1], [0.0, 0.1, 0.1]])
MODEL = plants.generic()
DELAYS = [[0.251, 0.1], [0.32, 0.135], [0.08, 0.251]]
PLANT = dt.SwitchedSystem(1.03 * MODEL.A, 0.98 * MODEL.B, DELAYS)
SIGNAL = plants.off_grid()
KINDS = {
    "step": StepDisturbance(FORCE, 0.3),
    "white": WhiteDisturbance(W),
    "coloured": ColouredDisturbance([0.4, 0.2], [0.3, 2.0], np.stack((FORCE, X0), axis=1)),
}


def run(*imperfections, **options):
    law = dt.AveragedPredictor(
        dt.SwitchedSystem(MODEL.A, MODEL.B, DELAYS), dt.place(MODEL, [-1.0, -1.5, -2.0])
    )
    return dt.simulate(PLANT, law, SIGNAL, X0, 2.0, H, imperfections=imperfections, **options)


def pushed(times, inputs, force):
    """x at these times under held inputs and a constant force, by the definition of the delays."""
    arrivals = np.add.outer(np.arange(40) * H, np.ravel(DELAYS)).ravel()
    marks = np.unique(np.concatenate((times, arrivals, SIGNAL.times, [0.0])).round(12))
    x, found = X0, {0.0: X0}
    for a, b in itertools.pairwise(marks[marks <= times[-1] + 1e-9]):
        middle, big = 0.5 * (a + b), np.zeros((4, 4))
        i = int(SIGNAL(middle))
        sample = np.floor((middle - np.array(DELAYS[i])) / H).astype(int)
        u = np.array([inputs[j, s] if s >= 0 else 0.0 for j, s in enumerate(sample)])
        big[:3, :3], big[:3, 3] = PLANT.A[i], PLANT.B[i] @ u + force
        x = (expm(big * (b - a)) @ np.append(x, 1.0))[:3]
        found[b] = x
    return np.array([found[t] for t in times.round(12)]).T


def test_a_constant_force_moves_the_plant_as_a_further_input_would():
    times = np.sort(np.concatenate((np.arange(21) * H, [0.05, 0.115, 0.333, 1.273, 1.87])))
    loop = run(StepDisturbance(FORCE))
    between = run(StepDisturbance(FORCE), times=times).states
    assert (
        np.abs(between - pushed(times, loop.inputs, FORCE)).max() <= 1e-12 * np.abs(between).max()
    )
    plain = run(times=times).states
    assert np.abs(plain - pushed(times, run().inputs, 0.0)).max() <= 1e-12 * np.abs(plain).max()


@pytest.mark.parametrize("kind", KINDS)
def test_pieces_of_a_stretch_that_a_switch_cuts_add_what_was_drawn_for_it(kind):
    sampled = SampledPlant(PLANT, H).cut_alike()
    cuts = cuts_of(SIGNAL, sampled)
    table, one = sampled.along(cuts, 20), KINDS[kind]
    stretches, sizes = sampled.stretches(0), Sizes.of(PLANT, H)
    lengths = tuple(part.stop - part.start for part in stretches)
    shift, force = Forcing(sampled, 20, [(one, np.random.default_rng(3))]).along(table, cuts)
    numbers = one.draws(sizes, lengths, 20, np.random.default_rng(3))
    shared = 0
    for k, (place, stretch) in itertools.product(range(20), enumerate(stretches)):
        of = [
            q
            for q in range(table.first[k], table.first[k + 1])
            if stretch.start <= table.start[table.entry[q]] < stretch.stop
        ]
        begin, end = k * H + stretch.start, k * H + stretch.stop
        marks = [begin, *[t for t in SIGNAL.times if begin + 1e-9 < t < end - 1e-9], end]
        parts = [
            (PLANT.A[SIGNAL(0.5 * (a + b))], float(b - a)) for a, b in itertools.pairwise(marks)
        ]
        added = np.zeros(3)
        for q in of:
            added = table.Phi[table.entry[q]] @ added + shift[q]
        plants.close(added, one.spread(sizes, parts) @ numbers[k, place], 1e-11, 1.0)
        assert (force[of] == force[of[0]]).all()
        shared += len(of) > 1
    assert shared >= 3


@pytest.mark.parametrize("kind", KINDS)
def test_compiled_and_step_by_step_runs_agree(kind):
    fast, slow = run(KINDS[kind]), run(KINDS[kind], by_sample(Noise(0.0)))
    plants.close(slow.states, fast.states, 1e-12)
    for name, value in fast.metrics().items():
        assert slow.metrics()[name] == pytest.approx(value, rel=1e-9), name
    assert (fast.states != run().states).any(axis=0)[4:].all()


def test_modes_with_one_delay_given_one_by_one_draw_as_ever():
    law = plants.LAWS["averaged"](MODEL)
    one = [
        dt.simulate(plant, law, SIGNAL, X0, 1.0, H, imperfections=[WhiteDisturbance(W)])
        for plant in (
            dt.SwitchedSystem(MODEL.A, MODEL.B, 0.251),
            dt.SwitchedSystem(MODEL.A, MODEL.B, np.full((3, 2), 0.251)),
        )
    ]
    assert (one[0].states == one[1].states).all()
