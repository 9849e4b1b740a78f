"""Certificates of small loops of every kind, for whoever verifies them."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

import deadtime as dt
import plants
from certificate_reference import packed, rewritten
from exponential_products import ellipses

CORPUS = Path(__file__).parents[1] / "verifier/corpus"
PAPER = dt.problems.paper().plant
THREE = dt.problems.three_mode().plant


def with_delay(plant, delay):
    return dt.SwitchedSystem(plant.A, plant.B, delay)


def designed(plant, poles=(-1.0, -2.0), dwell_time=None):
    return plant, dt.AveragedPredictor(plant, dt.place(plant, poles), None, dwell_time)


GENERIC = plants.generic().apart(0.05)  # three modes, three states, two inputs, N = 3
PAIR = with_delay(PAPER.apart(0.3), 0.234)  # with a period of 0.1, N = 3 and φ = 0.034
ALONE = dt.SwitchedSystem(PAIR.A[:1], PAIR.B[:1], 0.234)
MILD = dt.SwitchedSystem(PAPER.apart(0.5).A - 2.0 * np.eye(2), PAPER.apart(0.5).B, 0.234)
WEAK = np.tile([[-0.5, -0.5]], (2, 1, 1))
ALIKE = dt.SwitchedSystem(PAIR.A[[0, 0]], PAIR.B[[0, 0]], 0.5)


def of(law, plant=PAIR):
    return plant, plants.LAWS[law](plant)


def mild(delay, law=dt.AveragedPredictor):
    return dt.SwitchedSystem(1.02 * MILD.A, 0.97 * MILD.B, delay), law(MILD, WEAK)


def free(A, delay=0.1):
    plant = dt.SwitchedSystem(A, np.ones((*A.shape[:2], 1)), delay)
    none = np.zeros((len(A), 1, A.shape[1]))
    return plant, dt.DelayedStateFeedback(plant, none, allow_unstable=True)


def corners(*factors):
    return [dt.SwitchedSystem(a * MILD.A, b * MILD.B, MILD.delay) for a, b in factors]


def around(plant, part, delay=0.0):
    """A plant whose entries are known to a part of their sizes, some of them together."""
    entries = np.concatenate((plant.A.ravel(), plant.B.ravel()))
    rng = np.random.default_rng(5)
    root = np.diag(np.abs(entries) + 0.2) + 0.2 * rng.standard_normal((entries.size,) * 2)
    covariance = np.zeros((entries.size + plant.inputs,) * 2)
    covariance[: entries.size, : entries.size] = part**2 * root @ root.T
    covariance[entries.size :, entries.size :] = delay**2 * np.eye(plant.inputs)
    return dt.UncertainPlant(plant, covariance)


def of_pair(alpha):
    far = THREE.apart(alpha)
    plant = dt.SwitchedSystem(far.A[:2], far.B[:2], far.delay)
    return plant, dt.AveragedPredictor(plant, dt.place(plant, (-2.0, -3.0)), None, 0.8)


BOTH = np.array([[[1.0, 1.0], [0.0, 0.5]], [[1.1, 0.95], [0.02, 0.45]]])


def expecting(plant):
    model = dt.Markov(1.0 - np.eye(plant.modes))
    return plant, dt.ExpectedPredictor(plant, dt.place(plant, (-1.0, -2.0)), model)


INPUTS = np.array([[[1.0, 0.0], [0.2, 1.0]], [[1.02, 0.0], [0.2, 0.98]]])


def several(delays, law=dt.AveragedPredictor, factor=1.0):
    """Two inputs that move two states at will, each with a delay of its own."""
    plant = dt.SwitchedSystem(BOTH, INPUTS, delays)
    gains = np.linalg.solve(INPUTS, np.diag((-1.0, -1.5)) - BOTH)
    return plant, law(plant, factor * gains)


def one_of_several(part):
    """One mode of them, of which each entry and delay is known to a part."""
    plant, law = several([0.34, 0.17])
    alone = dt.SwitchedSystem(plant.A[:1], plant.B[:1], plant.delays[:1])
    return around(alone, part, 0.001), dt.AveragedPredictor(alone, law.gains[:1])


def slow(delays):
    plant = dt.SwitchedSystem(BOTH - 1.5 * np.eye(2), INPUTS, delays)
    return plant, dt.DelayedStateFeedback(plant, 0.1 * several(delays)[1].gains)


CALM = BOTH - [[[1.2, 0.5], [0.3, 1.0]]]  # decays, and turns


def on_outputs(delay, C=((1.0, 0.5),), true=None):
    """An observer of one output of two states; the true plant may be another one."""
    plant = dt.SwitchedSystem(CALM, INPUTS, delay)
    law = dt.AveragedPredictor(plant, dt.lqr(plant, np.eye(2), np.eye(2), step=0.1))
    return plant if true is None else true, dt.OutputFeedback(
        law, dt.luenberger(plant, np.array(C), (-2.0, -3.0), 0.1)
    )


def tracking(disturbance=None):
    """One state and one input: the sum of its errors, and a disturbance that is estimated."""
    plant = dt.SwitchedSystem([[[0.0]], [[0.2]]], [[[1.0]], [[1.1]]], 0.17)
    servo = dt.Servo(plant, [[1.0]], disturbance=disturbance)
    law = dt.AveragedPredictor(servo.plant, servo.place([-1.0, -1.5], 0.1), allow_unstable=True)
    observer = dt.luenberger(servo.model, servo.C, [-3.0, -4.0][: servo.model.states], 0.1)
    return plant, dt.OutputFeedback(law, observer, servo=servo)


# Three modes, of which 0 and 2, which do not follow each other, would grow in turns.
TURNS = np.array([[[0.0, 1], [-10, -1]], [[-2, 1], [-1, -2]], [[0, 1], [-0.1, -0.5]]])
THROUGH = {"transitions": [[0, 1, 0], [1, 0, 1], [0, 1, 0]]}
RISING = {"transitions": [[int(j <= i + 1) for j in range(4)] for i in range(4)]}
SAMPLES = {"at": "samples"}


def through(gain=0.1):
    plant = dt.SwitchedSystem(TURNS, [[[0.3], [0.0]], [[0.0], [1.0]], [[0.2], [0.1]]], 0.1)
    gains = np.tile([[-gain, 0.0]], (3, 1, 1))
    return plant, dt.DelayedStateFeedback(plant, gains, allow_unstable=True)


def aged_pair():
    """Modes that turn differently, under rows by mode and age."""
    plant = dt.SwitchedSystem(TURNS[[0, 2]], [[[0.3], [0.0]], [[0.2], [0.1]]], 0.1)
    return plant, dt.AveragedPredictor(plant, np.full((2, 1, 2), -0.02), dwell_time=0.4)


OF_INPUTS = [0.15, 0.234]  # s


def half_turns():
    """Modes that turn by half in 0.1 s: at samples they only shrink, between them they may grow."""
    turn = np.array([[-0.5, 10.0 * np.pi], [-10.0 * np.pi, -0.5]])
    return free(np.array([S @ turn @ np.linalg.inv(S) for S in (np.eye(2), np.diag([3.0, 1.0]))]))


def delays_in_turn():
    """A mode for every delay of four to seven periods of 0.05 s."""
    A, B = [[0.0, 1.0], [0.5, -0.2]], [[0.0], [1.0]]
    plant = dt.SwitchedSystem([A] * 4, [B] * 4, [[0.2], [0.25], [0.3], [0.35]])
    return designed(plant, (-1.5, -2.0))


def in_a_ring(delays=OF_INPUTS):
    """Scalar, of two inputs: mode 0 grows under its own gains if it is held, and may not be."""
    plant = dt.SwitchedSystem([[[0.6]], [[-2.0]], [[-0.5]]], [[[1.0, 0.5]]] * 3, delays)
    gains = np.array([[[-0.3], [-0.1]], [[-0.5], [0.2]], [[-0.2], [0.1]]])
    return plant, dt.DelayedStateFeedback(plant, gains, allow_unstable=True)


RING = {"transitions": [[0, 1, 0], [0, 0, 1], [1, 0, 0]], "maximum_dwell": [0.9, math.inf, 1.2]}
UNSTABLE = np.array([[[0.1, 1.0], [-1.0, 0.1]], [[-0.5, 0.3], [-0.3, -0.5]]])
DELAYED = dt.DelayedStateFeedback(MILD, WEAK)
Case = tuple[Callable[[], tuple], float | list[float], float, dict]

# name: (plant and law, dwell time, period, what else)
CASES: dict[str, Case] = {
    "generic-averaged": (lambda: of("averaged", GENERIC), 0.25, 0.1, {}),
    "generic-mean": (lambda: of("mean with gains", GENERIC), 0.11, 0.1, {}),
    "weighted": (lambda: of("weighted"), 0.3, 0.1, {}),
    "single": (lambda: of("single"), 0.3, 0.1, {}),
    "mean": (lambda: of("mean"), 0.17, 0.1, {}),
    "averaged-dwell": (lambda: of("averaged, dwell-aware"), 0.1634, 0.1, {}),
    "mean-dwell": (lambda: of("mean, dwell-aware"), 0.31, 0.1, {}),
    "expected": (lambda: of("expected"), 0.3, 0.1, {}),
    "delayed": (lambda: (MILD, DELAYED), 0.3, 0.1, {}),
    "short-delay": (lambda: designed(with_delay(PAIR, 0.034)), 0.2, 0.1, {}),
    "one-period": (lambda: designed(with_delay(PAIR, 0.1)), 0.2, 0.1, {}),
    "short-delay-mode": (lambda: mild(0.034, dt.DelayedStateFeedback), 0.2, 0.1, {}),
    "later-plant": (lambda: mild(0.434), 0.3, 0.1, {}),
    "sooner-plant": (lambda: mild(0.034), 0.3, 0.1, {}),
    "every-age": (lambda: of_pair(0.5), 0.8, 0.2, {}),
    "one-mode": (lambda: designed(ALONE), 0.3, 0.1, {}),
    "alike": (lambda: designed(ALIKE), 0.3, 0.1, {}),
    "paper": (lambda: designed(PAPER.apart(0.6)), 0.2, 0.1, {}),
    "paper-far": (lambda: designed(PAPER.apart(0.65)), 0.2, 0.1, {}),
    "paper-dwell": (lambda: designed(PAPER.apart(0.6), dwell_time=0.4), 0.4, 0.1, {}),
    "three": (lambda: designed(THREE.apart(0.5), (-2.0, -3.0)), 0.9, 0.1, {}),
    "free-rate-0": (lambda: free(ellipses(2.0, 0.5)), 0.25, 0.1, {"decay_rate": 0.0}),
    "maximum-free": (lambda: free(UNSTABLE), 1.0, 0.1, {"maximum_dwell": 1.8}),
    "maximum": (lambda: designed(PAPER.apart(0.65)), 0.2, 0.1, {"maximum_dwell": 0.7}),
    "maximum-dwell": (
        lambda: of("averaged, dwell-aware"),
        *(0.1634, 0.1, {"maximum_dwell": 0.5}),
    ),
    "average-free": (lambda: free(ellipses(4.0, 0.8)), 4.0, 0.1, {"chatter": 2}),
    "average-turning": (lambda: free(TURNS[[0, 2]]), 6.0, 0.1, {"chatter": 3}),
    "average-aged": (lambda: aged_pair(), 9.0, 0.1, {"chatter": 2}),
    "average": (lambda: designed(PAPER.apart(0.6)), 0.2, 0.1, {"chatter": 3}),
    "average-dwell": (lambda: of("averaged, dwell-aware"), 0.3, 0.1, {"chatter": 2}),
    "range": (lambda: (MILD, DELAYED), 0.3, 0.1, {"delays": (0.2, 0.29)}),
    "range-narrow": (lambda: designed(PAIR), 0.3, 0.1, {"delays": (0.233, 0.235)}),
    "polytope": (
        lambda: (corners((1, 1), (1.1, 1), (1, 0.9)), dt.AveragedPredictor(MILD, WEAK)),
        *(0.3, 0.1, {"decay_rate": 0.1}),
    ),
    "polytope-mode": (lambda: (corners((1, 1), (1.05, 1)), DELAYED), 0.2, 0.1, {}),
    "ellipsoid": (lambda: (around(MILD, 0.01), DELAYED), 0.2, 0.1, {}),
    "ellipsoid-range": (
        lambda: (around(MILD, 0.005, 0.001), DELAYED),
        *(0.2, 0.1, {"decay_rate": 0.1}),
    ),
    "ellipsoid-ranges": (
        lambda: one_of_several(0.003),
        *(0.3, 0.1, {"decay_rate": 0.0}),
    ),
    "tolerant": (lambda: designed(PAIR), 0.3, 0.1, {"clock_tolerance": 0.05}),
    "delays-inputs": (lambda: several([0.34, 0.17]), 0.3, 0.1, {}),
    "delays-short": (lambda: several([0.04, 0.07]), 0.2, 0.1, {}),
    "delays-alike": (lambda: several([0.37, 0.27]), 0.25, 0.1, {}),
    "delays-modes": (lambda: designed(with_delay(PAIR, [[0.3], [0.27]])), 0.23, 0.1, {}),
    "delays-both": (lambda: several([[0.34, 0.17], [0.22, 0.26]]), 0.3, 0.1, {}),
    "delays-by-mode": (
        lambda: slow([[0.34, 0.1], [0.05, 0.26]]),
        *(0.23, 0.1, {"maximum_dwell": 0.6}),
    ),
    "ranges-inputs": (
        lambda: several([0.34, 0.17]),
        *(0.3, 0.1, {"delays": ([0.335, 0.165], [0.345, 0.175])}),
    ),
    "ranges-one": (
        lambda: several([0.34, 0.34]),
        *(0.3, 0.1, {"delays": ([0.33, 0.34], [0.36, 0.34])}),
    ),
    "ranges-modes": (
        lambda: designed(with_delay(PAIR, [[0.3], [0.27]])),
        *(0.23, 0.1, {"delays": ([[0.299], [0.268]], [[0.3], [0.272]])}),
    ),
    "ranges-polytope": (
        lambda: (corners((1, 1), (1.05, 1)), DELAYED),
        *(0.2, 0.1, {"delays": ([[0.29], [0.25]], [[0.3], [0.3]])}),
    ),
    "rate": (lambda: designed(PAIR), 0.2, 0.1, {"decay_rate": 0.3}),
    "late-mode": (lambda: (MILD, DELAYED), 0.5, 0.1, {"mode_lag": 2}),
    "late-far": (lambda: expecting(PAPER.apart(0.5)), 0.5, 0.1, {"mode_lag": 2}),
    "late-long": (lambda: (MILD, DELAYED), 0.3, 0.1, {"mode_lag": 6}),
    "late-expected": (lambda: of("expected"), 0.6, 0.1, {"mode_lag": 3, "decay_rate": 0.0}),
    "late-dwell": (
        lambda: of("averaged, dwell-aware"),
        *(0.4, 0.1, {"mode_lag": 2, "decay_rate": 0.0}),
    ),
    "late-three": (
        lambda: of("expected", GENERIC),
        *(0.4, 0.1, {"mode_lag": 5, "decay_rate": 0.0}),
    ),
    "late-thrice": (lambda: expecting(with_delay(THREE, 0.3)), 0.4, 0.1, {"mode_lag": 2}),
    "late-maximum": (lambda: (MILD, DELAYED), 0.3, 0.1, {"mode_lag": 4, "maximum_dwell": 0.8}),
    "late-average": (lambda: (MILD, DELAYED), 0.3, 0.1, {"mode_lag": 2, "chatter": 2}),
    "late-range": (lambda: (MILD, DELAYED), 0.4, 0.1, {"mode_lag": 2, "delays": (0.2, 0.29)}),
    "late-delays": (
        lambda: slow([[0.34, 0.1], [0.05, 0.26]]),
        *(0.43, 0.1, {"mode_lag": 2}),
    ),
    "observed": (lambda: on_outputs([0.14, 0.05]), 0.3, 0.1, {}),
    "observed-modes": (
        lambda: on_outputs(0.1, [[[1.0, 0.5]], [[1.0, 0.4]]]),
        *(0.25, 0.1, {"maximum_dwell": 0.6}),
    ),
    "observed-average": (lambda: on_outputs(0.1), 0.5, 0.1, {"chatter": 2, "decay_rate": 0.0}),
    "observed-range": (
        lambda: on_outputs(0.14),
        *(0.3, 0.1, {"delays": (0.135, 0.145), "decay_rate": 0.0}),
    ),
    "observed-late": (lambda: on_outputs(0.1), 0.5, 0.1, {"mode_lag": 1}),
    "ways": (lambda: through(), [0.3, 0.6, 0.3], 0.15, {"decay_rate": 0.02, **THROUGH}),
    "ways-ring": (in_a_ring, [0.3, 0.7, 0.25], 0.1, {"decay_rate": 0.0, **RING}),
    "ways-late": (
        lambda: in_a_ring(0.15),
        *([0.3, 0.9, 0.25], 0.1, {"mode_lag": 3, "decay_rate": 0.0, **RING}),
    ),
    "tracking": (lambda: tracking(), 0.5, 0.1, {}),
    "tracking-disturbance": (lambda: tracking([[1.0]]), 0.8, 0.1, {}),
    "lost-state": (lambda: (MILD, DELAYED), 0.3, 0.1, {"lost_samples": 2}),
    "lost-unseen": (lambda: (MILD, DELAYED), 0.2, 0.1, {"lost_samples": 4}),
    "lost-far": (lambda: mild(1.234), 0.3, 0.1, {"lost_samples": 1}),
    "lost-dwell": (
        lambda: of("averaged, dwell-aware"),
        *(0.4, 0.1, {"lost_samples": 1, "decay_rate": 0.0}),
    ),
    "lost-average": (lambda: (MILD, DELAYED), 0.3, 0.1, {"lost_samples": 1, "chatter": 2}),
    "lost-one-mode": (lambda: designed(ALONE), 0.3, 0.1, {"lost_samples": 1}),
    "lost-observed": (lambda: on_outputs([0.14, 0.05]), 0.3, 0.1, {"lost_samples": 2}),
    "lost-modes": (
        lambda: on_outputs(0.1, [[[1.0, 0.5]], [[1.0, 0.4]]]),
        *(0.25, 0.1, {"maximum_dwell": 0.6, "lost_samples": 1}),
    ),
    "lost-range": (
        lambda: on_outputs(0.14),
        *(0.3, 0.1, {"delays": (0.135, 0.145), "decay_rate": 0.0, "lost_samples": 1}),
    ),
    "lost-tracking": (lambda: tracking(), 0.3, 0.1, {"lost_samples": 1}),
    "samples": (lambda: designed(PAIR), 0.1, 0.1, SAMPLES),
    "samples-turning": (half_turns, 0.1, 0.1, SAMPLES),
    "samples-ring": (in_a_ring, [0.3, 0.7, 0.25], 0.1, {"decay_rate": 0.0, **RING, **SAMPLES}),
    "samples-ways": (delays_in_turn, 0.05, 0.05, {"decay_rate": 1.2, **RISING, **SAMPLES}),
    "samples-aged": (lambda: of("averaged, dwell-aware"), 0.2, 0.1, SAMPLES),
    "samples-late": (lambda: (MILD, DELAYED), 0.2, 0.1, {"mode_lag": 3, **SAMPLES}),
    "samples-lost": (lambda: (MILD, DELAYED), 0.1, 0.1, {"lost_samples": 2, **SAMPLES}),
    "samples-average": (lambda: free(ellipses(4.0, 0.8)), 4.0, 0.1, {"chatter": 2, **SAMPLES}),
    "samples-range": (lambda: (MILD, DELAYED), 0.1, 0.1, {"delays": (0.2, 0.29), **SAMPLES}),
}


# The same with V at a few ages only: the name of the case, and the ages.
STRETCHES = {
    "stretches-paper": ("paper", (0, 1)),
    "stretches-paper-far": ("paper-far", (0, 1)),
    "stretches-dwell": ("paper-dwell", (2, 4)),  # before, V is singular to round-off
    "stretches-every-age": ("every-age", (2, 4)),
    "stretches-maximum": ("maximum", (0, 3)),
    "stretches-maximum-free": ("maximum-free", (5,)),
    "stretches-generic": ("generic-averaged", (1, 2)),
    "stretches-off-grid": ("averaged-dwell", (0, 2)),
    "stretches-range": ("range", (0, 1, 2)),
    "stretches-polytope": ("polytope-mode", (0, 1)),
    "stretches-ellipsoid": ("ellipsoid", (0, 1)),
    "stretches-delays": ("delays-both", (1, 2)),
    "stretches-ranges": ("ranges-modes", (0, 1, 2)),
    "stretches-ways": ("ways-ring", (1, 2, 6)),
    "stretches-one-mode": ("one-mode", (0,)),
    "stretches-late": ("late-mode", (3, 4)),
    "stretches-late-dwell": ("late-dwell", (2, 4)),
    "stretches-late-three": ("late-thrice", (2, 3)),
}


def save(name: str, path: Path) -> Path:
    """Write the certificate of a case.

    Where V decreases at every step it does along every stretch of steps: so V of a linear one at
    a few ages makes one along stretches.
    """
    case, ages = STRETCHES.get(name, (name, ()))
    loop, dwell_time, step, options = CASES[case]
    found = dt.certify(*loop(), dwell_time, step, **options)
    assert found.proven, (case, found.message)
    found.save(path)
    if ages:
        modes = range(found.evidence.setting.modes)
        P = np.array([[found.lyapunov(i, a) for a in ages] for i in modes])
        P = 0.5 * (P + P.swapaxes(-1, -2))
        V = {"kind": "stretches", "knots": list(ages), "P": packed(P)}
        rewritten(path, "", {"lyapunov": V, "hints": {}})
    return path


if __name__ == "__main__":
    for name in sys.argv[1:] or (*CASES, *STRETCHES):
        save(name, CORPUS / f"{name}.json")
