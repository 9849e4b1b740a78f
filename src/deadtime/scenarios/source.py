"""Signals and seeds of scenarios: the same for every law, engine, block and order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt64

from deadtime.base.errors import ArgumentError
from deadtime.numerics.streams import WORDS, key_of
from deadtime.switching import SignalBatch, SwitchingModel, SwitchingSignal


@runtime_checkable
class SignalSampler(Protocol):
    """An object that draws switching signals."""

    def sample(self, horizon: float, seed: int = 0) -> SwitchingSignal:
        """A signal known up to the horizon; the same seed gives the same signal."""
        ...


def scenario_seed(seed: int, scenario: int) -> int:
    """The seed of one scenario's signal, a function of `seed` and the scenario's number only.

    It is a word of Philox with the key of the seed, so that scenarios are independent of each
    other, of their number and of the order in which they run.

    Examples
    --------
    >>> scenario_seed(0, 3) == scenario_seed(0, 3), scenario_seed(0, 3) == scenario_seed(3, 0)
    (True, False)
    """
    return int(scenario_seeds(seed, scenario, 1)[0])


def scenario_seeds(seed: int, first: int, count: int) -> UInt64[np.ndarray, " scenario"]:
    """The seeds of scenarios first, …, first + count − 1: Philox's words, four to a block."""
    block, before = divmod(first, WORDS)
    return np.random.Philox(key=key_of(seed), counter=block).random_raw(before + count)[before:]


Source = Callable[[int, int], SignalBatch]  # the signals of scenarios first, …, first + count − 1


def source_of(
    model: object, scenarios: int, seed: int, reach: float, modes: int
) -> tuple[Source, int]:
    """The source of signals, and the number of scenarios.

    A model draws signals up to `reach`; a list is used as given.
    """
    if isinstance(model, SwitchingSignal):
        raise ArgumentError(
            f"model must be a switching model or a list of signals, got {model!r}: "
            "for one signal, write [signal]."
        )
    if isinstance(model, SignalBatch):
        return _given(model.require_modes(modes)), len(model)
    if isinstance(model, Sequence):
        signals = SignalBatch.of(_check_list(model, modes))
        return _given(signals), len(signals)
    if isinstance(model, type) or not isinstance(model, SignalSampler):
        raise ArgumentError(
            "model must have a method sample(horizon, seed) that returns a SwitchingSignal, or "
            f"be a list of signals, got {type(model).__name__}."
        )

    def draw(first: int, count: int) -> SignalBatch:
        if isinstance(model, SwitchingModel):
            return model.draw(reach, seed, first, count).require_modes(modes)
        return SignalBatch.of([_sample(model, reach, s, modes) for s in seeds(first, count)])

    def seeds(first: int, count: int) -> list[int]:
        return scenario_seeds(seed, first, count).tolist()

    return draw, scenarios


def _given(signals: SignalBatch) -> Source:
    return lambda first, count: signals.slice(first, first + count)


def _sample(model: SignalSampler, reach: float, seed: int, modes: int) -> SwitchingSignal:
    """One signal of any model, checked."""
    signal = model.sample(reach, seed=seed)
    if not isinstance(signal, SwitchingSignal):
        raise ArgumentError(
            "model.sample(horizon, seed) must return a SwitchingSignal, got "
            f"{type(signal).__name__}."
        )
    # A sampler that adds up sojourns may end a rounding early.
    if signal.end < reach * (1.0 - 1e-12):
        raise ArgumentError(
            f"model.sample(horizon={reach:g}) must return a signal known up to its horizon, "
            f"got one that ends at {signal.end:g} s."
        )
    return signal.require_modes(modes)


def draw_signals(
    model: SignalSampler, horizon: float, seed: int = 0, first: int = 0, count: int = 1
) -> SignalBatch:
    """The signals that `monte_carlo` runs on scenarios first, …, first + count − 1.

    Parameters
    ----------
    model : switching model
    horizon : float
        Their length, seconds; those of `monte_carlo` reach its horizon plus the longest delay, and
        longer signals continue shorter ones.
    seed : int
        That of `monte_carlo`.
    first, count : int
        The first scenario, and the number of scenarios.

    Examples
    --------
    >>> from deadtime import Markov
    >>> batch = draw_signals(Markov([[0, 2], [2, 0]]), 5.0, seed=1, first=10, count=3)
    >>> len(batch), float(batch.end[0])
    (3, 5.0)
    """
    source, _ = source_of(model, first + count, seed, horizon, 2**31)
    return source(first, count)


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
