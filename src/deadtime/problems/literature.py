"""Named plants from the literature, cited, each with gains, laws and a signal ready to run.

    problem = deadtime.problems.paper()
    run = problem.simulate("averaged")

None of the sources publishes its switching signal. Each is drawn here at random with the source's
dwell time; of the seeds 0 to 200 the one with the median ∫|x|² under the averaged law is taken.

Each name is also that of a commented problem file, which `deadtime init` writes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
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
from deadtime.problems.imperfection_registry import in_comments
from deadtime.problems.law_registry import name_of
from deadtime.problems.problem import Problem, Published
from deadtime.switching import SignalClass, SwitchingSignal

_SIGNAL_NOTE = (
    "The source does not publish its switching signal. This one has sojourns of {dwell:g} s plus "
    "an exponential time of mean {rest:g} s, and of 201 such signals (seeds 0 to 200) it is the "
    "one whose ∫|x|² under the averaged law is the median (seed {seed})."
)


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


def _signal(modes: int, end: float, dwell: float, mean: float, seed: int) -> tuple:
    """A random signal, and a note on its choice."""
    signal = SwitchingSignal.random(modes, end, dwell_time=dwell, mean_sojourn=mean, seed=seed)
    return signal, _SIGNAL_NOTE.format(dwell=dwell, rest=mean - dwell, seed=seed)


def paper() -> Problem:
    """The example of arXiv 2503.08446: two unstable modes, D = 1 s, dwell time 0.2 s.

    The paper's modes 1 and 2 are 0 and 1 here.

    Examples
    --------
    >>> paper().gains.round(4).tolist()
    [[[-12.0, -6.0]], [[-12.6961, -6.3725]]]
    """
    plant = SwitchedSystem(
        [[[2.0, 1.0], [0.0, 1.0]], [[2.3, 1.1], [0.05, 1.2]]],
        [[[0.0], [1.0]], [[0.0], [1.02]]],
        delay=1.0,
    )
    gains = place(plant, [-1.0, -2.0])
    gain = place(plant.mean(), [-1.0, -2.0])[0]
    signal, note = _signal(plant.modes, 20.0, dwell=0.2, mean=0.4, seed=39)
    distance = max(
        np.linalg.norm(M[0] - M[1], 2) for M in (plant.A, plant.B, gains)
    )  # ε of equation (5)
    return Problem(
        name="paper",
        title="The paper's example: two unstable modes, one second of delay",
        source="Katsanikakis and Bekiaris-Liberis, arXiv 2503.08446 (2025), Section III",
        plant=plant,
        gains=gains,
        laws=comparison_laws(plant, gains, MeanPredictor(plant, gain, gains)),
        signal=signal,
        x0=np.array([-1.0, 1.0]),
        horizon=15.0,
        signals=SignalClass(0.2),
        mean_sojourn=0.4,
        notes=(note, "The paper's modes 1 and 2 are modes 0 and 1 here."),
        published=(
            Published("K of mode 0", np.array([-12.0, -6.0]), gains[0, 0]),
            Published("K of mode 1", np.array([-12.6961, -6.3725]), gains[1, 0]),
            Published("K of the mean plant", np.array([-12.3515, -6.1881]), gain[0]),
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
    plant = SwitchedSystem(
        [[[1.0, 1.0], [1.0, 2.0]], [[0.97, 1.15], [1.06, 2.09]], [[1.08, 1.2], [1.14, 2.13]]],
        [[[0.0], [1.0]], [[0.0], [1.05]], [[0.0], [1.1]]],
        delay=1.0,
    )
    gains = place(plant, [-2.0, -3.0])
    centre = np.array([[1.04, 1.1], [1.07, 2.065]]), np.array([[0.0], [1.05]])
    mean = MeanPredictor(plant, [[-11.7782, -7.7318]], gains, mean=centre)
    signal, note = _signal(plant.modes, 20.0, dwell=0.9, mean=1.8, seed=114)
    return Problem(
        name="three-mode",
        title="Three unstable modes, one second of delay, long sojourns",
        source="Katsanikakis and Bekiaris-Liberis, arXiv 2506.03908 (2025), simulation section",
        plant=plant,
        gains=gains,
        laws=comparison_laws(plant, gains, mean),
        signal=signal,
        x0=np.array([-1.0, 1.0]),
        horizon=15.0,
        signals=SignalClass(0.9),
        mean_sojourn=1.8,
        notes=(
            note,
            "Initial state and horizon are ours. The mean law uses the published gain "
            "[−11.7782, −7.7318] with a minimax centre of the modes; the centre of A is not "
            "unique, [[1.04, 1.1], [1.07, 2.065]] is taken.",
        ),
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
    gap, lags = 0.8, (0.5, 0.2)
    plant = SwitchedSystem(
        [[[0.0, 1.0, -gap], [0.0, 0.0, -1.0], [0.0, 0.0, -1.0 / lag]] for lag in lags],
        [[[0.0], [0.0], [1.0 / lag]] for lag in lags],
        delay=0.2,
    )
    poles = [-1.5, -2.0, -2.5]
    gains = place(plant, poles)
    mean = MeanPredictor(plant, place(plant.mean(), poles)[0], gains)
    modes = ("throttle", "brake")
    signal, note = _signal(plant.modes, 15.0, dwell=1.0, mean=2.0, seed=140)
    return Problem(
        name="follower",
        title="Adaptive cruise control: throttle and brake with different lags, delayed actuators",
        source=(
            "Lag under throttle 0.5 s: Rajamani, Vehicle Dynamics and Control (2nd ed., 2012). "
            "Lag under brake 0.2 s: default brake actuation time constant of the "
            "Plexe engine model in SUMO (source file EngineParameters, M. Segata, 2015). "
            "Delay 0.2 s: Ploeg et al. (IEEE ITSC 2011), identified on a passenger car. "
            "Time gap 0.8 s: the least that ISO 15622 allows"
        ),
        plant=plant,
        gains=gains,
        laws=comparison_laws(plant, gains, mean, modes=modes),
        signal=signal,
        x0=np.array([1.0, -0.5, 0.0]),
        horizon=10.0,
        signals=SignalClass(1.0),
        mean_sojourn=2.0,
        states=("spacing error (m)", "relative speed (m/s)", "acceleration (m/s²)"),
        modes=modes,
        notes=(
            note,
            "Which lag belongs to which actuator, unit actuator gains, the poles −1.5, −2, "
            "−2.5 and a dwell time of 1 s are modelling choices of ours; on the road the "
            "mode depends on the state.",
        ),
    )


NAMED: Mapping[str, Callable[[], Problem]] = {
    "paper": paper,
    "three-mode": three_mode,
    "follower": follower,
}


def is_named(place: Path) -> bool:
    """Whether a path is the name of a problem rather than a file.

    Raises
    ------
    ArgumentError
        If it is neither; the message has the nearest name.

    Examples
    --------
    >>> is_named(Path("follower")), is_named(Path("mine.toml"))
    (True, False)
    """
    name = str(place)
    if name in NAMED:
        return True
    if not place.suffix and not place.exists():
        near = get_close_matches(name, NAMED, n=1)
        hint = f" Did you mean {near[0]}?" if near else ""
        raise ArgumentError(
            f"problem must be one of {', '.join(NAMED)}, or a file that exists, got {name!r}.{hint}"
        )
    return False


def template(name: str) -> str:
    """The commented file of a named problem, or of another example.

    Examples
    --------
    >>> "[plant]" in template("follower")
    True
    """
    place = files("deadtime.problems").joinpath("files", f"{name}.toml")
    return place.read_text(encoding="utf-8").replace("#   (every kind)\n", in_comments())
