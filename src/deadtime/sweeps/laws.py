"""The laws that a study can name, and what each of them knows about the switching."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from deadtime.errors import ArgumentError
from deadtime.laws import (
    AveragedPredictor,
    DelayedStateFeedback,
    ExactPredictor,
    ExpectedPredictor,
    Law,
    MeanPredictor,
    OptimalPredictor,
    SingleModePredictor,
)
from deadtime.plant import SwitchedSystem
from deadtime.switching import Markov, SemiMarkov

ORACLE, AWARE = "oracle", ", dwell-aware"
COARSE = 20  # sampling periods per delay at which minimax laws are sought
INPUT_WEIGHT = 1e-3  # of ∫|u|² beside ∫|x|² in what the optimal law minimises
# What a law may know of the switching, each level including those before it.
LEVELS = ("nothing", "the dwell time", "the distribution", "the future")


@dataclass(frozen=True, eq=False)
class Setting:
    """What a law of one cell is made from: the cell's plant, its gains, and its switching."""

    plant: SwitchedSystem
    gains: Float[np.ndarray, "mode m n"]
    mean_gain: Float[np.ndarray, "m n"]
    model: Markov | SemiMarkov
    dwell_time: float | None
    step: float

    def told(self) -> float:
        """τ_d, for laws that are told it."""
        if self.dwell_time is None:
            raise ArgumentError("a dwell-aware law is told τ_d: give grid.dwell_time.")
        return self.dwell_time


@dataclass(frozen=True)
class Kind:
    """How a law is made, and its entry in `LEVELS`."""

    knows: str
    make: Callable[[Setting], Law]


def _minimax(setting: Setting, common_gain: bool) -> Law:
    """The law found at a coarse period, where that costs a second or less."""
    plant = setting.plant
    period = max(setting.step, plant.delay / COARSE)
    arrays = (_frozen(plant.A), _frozen(plant.B), _frozen(setting.gains))
    return _found_minimax(*arrays, plant.delay, period, common_gain)


def _frozen(array: np.ndarray) -> tuple:
    """An array of three dimensions as something that can be looked up."""
    return tuple(tuple(map(tuple, matrix)) for matrix in array.tolist())


@lru_cache(maxsize=64)
def _found_minimax(
    A: tuple, B: tuple, gains: tuple, delay: float, step: float, common_gain: bool
) -> Law:
    """The same for all cells with this plant: it depends on no switching."""
    plant = SwitchedSystem(np.array(A), np.array(B), delay)
    return AveragedPredictor.minimax(plant, np.array(gains), step, common_gain=common_gain)


def _optimal(setting: Setting) -> Law:
    n, m = setting.plant.states, setting.plant.inputs
    return OptimalPredictor(setting.plant, setting.model, np.eye(n), INPUT_WEIGHT * np.eye(m))


KINDS: Mapping[str, Kind] = {
    "averaged": Kind("nothing", lambda s: AveragedPredictor(s.plant, s.gains)),
    "mean": Kind("nothing", lambda s: MeanPredictor(s.plant, s.mean_gain, s.gains)),
    "delay ignored": Kind("nothing", lambda s: DelayedStateFeedback(s.plant, s.gains)),
    "averaged, minimax": Kind("nothing", lambda s: _minimax(s, common_gain=False)),
    "averaged, one-gain minimax": Kind("nothing", lambda s: _minimax(s, common_gain=True)),
    "averaged, dwell-aware": Kind(
        "the dwell time", lambda s: AveragedPredictor(s.plant, s.gains, None, s.told())
    ),
    "mean, dwell-aware": Kind(
        "the dwell time", lambda s: MeanPredictor(s.plant, s.mean_gain, s.gains, s.told())
    ),
    "expected": Kind("the distribution", lambda s: ExpectedPredictor(s.plant, s.gains, s.model)),
    "optimal": Kind("the distribution", _optimal),
    ORACLE: Kind("the future", lambda s: ExactPredictor(s.plant, s.gains)),
}
DEFAULT = ("averaged", "mean", "averaged, dwell-aware", "mean, dwell-aware", "expected", ORACLE)


def kinds_of(modes: int) -> dict[str, Kind]:
    """The laws by name for a plant with so many modes, the single-mode ones among them.

    Examples
    --------
    >>> [name for name in kinds_of(2) if name.endswith("only")]
    ['mode 0 only', 'mode 1 only']
    """

    def only(mode: int) -> Kind:
        return Kind("nothing", lambda s: SingleModePredictor(s.plant, s.gains, mode))

    return {**KINDS, **{f"mode {mode} only": only(mode) for mode in range(modes)}}


def within(laws: Sequence[str], knows: str) -> list[str]:
    """Those of the named laws that know no more than one of `LEVELS`, in their order.

    Examples
    --------
    >>> within(("averaged", "expected", "mode 0 only"), "the dwell time")
    ['averaged', 'mode 0 only']
    """
    most = LEVELS.index(knows)
    return [law for law in laws if LEVELS.index(knowledge_of(law)) <= most]


def knowledge_of(law: str) -> str:
    """What a named law knows of the switching, one of `LEVELS`."""
    return KINDS[law].knows if law in KINDS else "nothing"
