"""Laws that remember an estimate, in the batch engine: the runs of `simulate`."""

import numpy as np
import pytest

import deadtime as dt
import plants
from batches import H, require_single_runs
from deadtime.imperfections import (
    Dropout,
    Jitter,
    LateSamples,
    MeasurementDelay,
    ModeDelay,
    Noise,
    RateLimit,
    Saturation,
    StepDisturbance,
    WhiteDisturbance,
    WrongMode,
)
from shares import mostly_long

BELIEVED = plants.generic(0.3, seed=5)
TRUTH = dt.SwitchedSystem(1.02 * BELIEVED.A, 0.97 * BELIEVED.B, 0.234)
C = np.array([[1.0, 0.0, 0.2], [0.0, 1.0, 0.0]])
OF_MODES = C + 0.1 * np.random.default_rng(1).normal(size=(3, 2, 3))


def observed(C=C, law="averaged", plant=BELIEVED):
    observer = dt.kalman(plant, C, 0.1 * np.eye(3), 0.01 * np.eye(2), step=H)
    return dt.OutputFeedback(plants.LAWS[law](plant), observer, estimate=[0.1, -0.2, 0.3])


def tracking(plant=BELIEVED, integral=True, disturbance=None):
    servo = dt.Servo(plant, C, integral=integral, disturbance=disturbance)
    K = servo.place([-1.0, -1.5, -2.0, -2.5, -3.0][: 5 if integral else 3], step=H)
    n, law = servo.model.states, dt.AveragedPredictor(servo.plant, K, allow_unstable=True)
    observer = dt.kalman(servo.model, servo.C, 0.1 * np.eye(n), 0.01 * np.eye(2), step=H)
    steps = [0.0, 2.0], [[0.0, 0.3], [0.5, -0.2]]
    return dt.OutputFeedback(law, observer, servo=servo, reference=steps)


OBSERVED = {"observed": observed()}
APART = {"modes apart": observed(law="averaged, dwell-aware")}
TRACKING = {"tracking": tracking()}
CASES = {
    "outputs of each mode": ({"own": observed(OF_MODES)}, [LateSamples(2, 0.3), Noise(0.02)]),
    "wrong and late modes": (APART, [WrongMode(0.1), ModeDelay(2)]),
    "measured within periods": (OBSERVED, [Jitter(0.05), MeasurementDelay(0.12), Dropout(0.2)]),
    "all": (
        OBSERVED | APART | TRACKING,
        [
            Noise([0.02, 0.03]), Dropout(0.1), LateSamples(2, 0.2), WrongMode(0.05),
            Saturation(-1.0, 1.2), RateLimit([3.0, 4.0]), WhiteDisturbance(0.01),
        ],
    ),
    "tracking": (TRACKING | {"without a sum": tracking(integral=False)}, []),
    "tracking, limited": (TRACKING, [Saturation(-0.5, 0.6), StepDisturbance([0.2, 0.0, 0.1])]),
    "tracking with a disturbance estimated": (
        {"estimated": tracking(disturbance=[[0.0], [1.0], [0.0]])}, [Noise(0.01)]
    ),
}  # fmt: skip


# At every change one that knows how old a mode is.
# Without imperfections: `test_output_feedback.py`.
FEW = (("all", ("modes apart",)),)


@pytest.mark.parametrize(
    ("case", "names"),
    mostly_long([*((case, tuple(laws)) for case, (laws, _) in CASES.items()), *FEW], *FEW),
)
def test_remembering_scenarios_are_those_of_single_runs(case, names):
    laws, given = CASES[case]
    require_single_runs(TRUTH, {name: laws[name] for name in names}, given)


@pytest.mark.long  # one follows a reference; at every change single runs do: `test_tracking.py`
@pytest.mark.parametrize("name", ["observed", "tracking"])
def test_so_are_they_with_delays_of_every_mode_and_input(name):
    own = [[0.3, 0.07], [0.21, 0.1], [0.3, 0.26]]
    believed = plants.generic(own, seed=5)
    truth = dt.SwitchedSystem(TRUTH.A, TRUTH.B, [[0.28, 0.07], [0.21, 0.14], [0.31, 0.2]])
    law = {"observed": observed, "tracking": tracking}[name](plant=believed)
    require_single_runs(truth, {name: law}, [Noise(0.02), Dropout(0.1), Saturation(-1.0, 1.2)])


@pytest.mark.long  # compiled for two kinds of laws
def test_laws_that_measure_states_and_laws_that_measure_outputs_keep_apart_what_they_hear():
    laws = {name: plants.LAWS[name](BELIEVED) for name in ("averaged", "weighted")}
    laws = {"averaged": laws["averaged"], "outputs": observed(), "weighted": laws["weighted"]}
    given = [Noise(0.02), Jitter(0.05), Dropout(0.1), WhiteDisturbance(0.01)]

    def cost(some):
        return dt.monte_carlo(
            TRUTH, some, dt.Markov(2.0 - 2.0 * np.eye(3)), [0.3, -0.6, 0.9], 3.0, H, 9, 5,
            imperfections=given,
        ).cost  # fmt: skip

    both = cost(laws)
    for name, law in laws.items():
        np.testing.assert_array_equal(both.sel(law=name), cost({name: law}).sel(law=name))
