"""Signals, classes of signals and rules from the sections of a problem file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.plant import SwitchedSystem
from deadtime.problems.file import schema
from deadtime.problems.switching_registry.entry import Promise
from deadtime.switching import (
    HalfSpace,
    Polyhedra,
    QuadraticRegions,
    Rule,
    SignalClass,
    SwitchingModel,
    SwitchingSignal,
)
from deadtime.switching.signal_class import Instants


def promise_of(
    file: schema.ProblemFile, model: SwitchingModel | None, modes: int, step: float | None = None
) -> SignalClass:
    """The class of signals that a file states: in [signal] or else in [switching].

    Modes change as in [signal], or at samples if it is drawn from a Markov chain whose period is a
    multiple of `step`.
    """
    signal, chatter = file.signal, 1
    stated: Promise = getattr(signal, "dwell_time", None), None, None
    if isinstance(signal, schema.RandomSignal):
        stated = signal.dwell_time, signal.maximum_dwell, signal.transitions
        if signal.average_dwell_time is not None:
            stated, chatter = (signal.average_dwell_time, *stated[1:]), signal.chatter
    if all(one is None for one in stated) and file.switching is not None and model is not None:
        stated = file.switching.promise(model)
    at: Instants = getattr(signal, "at", "anywhere")
    if isinstance(signal, schema.ModelSignal) and model is not None and step is not None:
        at = "samples" if model.at_samples(step) else "anywhere"
    signals = SignalClass(*stated, at, chatter=chatter)
    signals.limits(modes)  # refuses values that do not fit the modes
    return signals


def build_rule(section: schema.Signal) -> Rule | None:
    """The rule by which the state switches the mode, or None where a signal does."""
    match section:
        case schema.HalfSpaceSignal():
            return HalfSpace(section.normal, section.offset)
        case schema.PolyhedraSignal():
            regions = [(region.H, region.h) for region in section.regions]
            return Polyhedra(regions, [region.mode for region in section.regions])
        case schema.QuadraticSignal():
            return QuadraticRegions(section.S)
        case _:
            return None


def build_signal(
    section: schema.Signal,
    plant: SwitchedSystem,
    end: float,
    folder: Path,
    model: SwitchingModel | None,
    step: float | None,
) -> SwitchingSignal:
    """The switching signal; generated ones reach the end of the oracle's last prediction."""
    if getattr(section, "at", "anywhere") == "samples":
        if step is None:
            raise ArgumentError('at = "samples" must come with a step, got run.step = "ideal".')
        return _at_samples(section, plant, end, folder, step)
    match section:
        case schema.ConstantSignal():
            return SwitchingSignal.constant(section.mode)
        case schema.RandomSignal():
            return _random(section, plant.modes, end)
        case schema.ModelSignal():
            if model is None:
                raise ArgumentError('kind = "model" needs a [switching] section to draw from.')
            return model.sample(end, section.seed)
        case schema.PeriodicSignal():
            signal = SwitchingSignal.periodic(section.sojourns, section.modes, end)
        case schema.SwitchesSignal():
            known = np.inf if section.end is None else section.end
            signal = SwitchingSignal(section.times, section.modes, known)
        case schema.LogSignal():
            signal = SwitchingSignal.from_csv(
                folder / section.file,
                modes=plant.modes,
                labels=section.labels,
                end=section.end,
                unit=section.unit,
            )
        case _:
            raise TypeError(section)  # a rule: see build_rule
    if section.dwell_time is not None:
        signal.require_dwell_time(section.dwell_time)
    return signal


def _random(section: schema.RandomSignal, modes: int, end: float) -> SwitchingSignal:
    return SwitchingSignal.random(modes, end, **section.model_dump(exclude={"kind", "at"}))


def _at_samples(
    section: schema.Signal, plant: SwitchedSystem, end: float, folder: Path, step: float
) -> SwitchingSignal:
    """A signal that switches at samples: drawn sojourns are rounded up, given ones are checked."""
    if not isinstance(section, schema.RandomSignal):
        anywhere = section.model_copy(update={"at": "anywhere"})
        signal = build_signal(anywhere, plant, end, folder, None, step)
        off = np.flatnonzero(np.abs(signal.times / step - np.round(signal.times / step)) > 1e-9)
        if off.size:
            raise ArgumentError(
                f'at = "samples" must hold for every switch, got one at {signal.times[off[0]]:g} s '
                f"with a period of {step:g} s: move it, or leave at out."
            )
        return signal
    least = section.average_dwell_time if section.dwell_time is None else section.dwell_time
    sampled = SignalClass(
        step if least is None else least, section.maximum_dwell, section.transitions, "samples"
    )
    limits = sampled.at_period(plant.modes, step)
    return whole_periods(
        lambda reach: _random(section, plant.modes, reach), limits.maximum_dwell, step, end
    )


def whole_periods(
    draw: Callable[[float], SwitchingSignal], longest: Sequence[float], step: float, end: float
) -> SwitchingSignal:
    """A drawn signal, its sojourns rounded up to whole periods, at most to the longest allowed.

    `draw` takes the end of the signal, seconds; `longest` has an entry per mode.
    """
    drawn = draw(2.0 * end)  # no sojourn is cut to less than half
    most = np.floor(np.array(longest) / step + 1e-9)[drawn.modes[:-1]]
    counts = np.minimum(np.ceil(np.diff(drawn.times) / step - 1e-9), most)  # 1e-9: round-off
    times = step * np.append(0.0, np.cumsum(counts))
    return SwitchingSignal(times[times < end], drawn.modes[times < end], end)


@dataclass(frozen=True, eq=False)
class WholePeriods:
    """Signals of a model at samples: sojourns of `whole_periods`, one signal at a time."""

    model: SwitchingModel
    longest: tuple[float, ...]
    step: float

    def sample(self, horizon: float, seed: int = 0) -> SwitchingSignal:
        return whole_periods(
            lambda reach: self.model.sample(reach, seed), self.longest, self.step, horizon
        )


def drawn_as(
    model: SwitchingModel, signals: SignalClass, step: float
) -> SwitchingModel | WholePeriods:
    """The source of a model's signals for runs at a period, at samples only if `signals` are.

    Raises
    ------
    ArgumentError
        If some mode has no sojourn of whole periods within its limits.
    """
    if signals.at == "anywhere" or model.at_samples(step):
        return model
    limits = signals.at_period(model.modes, step)
    return WholePeriods(model, limits.maximum_dwell, step)
