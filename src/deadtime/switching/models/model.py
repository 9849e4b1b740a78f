"""The interface of random models of switching.

Laws and filters use a model as a chain over (mode, age) at the samples of a controller, simulations
as a process that draws signals. Memoryless models in continuous time have a `generator`, too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from deadtime.base.checks import read_only, real_array, require_probabilities, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.base.frozen import Frozen
from deadtime.switching.batch import SignalBatch
from deadtime.switching.signal import SwitchingSignal

if TYPE_CHECKING:
    from deadtime.switching.models.jump_process import Switches


class SampledChain(NamedTuple):
    """A model at samples, as a chain from (i, a) to (i, a + 1) or (j, 0).

    The age a counts samples since the sampled mode last changed; the last column of `hazard` holds
    for all greater ages.

    hazard : (modes, ages), probability that the mode changes by the next sample
    jump : (modes, modes), probability of the next mode then; zeros for a mode that is never left
    within : whether modes may change within periods, and not at samples only
    """

    hazard: Float[np.ndarray, "mode age"]
    jump: Float[np.ndarray, "mode mode"]
    within: bool

    @classmethod
    def of_matrix(cls, P: Float[np.ndarray, "mode mode"], within: bool) -> SampledChain:
        """The chain of transition probabilities P between samples, with a single age."""
        jump = np.maximum(P, 0.0)  # a matrix exponential may leave −1e-17
        np.fill_diagonal(jump, 0.0)
        leave = jump.sum(axis=1, keepdims=True)
        return cls(leave, jump / np.where(leave > 0.0, leave, 1.0), within)


class SwitchingModel(Frozen, ABC):
    """A random model of switching, whose signals are functions of a seed and a number.

    Signals start in a uniformly drawn mode, at the beginning of its sojourn.

    Attributes
    ----------
    generator : (modes, modes) array or None
        Λ of a Markov process in continuous time, rows summing to 0, 1/s; else None.
    """

    generator: Float[np.ndarray, "mode mode"] | None = None

    @property
    @abstractmethod
    def modes(self) -> int:
        """Number of modes."""

    @property
    @abstractmethod
    def transitions(self) -> Bool[np.ndarray, "mode mode"]:
        """Whether a signal may switch from mode i (row) to mode j (column), as `certify` takes it.

        Examples
        --------
        >>> import deadtime as dt
        >>> dt.SemiMarkov(0.3, [[0, 1, 0], [0, 0, 1], [0.5, 0.5, 0]]).transitions.astype(int)
        array([[0, 1, 0],
               [0, 0, 1],
               [1, 1, 0]])
        """

    @property
    @abstractmethod
    def mean(self) -> Float[np.ndarray, " mode"]:
        """Mean sojourn in each mode, seconds; infinite for a mode that is never left."""

    @property
    def in_words(self) -> str:
        """The sojourns in words."""
        return f"mean sojourns {', '.join(f'{mean:.3g}' for mean in self.mean)} s"

    @abstractmethod
    def ages(self, step: float, most: int | None = None) -> int | None:
        """Number of ages, in samples, with different hazards; None for a memoryless model.

        Parameters
        ----------
        step : float
            Sampling period h, seconds.
        most : int, optional
            Upper limit of the number, at least 1; at the limit, later ages may still differ.

        Raises
        ------
        ArgumentError
            If the model cannot be sampled at this period.
        """

    @abstractmethod
    def chain(self, step: float, ages: int = 1) -> SampledChain:
        """The model at samples, with so many ages; a memoryless model has one.

        Raises
        ------
        ArgumentError
            If the model cannot be sampled at this period.
        """

    def at_samples(self, step: float) -> bool:
        """Whether its modes change at multiples of `step` seconds only.

        Examples
        --------
        >>> import deadtime as dt
        >>> chain = dt.MarkovChain([[0.9, 0.1], [0.25, 0.75]], step=0.1)
        >>> chain.at_samples(0.05), chain.at_samples(0.2)
        (True, False)
        """
        return False

    @abstractmethod
    def switches(self, horizon: float, seed: int = 0, first: int = 0, count: int = 1) -> Switches:
        """The sojourns of the signals first, …, first + count − 1 of a seed, see `draw`."""

    @abstractmethod
    def section(self) -> str:
        """The model as the [switching] section of a problem file."""

    @final
    def sample(self, horizon: float, seed: int = 0) -> SwitchingSignal:
        """A signal on [0, horizon): number 0 of `draw`.

        With the same seed a longer horizon continues the same signal.

        Raises
        ------
        ArgumentError
            If the horizon is not positive, the seed is negative, or there would be too many
            switches.
        """
        return self.draw(horizon, seed)[0]

    @final
    def draw(self, horizon: float, seed: int = 0, first: int = 0, count: int = 1) -> SignalBatch:
        """The signals of scenarios first, …, first + count − 1 on [0, horizon), in one batch.

        The signal of a scenario depends on the model, `seed` and its number only; a longer horizon
        continues it.

        Parameters
        ----------
        horizon : float
            End of the signals, seconds.
        seed : int
            At least 0.
        first, count : int
            Number of the first scenario, at least 0, and number of scenarios, at least 1.

        Raises
        ------
        ArgumentError
            If the horizon is not positive, an integer is out of its range, or the batch would
            hold too many switches.

        Examples
        --------
        >>> import deadtime as dt
        >>> model = dt.Markov([[0.0, 2.0], [1.0, 0.0]])
        >>> batch = model.draw(10.0, seed=1, count=1000)
        >>> (batch[700].times == model.draw(10.0, seed=1, first=700)[0].times).all()
        np.True_
        """
        drawn = self.switches(horizon, seed, first, count)
        ends, ages = np.full(count, float(horizon)), np.zeros(count)
        # Read-only, so that the batch does not copy them.
        return SignalBatch(*map(read_only, (*drawn, ends, ages)))


def require_model(model: object, modes: int) -> None:
    """Refuse a value that is no switching model of so many modes."""
    if not isinstance(model, SwitchingModel):
        raise ArgumentError(
            "model must be a switching model, such as Markov or SemiMarkov, got "
            f"{type(model).__name__}."
        )
    if model.modes != modes:
        raise ArgumentError(
            f"model must have the plant's {modes} modes, got {model.modes}: give it one sojourn "
            "and one row of transition (or rates) per mode."
        )


def check_probabilities(name: str, value: ArrayLike) -> Float[np.ndarray, "mode mode"]:
    """Probabilities from mode (row) to mode (column), rows summing to 1."""
    table = real_array(name, value, "(modes, modes)", 2)
    require_shape(name, table, (len(table), len(table)), "(modes, modes)")
    for i, row in enumerate(table):
        require_probabilities(f"{name}[{i}]", row)
    return table


def rows_text(name: str, table: Float[np.ndarray, "row column"]) -> str:
    """A matrix as a key of a problem file, a row per line."""
    rows = "".join(f"  [{', '.join(map(repr, row))}],\n" for row in table.tolist())
    return f"{name} = [\n{rows}]"
