"""Every form of the input before time 0 gives the same ideal run, or is refused."""

import re

import numpy as np
import pytest

import deadtime as dt
import plants
from ideal_runs import PLANT, SIGNAL, X0, D, agrees, other_model, run, same_run

HELD = np.random.default_rng(5).normal(size=(2, 3))
HISTORIES = {
    "constant": ([0.3, -1.2], lambda t: [0.3, -1.2], ()),
    "held": (HELD, lambda t: HELD[:, min(2, int((t + D) / D * 3))], (-D / 3, -2 * D / 3)),
    "smooth": (lambda t: [np.sin(9 * t), np.exp(t)], None, ()),
    "fast": (lambda t: [np.sin(60 * t), np.cos(45 * t)], None, ()),
    "jump": (lambda t: [1.0 if t < -0.1 else -1.0, t], None, (-0.1,)),
    "kink": (lambda t: [abs(t + 0.0777), np.cos(3 * t)], None, (-0.0777,)),
}


@pytest.mark.few(6)
@pytest.mark.parametrize("form", HISTORIES)
@pytest.mark.parametrize("name", ["averaged", "exact", "delayed"])
def test_every_form_of_history_agrees_with_a_second_discretisation(form, name):
    u0, function, breaks = HISTORIES[form]
    law = plants.LAWS[name](PLANT)
    agrees(law, PLANT, SIGNAL, X0, 1.0, u0=u0, expected=function or u0, breaks=breaks)


def test_a_history_is_read_over_the_longer_delay():
    law = plants.LAWS["averaged"](other_model(0.3171))
    u0 = HISTORIES["smooth"][0]
    agrees(law, PLANT, SIGNAL, X0, 1.0, u0=u0, expected=u0)


@pytest.mark.parametrize(
    "forms",
    [
        [None, [0.0, 0.0], lambda t: [0.0, 0.0], np.zeros((2, 4))],
        [[0.3, -1.2], lambda t: [0.3, -1.2], np.tile([[0.3], [-1.2]], 3)],
    ],
    ids=["zero", "constant"],
)
def test_every_form_of_the_same_history_gives_the_same_run(forms):
    runs = [run(u0=u0) for u0 in forms]
    for other in runs[1:]:
        same_run(other, runs[0], 1e-12)


def test_a_history_that_is_smooth_nowhere_is_not_searched_for_ever():
    calls = 0

    def u0(t):
        nonlocal calls
        calls += 1
        assert calls < 50_000
        return [float(np.float32(np.sin(3 * t))), 0.0]

    one = run(u0=u0, horizon=1.0)
    plants.close(one.states, run(u0=lambda t: [np.sin(3 * t), 0.0], horizon=1.0).states, 1e-6)


@pytest.mark.parametrize(
    ("u0", "message"),
    [
        (np.nan, "u0[0] must be finite, got nan."),
        ([1.0], "u0 must have shape (m,) = (2,), got (1,)"),
        (np.zeros((3, 4)), "u0 must hold (m, N) = (2, N) samples, got (3, 4)."),
        ([[1.0, np.inf], [0.0, 0.0]], "u0[0, 1] must be finite, got inf."),
        ([[1.0], [0.0, 0.0]], "u0 must be a number, (m,), (m, N) or a function"),
        (lambda t: 1.0, "u0 must have shape (m,) at every time = (2,), got (1,)"),
        (lambda t: [0.0, np.nan], "u0[1] must be finite, got nan."),
        (lambda t: "no", "u0 must"),
    ],
)
def test_a_bad_history_is_refused(u0, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        run(u0=u0)


def test_a_law_without_an_ideal_form_is_refused_by_name():
    class SemiMarkovLaw(dt.AveragedPredictor):
        def ideal(self, signal, horizon):
            raise dt.ArgumentError("SemiMarkovLaw has no ideal form: pass a step.")

    with pytest.raises(dt.ArgumentError, match="SemiMarkovLaw has no ideal form"):
        run(SemiMarkovLaw(PLANT, plants.gains(PLANT)))
