"""A complete setting: plant, laws, signal and run, with names and sources."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.base.wording import input_names, numbered, with_names
from deadtime.feedback import Law
from deadtime.imperfections import Imperfection
from deadtime.laws import ExactPredictor
from deadtime.plant import OperatingPoint, SwitchedSystem, Weight
from deadtime.plant.plant_set import PlantUncertainty
from deadtime.simulation import Trajectory, simulate
from deadtime.switching import Rule, SignalClass, SwitchingModel, SwitchingSignal
from deadtime.switching.constraint import SwitchingConstraint


@dataclass(frozen=True, eq=False)
class Published(Frozen):
    """A number as a source prints it, beside ours."""

    name: str
    printed: np.ndarray
    computed: np.ndarray


@dataclass(frozen=True, eq=False)
class Problem(Frozen):
    """A complete setting: the arguments of `simulate`, with names and sources (immutable).

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
        Laws by short names, in the order of figures; the first is the one the problem is about.
    states, modes, inputs : tuple of str
        Names of states and inputs (with units) and of the modes, for figures; numbered by default.
    outputs, tracked : tuple of str
        Names of the measured outputs, and of the outputs that follow a reference.
    notes : tuple of str
        Notes on choices that the source leaves open.
    published : tuple of Published
        Printed numbers that the report checks.
    constants : mapping
        Printed values of the theorem's constants, by the names of `constants_table`.
    signals : SignalClass
        The signals that certificates cover; without a dwell time they take the shortest sojourn of
        `signal`.
    mean_sojourn : float or None
        Mean sojourn of the signals that Monte Carlo draws, seconds; None: not stated.
    switching : switching model or None
        Model of the switching, from which Monte Carlo draws; None: not stated.
    model : SwitchedSystem or None
        The plant that gains and laws are designed for, where `plant`, the true one, differs.
    imperfections, seed, predict
        As `simulate` takes them.
    weight : Weight or None
        Weights of the cost that compares its laws; None: the identity.
    uncertain : UncertainPlant or None
        Uncertainty of the plant that laws are designed for; None: not stated.
    operating_point : OperatingPoint or None
        Equilibrium from which states and inputs are deviations; None: 0, or not stated.
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
    outputs: tuple[str, ...] = ()
    tracked: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    published: tuple[Published, ...] = ()
    constants: Mapping[str, float] = field(default_factory=dict)
    signals: SignalClass = field(default_factory=SignalClass)
    mean_sojourn: float | None = None
    switching: SwitchingModel | None = None
    model: SwitchedSystem | None = None
    imperfections: tuple[Imperfection, ...] = ()
    seed: int = 0
    predict: str = "applied"
    weight: Weight | None = None
    uncertain: PlantUncertainty | None = None
    operating_point: OperatingPoint | None = None

    @property
    def limits(self) -> SwitchingConstraint:
        """The limits of sojourns and transitions of its signals."""
        return self.signals.limits(self.plant.modes)

    @property
    def dwell_time(self) -> float | None:
        """The shortest dwell time of a mode, seconds; None if at most an average is stated."""
        return (min(self.limits.dwell_time) or None) if self.signals.chatter == 1 else None

    @property
    def operating_sentences(self) -> tuple[str, ...]:
        """A sentence on the operating point, if there is one."""
        if self.operating_point is None:
            return ()
        where = self.operating_point.in_words(self.states, self.inputs)
        return (f"States and inputs are deviations from the operating point: {where}.",)

    @property
    def curve_names(self) -> tuple[list[str], list[str]]:
        """Axis labels of states and inputs, with the operating point."""
        point = self.operating_point
        if point is None:
            return list(self.states), list(self.inputs)
        pairs = ((self.states, point.x), (self.inputs, point.u))
        states, inputs = (
            [f"{name}, deviation from {value:.4g}" for name, value in zip(*pair, strict=True)]
            for pair in pairs
        )
        return states, inputs

    def __post_init__(self) -> None:
        for key, names in (
            ("states", numbered("x", self.plant.states)),
            ("modes", tuple(f"mode {i}" for i in range(self.plant.modes))),
            ("inputs", input_names(self.plant.inputs)),
        ):
            object.__setattr__(self, key, getattr(self, key) or names)
        super().__post_init__()

    @property
    def given_signal(self) -> SwitchingSignal:
        """The switching signal, if it is known before the run; an error for a rule."""
        if not isinstance(self.signal, SwitchingSignal):
            raise ArgumentError(
                f"signal of the problem {self.name!r} is not known in advance: its state decides "
                "the mode."
            )
        return self.signal

    @property
    def imperfections_in_words(self) -> list[str]:
        """Each imperfection in words, with the names of modes, for headings and sentences.

        Examples
        --------
        >>> import dataclasses, deadtime as dt
        >>> noise = dt.imperfections.Noise(0.1)
        >>> problem = dataclasses.replace(dt.problems.paper(), imperfections=(noise,))
        >>> problem.imperfections_in_words
        ['noise (std 0.1)']
        """
        return [with_names(each.in_words, self.modes) for each in self.imperfections]

    @property
    def observer_alone_reads_mode(self) -> tuple[str, ...]:
        """Names of the laws whose observer reads the mode, while their tables do not."""
        return tuple(name for name, law in self.laws.items() if law.observer_alone_reads_mode)

    def simulate(self, law: str | Law, signal: SwitchingSignal | None = None) -> Trajectory:
        """Run a law, one of the problem's by its name or any other, on its signal or on another.

        Examples
        --------
        >>> import deadtime as dt
        >>> problem = dt.problems.paper()
        >>> problem.simulate("oracle").diverged
        False
        >>> law = dt.AveragedPredictor(problem.plant, problem.gains, [0.3, 0.7])
        >>> problem.simulate(law).diverged
        False
        """
        return self.run(law if isinstance(law, Law) else self.law(law), signal)

    def law(self, name: str) -> Law:
        """One of the problem's laws, by its name."""
        if name not in self.laws:
            raise ArgumentError(
                f"law must be one of {', '.join(self.laws)}, got {name!r}.{self._of_kind(name)}"
            )
        return self.laws[name]

    def _of_kind(self, kind: str) -> str:
        """A hint if the name is a kind of law in problem files, as exact for the oracle."""
        from deadtime.problems.law_registry import LAWS, name_of

        names = {name for name, known in LAWS.items() if known.kind == kind}
        called = [name for name, law in self.laws.items() if name_of(law) in names]
        return f" The law of kind {kind!r} has the name {called[0]!r}." if called else ""

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
        """Run the first law in a constant mode without imperfections, on [0, horizon] s."""
        law = next(iter(self.laws.values()))
        if self.step is None and not law.is_linear and law.observer is None:
            # Its ideal loop needs the rule; in a constant mode it predicts as the oracle does.
            assert law.gains is not None
            law = ExactPredictor(law.plant, law.gains, allow_unstable=True)
        signal = SwitchingSignal.constant(mode)
        return simulate(self.plant, law, signal, self.x0, horizon, self.step, self._history())

    def _history(self) -> np.ndarray:
        """u0 as (m,)."""
        return np.broadcast_to(np.asarray(self.u0, dtype=np.float64), (self.plant.inputs,))
