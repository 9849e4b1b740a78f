"""Named plants from the literature, cited, each with gains, laws and a signal ready to run.

    problem = deadtime.problems.paper()
    run = problem.simulate("averaged")

None of the sources publishes its switching signal. Here each is drawn at random with the
source's dwell time, and of the seeds 0 to 200 the one is taken whose ∫|x|² under the averaged
law is the median: neither a lucky signal nor an unlucky one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.base.wording import input_names, subscript
from deadtime.feedback import Law
from deadtime.gains import place
from deadtime.imperfections import Imperfection
from deadtime.laws import (
    AveragedPredictor,
    DelayedStateFeedback,
    ExactPredictor,
    MeanPredictor,
    SingleModePredictor,
    StateDependentPredictor,
)
from deadtime.plant import SwitchedSystem
from deadtime.simulation import Trajectory, simulate
from deadtime.switching import Rule, SwitchingSignal
from deadtime.weight import Weight

_SIGNAL_NOTE = (
    "The source does not publish its switching signal. This one has sojourns of {dwell:g} s plus "
    "an exponential time of mean {rest:g} s, and of 201 such signals (seeds 0 to 200) it is the "
    "one whose ∫|x|² under the averaged law is the median (seed {seed})."
)


@dataclass(frozen=True, eq=False)
class Published(Frozen):
    """A number as a source prints it, beside ours."""

    name: str
    printed: np.ndarray
    computed: np.ndarray


@dataclass(frozen=True, eq=False)
class Problem(Frozen):
    """A complete setting: what `simulate` needs, with names and sources (immutable).

    Attributes
    ----------
    name, title : str
        Short name, and one line for headings.
    source : str
        Where the numbers come from.
    plant, gains, signal, x0, horizon, step
        As `simulate` takes them; `signal` may be a rule by which the state decides the mode.
    u0 : float or array_like, shape (m,)
        Constant input before time 0.
    laws : mapping
        From a short name to a law, in the order of figures; the first is the one the problem
        is about.
    states, modes, inputs : tuple of str
        Names of states and inputs (with units) and of the modes, for figures; numbered by default.
    notes : tuple of str
        What a reader should know about choices that the source leaves open.
    published : tuple of Published
        Printed numbers that the report checks.
    constants : mapping
        Printed values of the theorem's constants, by the names of `constants_table`.
    dwell_time : float or None
        The dwell time that every signal is promised to have, seconds, which certificates ask for;
        None: the shortest sojourn of `signal`.
    mean_sojourn : float or None
        The mean sojourn of its signals, seconds, which Monte Carlo draws; None: it states none.
    model : SwitchedSystem or None
        What gains and laws were made for, where `plant`, the truth, differs from it.
    imperfections, seed, predict
        As `simulate` takes them.
    weight : Weight or None
        Of the cost by which its laws are compared; None: the identity.
    """

    name: str
    title: str
    source: str
    plant: SwitchedSystem
    gains: Float[np.ndarray, "mode m n"]
    laws: Mapping[str, Law]
    signal: SwitchingSignal | Rule
    x0: Float[np.ndarray, " n"]
    horizon: float
    step: float | None = 0.01
    u0: ArrayLike = 0.0
    states: tuple[str, ...] = ()
    modes: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    published: tuple[Published, ...] = ()
    constants: Mapping[str, float] = field(default_factory=dict)
    dwell_time: float | None = None
    mean_sojourn: float | None = None
    model: SwitchedSystem | None = None
    imperfections: tuple[Imperfection, ...] = ()
    seed: int = 0
    predict: str = "applied"
    weight: Weight | None = None

    def __post_init__(self) -> None:
        if not self.states:
            names = tuple(f"x{subscript(i + 1)}" for i in range(self.plant.states))
            object.__setattr__(self, "states", names)
        if not self.modes:
            names = tuple(f"mode {i}" for i in range(self.plant.modes))
            object.__setattr__(self, "modes", names)
        if not self.inputs:
            object.__setattr__(self, "inputs", input_names(self.plant.inputs))
        super().__post_init__()

    @property
    def given_signal(self) -> SwitchingSignal:
        """The switching signal, for what needs one before the run; an error for a rule."""
        if not isinstance(self.signal, SwitchingSignal):
            raise ArgumentError(
                f"signal of the problem {self.name!r} is not known in advance: its state decides "
                "the mode."
            )
        return self.signal

    def simulate(self, law: str, signal: SwitchingSignal | None = None) -> Trajectory:
        """Run one of the problem's laws, on the problem's signal or on another.

        Examples
        --------
        >>> paper().simulate("oracle").diverged
        False
        """
        return self.run(self.law(law), signal)

    def law(self, name: str) -> Law:
        """One of the problem's laws, by its name."""
        if name not in self.laws:
            raise ArgumentError(f"law must be one of {', '.join(self.laws)}, got {name!r}.")
        return self.laws[name]

    def run(self, law: Law, signal: SwitchingSignal | None = None) -> Trajectory:
        """Run any law in the problem's setting."""
        return simulate(
            self.plant,
            law,
            self.signal if signal is None else signal,
            self.x0,
            self.horizon,
            self.step,
            self._history(),
            imperfections=self.imperfections,
            seed=self.seed,
            predict=self.predict,
        )

    def hold(self, mode: int, horizon: float) -> Trajectory:
        """Run the first law in one constant mode, nothing else imperfect, on [0, horizon] s."""
        law = next(iter(self.laws.values()))
        if self.step is None and isinstance(law, StateDependentPredictor):
            # Its ideal loop follows the rule; in a constant mode it predicts what an oracle would.
            law = ExactPredictor(law.plant, law.gains, allow_unstable=True)
        signal = SwitchingSignal.constant(mode)
        return simulate(self.plant, law, signal, self.x0, horizon, self.step, self._history())

    def _history(self) -> np.ndarray:
        """u0 as (m,)."""
        return np.broadcast_to(np.asarray(self.u0, dtype=np.float64), (self.plant.inputs,))


def comparison_laws(
    plant: SwitchedSystem,
    gains: Float[np.ndarray, "mode m n"],
    mean: MeanPredictor | None,
    allow_unstable: bool = False,
) -> dict[str, Law]:
    """The paper's comparison: averaged, each single mode, mean, oracle, and the baseline."""
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
    return {law.label: law for law in laws}


def _signal(modes: int, end: float, dwell: float, mean: float, seed: int) -> tuple:
    """The problem's signal, and the note that says how it was chosen."""
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
    signal, note = _signal(plant.modes, 20.0, dwell=0.2, mean=0.4, seed=184)
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
        dwell_time=0.2,
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
    A is not unique. Its averaged loop, too, is unstable if it stays in mode 0 for ever.

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
    signal, note = _signal(plant.modes, 20.0, dwell=0.9, mean=1.8, seed=115)
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
        dwell_time=0.9,
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
    signal, note = _signal(plant.modes, 15.0, dwell=1.0, mean=2.0, seed=22)
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
        laws=comparison_laws(plant, gains, mean),
        signal=signal,
        x0=np.array([1.0, -0.5, 0.0]),
        horizon=10.0,
        dwell_time=1.0,
        mean_sojourn=2.0,
        states=("spacing error (m)", "relative speed (m/s)", "acceleration (m/s²)"),
        modes=("throttle", "brake"),
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
