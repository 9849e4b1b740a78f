"""The scenarios' signals: the same for every law, whatever the number and order of scenarios."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from deadtime.errors import ArgumentError
from deadtime.switching import SwitchingSignal


@runtime_checkable
class SwitchingModel(Protocol):
    """Anything that draws switching signals."""

    def sample(self, horizon: float, seed: int = 0) -> SwitchingSignal:
        """A signal that is known up to the horizon; the same seed gives the same signal."""
        ...


SignalAt = Callable[[int], SwitchingSignal]


def scenario_seed(seed: int, scenario: int) -> int:
    """The seed of one scenario's signal, a function of `seed` and the scenario's number only.

    It is drawn from `numpy.random.SeedSequence(seed).spawn(…)[scenario]`, so scenarios are
    independent of each other, of how many there are and of the order in which they run.

    Examples
    --------
    >>> scenario_seed(0, 3) == scenario_seed(0, 3), scenario_seed(0, 3) == scenario_seed(3, 0)
    (True, False)
    """
    child = np.random.SeedSequence(seed, spawn_key=(scenario,))
    return int(child.generate_state(1, np.uint64)[0])


def signals_of(
    model: object, scenarios: int, seed: int, reach: float, modes: int
) -> tuple[SignalAt, int]:
    """Scenario → signal, and the number of scenarios.

    A model is asked for signals up to `reach`; a list is taken as it is.
    """
    if isinstance(model, SwitchingSignal):
        raise ArgumentError(
            f"model must be a switching model or a list of signals, got {model!r}: "
            "for one signal, write [signal]."
        )
    if isinstance(model, Sequence):
        given = _checked_list(model, modes)
        return given.__getitem__, len(given)
    if isinstance(model, type) or not isinstance(model, SwitchingModel):
        raise ArgumentError(
            "model must have a method sample(horizon, seed) that returns a SwitchingSignal, or "
            f"be a list of signals, got {type(model).__name__}."
        )

    def drawn(scenario: int) -> SwitchingSignal:
        signal = model.sample(reach, seed=scenario_seed(seed, scenario))
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
        return signal.require_modes(modes)

    return drawn, scenarios


def _checked_list(signals: Sequence[object], modes: int) -> list[SwitchingSignal]:
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
