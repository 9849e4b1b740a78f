"""Where the scenarios' signals come from: the same for every law, engine, block and order."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt64

from deadtime.base.errors import ArgumentError
from deadtime.numerics.streams import WORDS, key_of
from deadtime.switching import SignalBatch, SwitchingModel, SwitchingSignal


@runtime_checkable
class SignalSampler(Protocol):
    """Anything that draws switching signals."""

    def sample(self, horizon: float, seed: int = 0) -> SwitchingSignal:
        """A signal that is known up to the horizon; the same seed gives the same signal."""
        ...


def scenario_seed(seed: int, scenario: int) -> int:
    """The seed of one scenario's signal, a function of `seed` and the scenario's number only.

    It is a word of Philox with the key of the seed, so scenarios are independent of each other, of
    how many there are and of the order in which they run.

    Examples
    --------
    >>> scenario_seed(0, 3) == scenario_seed(0, 3), scenario_seed(0, 3) == scenario_seed(3, 0)
    (True, False)
    """
    return int(scenario_seeds(seed, scenario, 1)[0])


def scenario_seeds(seed: int, first: int, count: int) -> UInt64[np.ndarray, " scenario"]:
    """Those of the scenarios first, …, first + count − 1, a word each, four to a block."""
    block, before = divmod(first, WORDS)
    return np.random.Philox(key=key_of(seed), counter=block).random_raw(before + count)[before:]


class Source(ABC):
    """Signals by the number of their scenario."""

    @abstractmethod
    def batch(self, first: int, count: int) -> SignalBatch:
        """The signals of scenarios first, …, first + count − 1."""


class GivenSignals(Source):
    """A list of signals."""

    def __init__(self, signals: SignalBatch) -> None:
        self._signals = signals

    def batch(self, first: int, count: int) -> SignalBatch:
        return self._signals.slice(first, first + count)


class DrawnSignals(Source):
    """A switching model, which draws whole batches."""

    def __init__(self, model: SwitchingModel, seed: int, reach: float, modes: int) -> None:
        self._model, self._seed, self._reach, self._modes = model, seed, reach, modes

    def batch(self, first: int, count: int) -> SignalBatch:
        drawn = self._model.draw(self._reach, self._seed, first, count)
        return drawn.require_modes(self._modes)


class Sampled(Source):
    """Any model, asked for one signal at a time, with `scenario_seed`."""

    def __init__(self, model: SignalSampler, seed: int, reach: float, modes: int) -> None:
        self._model, self._seed, self._reach, self._modes = model, seed, reach, modes

    def batch(self, first: int, count: int) -> SignalBatch:
        return SignalBatch.of([self._signal(first + i) for i in range(count)])

    def _signal(self, scenario: int) -> SwitchingSignal:
        reach = self._reach
        signal = self._model.sample(reach, seed=scenario_seed(self._seed, scenario))
        if not isinstance(signal, SwitchingSignal):
            raise ArgumentError(
                "model.sample(horizon, seed) must return a SwitchingSignal, got "
                f"{type(signal).__name__}."
            )
        if signal.end < reach * (1.0 - 1e-12):
            raise ArgumentError(
                f"model.sample(horizon={reach:g}) must return a signal known up to its horizon, "
                f"got one that ends at {signal.end:g} s."
            )
        return signal.require_modes(self._modes)


def source_of(
    model: object, scenarios: int, seed: int, reach: float, modes: int
) -> tuple[Source, int]:
    """Where signals come from, and the number of scenarios.

    A model is asked for signals up to `reach`; a list is taken as it is.
    """
    if isinstance(model, SwitchingSignal):
        raise ArgumentError(
            f"model must be a switching model or a list of signals, got {model!r}: "
            "for one signal, write [signal]."
        )
    if isinstance(model, SignalBatch):
        return GivenSignals(model.require_modes(modes)), len(model)
    if isinstance(model, Sequence):
        given = _check_list(model, modes)
        return GivenSignals(SignalBatch.of(given)), len(given)
    if isinstance(model, type) or not isinstance(model, SignalSampler):
        raise ArgumentError(
            "model must have a method sample(horizon, seed) that returns a SwitchingSignal, or "
            f"be a list of signals, got {type(model).__name__}."
        )
    if isinstance(model, SwitchingModel):
        return DrawnSignals(model, seed, reach, modes), scenarios
    return Sampled(model, seed, reach, modes), scenarios


def draw_signals(
    model: SignalSampler, horizon: float, seed: int = 0, first: int = 0, count: int = 1
) -> SignalBatch:
    """The signals that `monte_carlo` runs on scenarios first, …, first + count − 1.

    Parameters
    ----------
    model : switching model
    horizon : float
        How far they reach, seconds; those of `monte_carlo` reach its horizon plus the longest
        delay, and longer ones continue shorter ones.
    seed : int
        That of `monte_carlo`.
    first, count : int
        Which scenarios.

    Examples
    --------
    >>> from deadtime import Markov
    >>> batch = draw_signals(Markov([[0, 2], [2, 0]]), 5.0, seed=1, first=10, count=3)
    >>> len(batch), float(batch.end[0])
    (3, 5.0)
    """
    source, _ = source_of(model, first + count, seed, horizon, 2**31)
    return source.batch(first, count)


def _check_list(signals: Sequence[object], modes: int) -> list[SwitchingSignal]:
    """The signals of a list, when it holds nothing else and is not empty."""
    if not signals:
        raise ArgumentError("model must hold at least one signal, got an empty list.")
    checked = []
    for i, signal in enumerate(signals):
        if not isinstance(signal, SwitchingSignal):
            raise ArgumentError(
                f"model[{i}] must be a SwitchingSignal, got {type(signal).__name__}."
            )
        try:
            checked.append(signal.require_modes(modes))
        except ArgumentError as error:
            raise ArgumentError(f"model[{i}]: {error}") from None
    return checked
