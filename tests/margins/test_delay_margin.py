"""The delay margin for every signal: which delays are asked about, and what the answer is worth."""

import itertools
import math

import numpy as np
import pytest

import certificate_reference as reference
import deadtime as dt

# Three modes, one state, two inputs; the law's model is 4 % off, N = 3 and φ = 0.034 s.
MODEL = dt.SwitchedSystem(
    [[[0.5]], [[0.6]], [[0.55]]], [[[1.0, 0.2]], [[0.95, 0.15]], [[1.05, 0.2]]], 0.234
)
PLANT = dt.SwitchedSystem(1.04 * MODEL.A, MODEL.B, 0.234)
LAW = dt.AveragedPredictor(MODEL, dt.place(MODEL, [-2.0]))
STEP, DWELL_TIME = 0.1, 0.17


def test_the_loop_grows_in_a_constant_mode_beyond_the_margin():
    alone = dt.delay_margin(PLANT, LAW, STEP)
    assert not alone.certified
    assert alone.lower < 0.1 < 0.234 < alone.upper < 2.0
    table = LAW.digital(STEP)
    for scale, grows in ((0.998, False), (1.002, True)):
        loop = reference.Loop(PLANT.A, PLANT.B, scale * alone.upper, table)
        growth = [np.abs(np.linalg.eigvals(loop.step(mode, 10**6))).max() for mode in range(3)]
        assert (max(growth) > 1.0) == grows


@pytest.mark.long
def test_the_loop_decays_at_delays_within_the_certified_margin_near_that_of_constant_modes():
    alone = dt.delay_margin(PLANT, LAW, STEP)
    certified = dt.delay_margin(PLANT, LAW, STEP, DWELL_TIME)
    assert certified.certified
    assert alone.lower <= certified.lower < 0.1 < 0.234 < certified.upper <= alone.upper
    assert certified.upper - 0.234 >= 0.9 * (alone.upper - 0.234)
    for true in (max(certified.lower, 0.005), 0.234, certified.upper):
        plant = dt.SwitchedSystem(PLANT.A, PLANT.B, true)
        rng = np.random.default_rng(2)
        for _ in range(3):
            drawn = reference.random_signal(rng, 3, DWELL_TIME, 400.0, 0.5)
            run = dt.simulate(plant, LAW, dt.SwitchingSignal(*drawn), [1.0], 400.0, STEP)
            late = np.abs(run.states[0])
            assert late[-400:].max() < 0.1 * late[:400].max()


class Answer:
    """A certificate that is made up."""

    def __init__(self, stable, message="made up"):
        self.stable = stable
        self.message = message


@pytest.mark.parametrize(("low", "high"), [(0.01, 0.5), (0.17, 0.31), (0.2, 0.2501), (0.0, 9.0)])
def test_pieces_cover_the_delays_that_hold_and_no_others(monkeypatch, low, high):
    asked = []

    def certify(plant, law, dwell_time, step, *, delays=None, **options):
        if delays is None:
            return Answer(True)
        asked.append(delays)
        assert math.floor(delays[1] / step - 1e-9) <= math.ceil(delays[0] / step - 1 + 1e-9)
        return Answer(low <= delays[0] and delays[1] <= high)

    monkeypatch.setattr("deadtime.certificates.certify", certify)
    alone = dt.delay_margin(PLANT, LAW, STEP)
    found = dt.delay_margin(PLANT, LAW, STEP, DWELL_TIME)
    held = sorted(piece for piece in asked if low <= piece[0] and piece[1] <= high)
    assert (found.lower, found.upper) == (held[0][0], held[-1][1])
    for (_, end), (start, _) in itertools.pairwise(held):
        assert start == pytest.approx(end, abs=1e-12)
    down, up = max(low, alone.lower), min(high, alone.upper)
    assert down <= found.lower <= down + 0.06 * (0.234 - alone.lower)
    assert up - 0.06 * (alone.upper - 0.234) <= found.upper <= up
    assert "Without switches: the loop" in found.message


def test_a_loop_that_is_not_certified_at_its_own_delay_has_no_margin(monkeypatch):
    monkeypatch.setattr(
        "deadtime.certificates.certify", lambda *a, **k: Answer(None, "Inconclusive: so.")
    )
    found = dt.delay_margin(PLANT, LAW, STEP, DWELL_TIME)
    assert (found.lower, found.upper, found.certified) == (None, None, False)
    assert found.message == "There is no certified margin: Inconclusive: so."


def test_a_constant_mode_that_grows_is_named_and_nothing_else_is_asked(monkeypatch):
    monkeypatch.setattr("deadtime.certificates.certify", None)
    plant = dt.problems.paper().plant
    law = dt.AveragedPredictor(plant, dt.place(plant, [-1.0, -2.0]))
    found = dt.delay_margin(plant, law, 0.1, 0.2)
    assert found.lower is None
    assert "mode 1" in found.message
    with pytest.raises(dt.ArgumentError, match="step must be given with dwell_time"):
        dt.delay_margin(plant, law, None, 0.2)
