"""From a checked problem file to a problem: plant, gains, laws and signal are built here."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from deadtime.checks import positive, real_array, shaped
from deadtime.errors import ArgumentError
from deadtime.gains import lqr, place
from deadtime.laws import (
    AveragedPredictor,
    DelayedStateFeedback,
    ExactPredictor,
    Law,
    MeanPredictor,
    SingleModePredictor,
)
from deadtime.laws.base import checked_gains
from deadtime.plant import SwitchedSystem
from deadtime.problem_file import schema
from deadtime.problems import Problem, comparison_laws
from deadtime.switching import SwitchingSignal


class SectionError(ArgumentError):
    """Something is wrong in one section of the file; `path` says where."""

    def __init__(self, message: str, path: tuple) -> None:
        super().__init__(message)
        self.path = path


@contextmanager
def _section(*path: str | int) -> Iterator[None]:
    try:
        yield
    except ArgumentError as error:
        raise SectionError(str(error), path) from None


def build_problem(file: schema.ProblemFile, source: Path) -> Problem:
    """The problem that a checked file describes; relative paths start at the file's folder."""
    with _section("plant"):
        plant = SwitchedSystem(file.plant.A, file.plant.B, file.plant.delay)
        states = _names("states", file.plant.states, plant.states)
        modes = _names("modes", file.plant.modes, plant.modes)
    with _section("gains"):
        gains = _gains(plant, file.gains)
    laws: dict[str, Law] = {}
    for i, section in enumerate(file.law):
        with _section("law", i):
            law = _law(plant, gains, file, section)
            name = section.name or law.label
            if name in laws:
                raise ArgumentError(f"name {name!r} is used twice: give the law another name.")
            laws[name] = law
    if not laws:
        with _section("gains"):
            allow = file.gains.allow_unstable
            mean = _mean_law(plant, gains, file, None, allow) if plant.modes > 1 else None
            laws = comparison_laws(plant, gains, mean, allow)
    with _section("run"):
        run = file.run
        x0 = shaped("x0", real_array("x0", run.x0, "(n,)", 1), (plant.states,), "(n,)")
        u0 = real_array("u0", np.atleast_1d(run.u0), "(m,)", 1)
        if u0.size != 1:
            shaped("u0", u0, (plant.inputs,), "(m,)")
        horizon = positive("horizon", run.horizon)
        step = None if run.step == "ideal" else positive("step", run.step)
    with _section("signal"):
        longest = max(plant.delay, *(law.plant.delay for law in laws.values()))
        signal = _signal(file.signal, plant, horizon + longest + (step or 0.0), source)
        signal.require_modes(plant.modes)
    return Problem(
        name=source.stem,
        title=file.title or source.stem,
        source=file.source,
        plant=plant,
        gains=gains,
        laws=laws,
        signal=signal,
        x0=x0,
        horizon=horizon,
        step=step,
        u0=u0,
        states=states,
        modes=modes,
    )


def _names(what: str, names: list[str], count: int) -> tuple[str, ...]:
    if names and len(names) != count:
        raise ArgumentError(f"{what} must name all {count}, got {len(names)} names.")
    return tuple(names)


def _gains(plant: SwitchedSystem, section: schema.GainsSection) -> np.ndarray:
    """K as given, or designed for this plant."""
    if section.K is not None:
        return checked_gains(plant, section.K, section.allow_unstable)
    if section.poles is not None:
        gains = place(plant, _numbers(section.poles))
        return checked_gains(plant, gains, section.allow_unstable)
    assert section.lqr is not None
    return lqr(plant, section.lqr.Q, section.lqr.R)


def _numbers(poles: list) -> list:
    """Poles as numbers; text such as "-1+2j" is a complex one."""
    if poles and isinstance(poles[0], list):
        return [_numbers(row) for row in poles]
    try:
        return [complex(pole) for pole in poles]
    except ValueError:
        raise ArgumentError(
            f'poles must be numbers, or text such as "-1+2j", got {poles}.'
        ) from None


def _law(
    plant: SwitchedSystem, gains: np.ndarray, file: schema.ProblemFile, section: schema.LawSection
) -> Law:
    own = section.model
    model = SwitchedSystem(
        plant.A if own.A is None else own.A,
        plant.B if own.B is None else own.B,
        plant.delay if own.delay is None else own.delay,
    )
    allow = file.gains.allow_unstable or own.A is not None or own.B is not None
    match section:
        case schema.AveragedLaw():
            return AveragedPredictor(model, gains, section.weights, allow_unstable=allow)
        case schema.SingleLaw():
            return SingleModePredictor(model, gains, section.mode, allow_unstable=allow)
        case schema.MeanLaw():
            return _mean_law(model, gains, file, section, allow)
        case schema.ExactLaw():
            return ExactPredictor(model, gains, allow_unstable=allow)
        case _:
            return DelayedStateFeedback(model, gains, allow_unstable=allow)


def _mean_law(
    model: SwitchedSystem,
    gains: np.ndarray,
    file: schema.ProblemFile,
    section: schema.MeanLaw | None,
    allow: bool,
) -> MeanPredictor:
    """The mean law; without a gain of its own, one designed for the mean as the others were.

    Where that is not defined (gains given as K, or poles per mode), the mean of the gains.
    """
    A, B = model.mean().A[0], model.mean().B[0]
    if section is not None:
        A = A if section.A is None else np.array(section.A)
        B = B if section.B is None else np.array(section.B)
    if section is not None and section.gain is not None:
        gain = np.array(section.gain)
    elif file.gains.K is not None or isinstance((file.gains.poles or [0])[0], list):
        gain = gains.mean(axis=0)
    else:
        gain = _gains(SwitchedSystem(A[None], B[None], model.delay), file.gains)[0]
    return MeanPredictor(model, gain, gains, mean=(A, B), allow_unstable=allow)


def _signal(
    section: schema.Signal, plant: SwitchedSystem, end: float, source: Path
) -> SwitchingSignal:
    """The switching signal; made ones are long enough for the oracle's last prediction."""
    match section:
        case schema.ConstantSignal():
            return SwitchingSignal.constant(section.mode)
        case schema.RandomSignal():
            return SwitchingSignal.random(plant.modes, end, **section.model_dump(exclude={"kind"}))
        case schema.PeriodicSignal():
            signal = SwitchingSignal.periodic(section.sojourns, section.modes, end)
        case schema.SwitchesSignal():
            known = np.inf if section.end is None else section.end
            signal = SwitchingSignal(section.times, section.modes, known)
        case schema.LogSignal():
            signal = SwitchingSignal.from_csv(
                source.parent / section.file,
                modes=plant.modes,
                labels=section.labels,
                end=section.end,
            )
    if section.dwell_time is not None:
        signal.require_dwell_time(section.dwell_time)
    return signal
