"""The switching model of logged modes."""

from __future__ import annotations

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.identification.log.recording import Recording
from deadtime.switching import SwitchingSignal
from deadtime.switching.models.semi_markov import SemiMarkov


def signals_of(recording: Recording) -> list[SwitchingSignal]:
    """The logged modes of every log as a signal from its first row on.

    A mode that begins in the last row, before rows that were lost, lasts that row's period.
    """
    signals = []
    for part in recording.parts:
        first = np.flatnonzero(np.diff(part.mode, prepend=-1))
        time = part.time - part.time[0]
        end = max(float(time[-1]), float(time[first[-1]]) + recording.step)
        signals.append(SwitchingSignal(time[first], part.mode[first], end=end))
    return signals


def fit_switching(recording: Recording) -> tuple[SemiMarkov | None, str]:
    """The model of how the mode switches, and why there is none where there is none."""
    if len(recording.modes) < 2:
        return None, ""
    try:
        signals = signals_of(recording)
        return SemiMarkov.fit(signals, modes=len(recording.modes), first="drop"), ""
    except ArgumentError as error:
        return None, f"There is no switching model: {error}"
