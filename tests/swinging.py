"""A plant of three modes under rules of its state, and runs of it."""

import numpy as np

import deadtime as dt
from deadtime.laws import StateDependentPredictor
from deadtime.switching import Polyhedra

H = 0.1


def swinging(delay=0.234, seed=3):
    """Three modes that swing alike, so that trajectories cross boundaries and few chatter.

    Three states, two inputs; D = 0.234 gives N = 3 and φ = 0.034.
    """
    rng = np.random.default_rng(seed)
    A = [[0.1, 2.0, 0.3], [-2.0, 0.1, 0.0], [0.2, 0.0, -0.3]]
    B = [[0.0, 0.2], [1.0, 0.0], [0.1, 1.0]]
    size = 0.08
    return dt.SwitchedSystem(
        A + size * rng.normal(size=(3, 3, 3)), B + size * rng.normal(size=(3, 3, 2)), delay
    )


SOFT = (-0.02 + 2.0j, -0.02 - 2.0j, -0.7)


def soft(plant):
    """Gains that let the plant go on swinging."""
    return dt.place(plant, SOFT)


PLANT = swinging()
X0 = np.array([1.0, -0.5, 0.8])
HISTORY = np.random.default_rng(5).normal(size=(2, 3))

# Three modes: a half-space, and the other half cut in two.
NORMALS = np.array([[1.0, 0.2, -0.3], [-0.4, 1.0, 0.1]])
OFFSETS = np.array([0.1, -0.05])
WEDGE = Polyhedra(
    [
        (NORMALS[:1], OFFSETS[:1]),
        (np.stack((-NORMALS[0], NORMALS[1])), [-OFFSETS[0], OFFSETS[1]]),
        (np.stack((-NORMALS[0], -NORMALS[1])), [-OFFSETS[0], -OFFSETS[1]]),
    ]
)


def wedge(x):
    """The same rule as a function."""
    if NORMALS[0] @ x <= OFFSETS[0]:
        return 0
    return 1 if NORMALS[1] @ x <= OFFSETS[1] else 2


def ball(x):
    """A rule with a curved boundary."""
    return 0 if x[0] ** 2 + 2.0 * x[1] ** 2 < 0.5 else 1 + int(x[1] > 0.0)


RULES = {"wedge": WEDGE, "wedge as a function": wedge, "ball": ball}
BOUNDARIES = {
    "wedge": [lambda x: NORMALS[0] @ x - OFFSETS[0], lambda x: NORMALS[1] @ x - OFFSETS[1]],
    "ball": [lambda x: x[0] ** 2 + 2.0 * x[1] ** 2 - 0.5, lambda x: x[1]],
}
BOUNDARIES["wedge as a function"] = BOUNDARIES["wedge"]


def predictor(plant=PLANT, rule=WEDGE):
    return StateDependentPredictor(plant, soft(plant), rule)


def run(law, rule=WEDGE, plant=PLANT, x0=X0, horizon=3.0, u0=HISTORY, step=H, times=None):
    return dt.simulate(plant, law, rule, x0, horizon, step=step, u0=u0, times=times)


ROTATION = np.array([[0.0, 1.0], [-1.0, 0.0]])


def rotating(speeds, delay=0.5):
    """x = R(cos θ, −sin θ), θ' the speed of the mode; no input reaches it."""
    A = np.array([w * ROTATION for w in speeds])
    return dt.SwitchedSystem(A, np.zeros((len(speeds), 2, 1)), delay)


def idle(plant):
    return dt.DelayedStateFeedback(plant, np.zeros((plant.modes, 1, 2)), allow_unstable=True)


def idle_scalar(plant):
    return dt.DelayedStateFeedback(plant, np.zeros((plant.modes, 1, 1)), allow_unstable=True)
