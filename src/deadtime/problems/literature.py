"""Named plants from the literature, cited, each with gains, laws and a signal ready to run.

    problem = deadtime.problems.paper()
    run = problem.simulate("averaged")

Each is the commented problem file of its name, which `deadtime init` writes, with a longer signal
and the numbers that the source prints.

None of the sources publishes its switching signal. Each is drawn here at random with the source's
dwell time; of the seeds 0 to 200 the one with the median ∫|x|² under the averaged law is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from deadtime.feedback import Law
from deadtime.gains import place
from deadtime.laws import (
    AveragedPredictor,
    DelayedStateFeedback,
    ExactPredictor,
    MeanPredictor,
    SingleModePredictor,
)
from deadtime.plant import SwitchedSystem
from deadtime.problems.file.load import problem_with_run
from deadtime.problems.law_registry import name_of
from deadtime.problems.problem import Problem, Published
from deadtime.problems.templates import NAMES
from deadtime.switching import SwitchingSignal


def comparison_laws(
    plant: SwitchedSystem,
    gains: Float[np.ndarray, "mode m n"],
    mean: MeanPredictor | None,
    allow_unstable: bool = False,
    modes: Sequence[str] = (),
) -> dict[str, Law]:
    """The paper's comparison: averaged, each single mode, mean, oracle, and the baseline.

    `modes` gives the names of laws of one mode.
    """
    laws: list[Law] = [AveragedPredictor(plant, gains, allow_unstable=allow_unstable)]
    if plant.modes > 1:
        laws += [
            SingleModePredictor(plant, gains, mode, allow_unstable=allow_unstable)
            for mode in range(plant.modes)
        ]
    laws += [mean] if mean is not None else []
    laws += [
        ExactPredictor(plant, gains, allow_unstable=allow_unstable),
        DelayedStateFeedback(plant, gains, allow_unstable=allow_unstable),
    ]
    return {name_of(law, modes): law for law in laws}


def _problem(name: str, seed: int, end: float, *notes: str) -> Problem:
    """The problem of a file, with its signal drawn up to `end`, and notes, the signal's first."""
    problem = problem_with_run(Path(name), {})
    dwell, mean = problem.dwell_time or 0.0, problem.mean_sojourn or 0.0
    signal = SwitchingSignal.random(
        problem.plant.modes, end, dwell_time=dwell, mean_sojourn=mean, seed=seed
    )
    note = (
        f"The source does not publish its switching signal. This one has sojourns of {dwell:g} s "
        f"plus an exponential time of mean {mean - dwell:g} s, and of 201 such signals (seeds 0 to "
        f"200) it is the one whose ∫|x|² under the averaged law is the median (seed {seed})."
    )
    return replace(problem, signal=signal, u0=0.0, notes=(note, *notes))


def paper() -> Problem:
    """The example of arXiv 2503.08446: two unstable modes, D = 1 s, dwell time 0.2 s.

    The paper's modes 1 and 2 are 0 and 1 here.

    Examples
    --------
    >>> paper().gains.round(4).tolist()
    [[[-12.0, -6.0]], [[-12.6961, -6.3725]]]
    """
    problem = _problem("paper", 39, 20.0, "The paper's modes 1 and 2 are modes 0 and 1 here.")
    plant, gains = problem.plant, problem.gains
    distance = max(
        np.linalg.norm(M[0] - M[1], 2) for M in (plant.A, plant.B, gains)
    )  # ε of equation (5)
    return replace(
        problem,
        published=(
            Published("K of mode 0", np.array([-12.0, -6.0]), gains[0, 0]),
            Published("K of mode 1", np.array([-12.6961, -6.3725]), gains[1, 0]),
            Published(
                "K of the mean plant",
                np.array([-12.3515, -6.1881]),
                place(plant.mean(), [-1.0, -2.0])[0, 0],
            ),
            Published("ε, the modes' distance", np.array([0.7895]), np.array([distance])),
        ),
        constants={"distance ε": 0.7895, "allowed distance ε*": 7e-5},
    )


def three_mode() -> Problem:
    """The three-mode plant of arXiv 2506.03908: D = 1 s, dwell time 0.9 s.

    Its mean law uses the published gain and the minimax centres of the matrices; the centre of
    A is not unique. Its averaged loop, too, is unstable with mode 0 held.

    Examples
    --------
    >>> three_mode().plant
    SwitchedSystem(modes=3, states=2, inputs=1, delay=1)
    """
    return _problem(
        "three-mode",
        114,
        20.0,
        "Initial state and horizon are ours. The mean law uses the published gain "
        "[−11.7782, −7.7318] with a minimax centre of the modes; the centre of A is not "
        "unique, [[1.04, 1.1], [1.07, 2.065]] is taken.",
    )


def follower() -> Problem:
    """A car that follows another one, by throttle or by brake, with an actuator delay.

        d(spacing error)/dt = relative speed − h_g a,   d(relative speed)/dt = −a,
        da/dt = (u(t − D) − a)/τ_i,   i = throttle, brake

    with the gap policy spacing + h_g·speed behind a car of constant speed. The numbers are
    representative, assembled from several sources: no single one gives them all.

    Examples
    --------
    >>> follower().modes
    ('throttle', 'brake')
    """
    return _problem(
        "follower",
        140,
        15.0,
        "Which lag belongs to which actuator, unit actuator gains, the poles −1.5, −2, "
        "−2.5 and a dwell time of 1 s are modelling choices of ours; on the road the "
        "mode depends on the state.",
    )


NAMED: Mapping[str, Callable[[], Problem]] = dict(
    zip(NAMES, (paper, three_mode, follower), strict=True)
)
