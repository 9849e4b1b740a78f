"""What cannot be simulated, and how it is refused."""

import re

import numpy as np
import pytest

import deadtime as dt
import plants

H = 0.1
PLANT = plants.generic()  # D = 0.234, φ = 0.034, N = 3
LAW = plants.LAWS["averaged"](PLANT)
SIGNAL = plants.off_grid()
X0 = [1.0, -0.5, 0.8]
HISTORY = np.random.default_rng(5).normal(size=(2, 3))


def run(horizon=3.0, u0=HISTORY, times=None, signal=SIGNAL, law=LAW, step=H, x0=X0, plant=PLANT):
    return dt.simulate(plant, law, signal, x0, horizon, step=step, u0=u0, times=times)


TWO_MODES = dt.SwitchedSystem(PLANT.A[:2], PLANT.B[:2], 0.234)
ONE_INPUT = dt.SwitchedSystem(PLANT.A, PLANT.B[:, :, :1], 0.234)
TWO_STATES = dt.SwitchedSystem(
    np.tile(plants.paper().A[:1], (3, 1, 1)), np.tile(np.eye(2), (3, 1, 1)), 0.234
)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"horizon": 0.0}, "horizon must be positive, in s, got 0."),
        ({"horizon": np.inf}, "horizon must be finite, got inf."),
        ({"step": -0.1}, "step must be positive, in s, got -0.1."),
        (
            {"law": dt.DelayedStateFeedback(TWO_MODES, plants.gains(TWO_MODES))},
            "law must be made for a plant with 3 modes, got a law for 2",
        ),
        (
            {"law": dt.DelayedStateFeedback(TWO_STATES, -9.0 * np.tile(np.eye(2), (3, 1, 1)))},
            "law must be made for a plant with 3 states, got a law for 2",
        ),
        (
            {"law": dt.DelayedStateFeedback(ONE_INPUT, plants.gains(ONE_INPUT))},
            "law must be made for a plant with 2 inputs, got a law for 1",
        ),
        (
            {"signal": dt.SwitchingSignal([0, 0.4], [0, 3])},
            "signal enters mode 3 at 0.4 s, but the plant's modes are 0..2",
        ),
        ({"x0": [1.0, 2.0]}, "x0 must have shape (n,) = (3,), got (2,)."),
        ({"x0": [X0]}, "x0 must have shape (n,), got (1, 3)."),
        ({"x0": [1.0, np.nan, 0.0]}, "x0[1] must be finite, got nan."),
        ({"times": [0.0, 0.2, 0.1]}, "times must increase within [0, horizon] = [0, 3]"),
        (
            {"times": [-0.1, 0.2]},
            "times must increase within [0, horizon] = [0, 3], got -0.1 … 0.2.",
        ),
        ({"times": [0.0, 3.1]}, "times must increase within [0, horizon] = [0, 3], got 0 … 3.1."),
        ({"times": [[0.0]]}, "times must have shape (T,), got (1, 1)."),
        ({"u0": [1.0]}, "u0 must have shape (m,) = (2,), got (1,)."),
        (
            {"u0": HISTORY.T},
            "u0 must hold (m, N) = (2, 3) samples, oldest first, one per period of "
            "the longer delay 0.234 s, got (3, 2).",
        ),
        ({"u0": HISTORY[:, :2]}, "u0 must hold (m, N) = (2, 3) samples"),
        ({"u0": HISTORY * np.nan}, "u0[0, 0] must be finite, got nan."),
        ({"u0": [np.inf, 0.0]}, "u0[0] must be finite, got inf."),
        ({"u0": HISTORY[None]}, "u0 must have shape (m,), got (1, 2, 3)."),
        ({"u0": [[1.0, 2.0, 3.0], [1.0]]}, "u0 must"),
        ({"u0": lambda t: [t]}, "u0 must have shape (m,) at every time"),
        ({"u0": lambda t: [t] * (1 if t < -0.15 else 2)}, "u0 must have shape (m,) at every time"),
        ({"u0": lambda t: [np.nan, t]}, "u0[0] must be finite, got nan."),
        ({"u0": lambda t: ["a", "b"]}, "u0 must hold real numbers"),
        (
            {"law": plants.LAWS["exact"](PLANT), "signal": dt.SwitchingSignal([0.0], [0], end=3.2)},
            "signal must be known up to the last sample plus the delay, 3.234 s",
        ),
    ],
)
def test_what_cannot_be_simulated_is_refused_by_name(options, message):
    with pytest.raises(dt.ArgumentError, match=re.escape(message)):
        run(**options)
