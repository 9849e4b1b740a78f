"""From a checked problem file to a problem: plant, gains, laws and signal are built here."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deadtime.checks import positive, real_array, shaped
from deadtime.errors import ArgumentError
from deadtime.gains import lqr, place
from deadtime.imperfections import Imperfection, Sizes
from deadtime.laws import (
    AveragedPredictor,
    DelayedStateFeedback,
    ExactPredictor,
    ExpectedPredictor,
    Law,
    LowPassPredictor,
    MeanPredictor,
    OptimalPredictor,
    SingleModePredictor,
    StateDependentPredictor,
)
from deadtime.laws.base import checked_gains
from deadtime.plant import SwitchedSystem
from deadtime.problem_file import schema
from deadtime.problem_file.imperfections import build_imperfections
from deadtime.problem_file.observer import observed
from deadtime.problem_file.switching import Model, build_model, build_rule, build_signal
from deadtime.problems import Problem, comparison_laws
from deadtime.switching import Rule
from deadtime.toml_file import section as _section


def build_problem(file: schema.ProblemFile, source: Path) -> Problem:
    """The problem that a checked file describes; relative paths start at the file's folder."""
    with _section("plant"):
        plant = SwitchedSystem(file.plant.A, file.plant.B, file.plant.delay)
        states = _names("states", file.plant.states, plant.states)
        inputs = _names("inputs", file.plant.inputs, plant.inputs)
        modes = _names("modes", file.plant.modes, plant.modes)
    with _section("gains"):
        gains = _gains(plant, file.gains)
    with _section("switching"):
        model = build_model(file.switching, plant.modes, source.parent)
    with _section("signal"):
        rule = build_rule(file.signal)
        if rule is not None:
            rule.require(plant)
    laws = _laws(_Parts(plant, gains, file, model, rule))
    with _section("run"):
        run = file.run
        x0 = shaped("x0", real_array("x0", run.x0, "(n,)", 1), (plant.states,), "(n,)")
        u0 = real_array("u0", np.atleast_1d(run.u0), "(m,)", 1)
        if u0.size == 1:
            u0 = np.full(plant.inputs, u0[0])
        shaped("u0", u0, (plant.inputs,), "(m,)")
        horizon = positive("horizon", run.horizon)
        step = None if run.step == "ideal" else positive("step", run.step)
    with _section("observer"):
        laws = observed(laws, file.observer, step, as_numbers)
    with _section("truth"):
        truth = _changed(plant, file.truth) if file.truth is not None else plant
    imperfections = _imperfections(file, plant, laws, step)
    with _section("signal"):
        longest = max(truth.delay, *(law.plant.delay for law in laws.values()))
        if rule is None:
            end = horizon + longest + min(step or 0.0, horizon)
            signal = build_signal(file.signal, plant, end, source.parent, model)
            signal.require_modes(plant.modes)
        else:
            signal = rule
    return Problem(
        name=source.stem,
        title=file.title or source.stem,
        source=file.source,
        plant=truth,
        gains=gains,
        laws=laws,
        signal=signal,
        x0=x0,
        horizon=horizon,
        step=step,
        u0=u0,
        model=plant if file.truth is not None else None,
        imperfections=imperfections,
        seed=file.run.seed,
        predict=file.run.predict,
        states=states,
        inputs=inputs,
        modes=modes,
        dwell_time=getattr(file.signal, "dwell_time", None),
        mean_sojourn=getattr(file.signal, "mean_sojourn", None),
    )


def _imperfections(
    file: schema.ProblemFile, plant: SwitchedSystem, laws: dict[str, Law], step: float | None
) -> tuple[Imperfection, ...]:
    """The imperfections of the file, checked against what its laws measure."""
    if not file.imperfection:
        return ()
    if step is None:
        with _section("run"):
            raise ArgumentError(
                'step = "ideal" has no samples, at which imperfections act: give a period.'
            )
    outputs = next(iter(laws.values())).outputs
    measured = None if outputs is None else outputs.shape[1]
    sizes = Sizes(plant.modes, plant.states, plant.inputs, step)
    return build_imperfections(file.imperfection, sizes, measured)


def _names(what: str, names: list[str], count: int) -> tuple[str, ...]:
    if names and len(names) != count:
        raise ArgumentError(f"{what} must name all {count}, got {len(names)} names.")
    return tuple(names)


def _gains(plant: SwitchedSystem, section: schema.GainsSection) -> np.ndarray:
    """K as given, or designed for this plant."""
    if section.K is not None:
        return checked_gains(plant, section.K, section.allow_unstable)
    if section.poles is not None:
        gains = place(plant, as_numbers(section.poles), allow_unstable=section.allow_unstable)
        return checked_gains(plant, gains, section.allow_unstable)
    assert section.lqr is not None
    return lqr(plant, section.lqr.Q, section.lqr.R)


def as_numbers(poles: list) -> list:
    """Poles as numbers; text such as "-1+2j" is a complex one."""
    if poles and isinstance(poles[0], list):
        return [as_numbers(row) for row in poles]
    return [_pole(pole) for pole in poles]


def _pole(given: float | str) -> complex:
    try:
        return complex(given)
    except ValueError:
        hint = ""
        with suppress(ValueError):
            meant = str(given).replace(" ", "").replace("i", "j").replace("I", "j")
            complex(meant)
            hint = f': write "{meant}"'
        raise ArgumentError(
            f'poles must be numbers, or text such as "-1+2j", got {str(given)[:40]!r}{hint}.'
        ) from None


@dataclass(frozen=True)
class _Parts:
    """What laws are built from."""

    plant: SwitchedSystem
    gains: np.ndarray
    file: schema.ProblemFile
    model: Model | None
    rule: Rule | None


def _laws(parts: _Parts) -> dict[str, Law]:
    """The laws of the file by name, or all that apply if it lists none."""
    laws: dict[str, Law] = {}
    for i, section in enumerate(parts.file.law):
        with _section("law", i):
            law = _law(parts, section)
            if section.low_pass is not None:
                law = LowPassPredictor(law, section.low_pass)
            name = section.name or law.label
            if name in laws:
                raise ArgumentError(f"name {name!r} is used twice: give the law another name.")
            laws[name] = law
    return laws or _all_laws(parts)


def _all_laws(parts: _Parts) -> dict[str, Law]:
    """The paper's laws, and those that use what the file says about the switching.

    Where a rule switches an ideal loop there is one law that it can have.
    """
    plant, gains, file = parts.plant, parts.gains, parts.file
    allow = file.gains.allow_unstable
    with _section("gains"):
        exact = (
            StateDependentPredictor(plant, gains, parts.rule, allow_unstable=allow)
            if parts.rule is not None
            else None
        )
        if exact is not None and file.run.step == "ideal":
            return {exact.label: exact}
        mean = _mean_law(plant, gains, file, None, allow) if plant.modes > 1 else None
        laws = comparison_laws(plant, gains, mean, allow)
    if parts.model is not None:
        with _section("switching"):
            law = ExpectedPredictor(plant, gains, parts.model, allow_unstable=allow)
            laws[law.label] = law
    if exact is not None:
        # The oracle knows a signal, and there is none before the run.
        laws = {exact.label: exact} | {
            name: one for name, one in laws.items() if not isinstance(one, ExactPredictor)
        }
    return laws


def _law(parts: _Parts, section: schema.LawSection) -> Law:
    file, gains, own = parts.file, parts.gains, section.model
    plant = _changed(parts.plant, own)
    allow = file.gains.allow_unstable or own.A is not None or own.B is not None
    match section:
        case schema.AveragedLaw(weights="minimax"):
            return AveragedPredictor.minimax(
                plant,
                gains,
                _period(file, plant),
                common_gain=section.common_gain,
                dwell_time=section.dwell_time,
                allow_unstable=allow,
            )
        case schema.AveragedLaw(common_gain=True):
            raise ArgumentError('common_gain = true goes with weights = "minimax" only.')
        case schema.AveragedLaw():
            return AveragedPredictor(
                plant, gains, section.weights, section.dwell_time, allow_unstable=allow
            )
        case schema.SingleLaw():
            return SingleModePredictor(plant, gains, section.mode, allow_unstable=allow)
        case schema.MeanLaw():
            return _mean_law(plant, gains, file, section, allow)
        case schema.ExpectedLaw():
            model = _required(parts.model, section.kind)
            return ExpectedPredictor(plant, gains, model, ages=section.ages, allow_unstable=allow)
        case schema.OptimalLaw():
            return _optimal_law(plant, file, section, _required(parts.model, section.kind))
        case schema.ExactLaw():
            if parts.rule is not None:
                raise ArgumentError(
                    'kind = "exact" needs a signal that is known in advance, but the state '
                    'decides the mode: use kind = "state-dependent", which is exact there.'
                )
            return ExactPredictor(plant, gains, allow_unstable=allow)
        case schema.StateDependentLaw():
            if parts.rule is None:
                raise ArgumentError(
                    'kind = "state-dependent" needs a [signal] of kind "half-space", '
                    '"polyhedra" or "quadratic": that is the rule it runs forward.'
                )
            return StateDependentPredictor(plant, gains, parts.rule, allow_unstable=allow)
        case _:
            return DelayedStateFeedback(plant, gains, allow_unstable=allow)


def _changed(plant: SwitchedSystem, own: schema.ModelSection) -> SwitchedSystem:
    """The plant with what a section says otherwise, of the same sizes."""
    parts = {}
    for name, given in (("A", own.A), ("B", own.B)):
        mine = getattr(plant, name)
        array = mine if given is None else real_array(name, given, "(modes, n, n or m)", 3)
        parts[name] = shaped(name, array, mine.shape, "that of [plant]")
    return SwitchedSystem(**parts, delay=plant.delay if own.delay is None else own.delay)


def _period(file: schema.ProblemFile, plant: SwitchedSystem) -> float:
    """The sampling period of the run; a fine one where the law is updated continuously."""
    return plant.delay / 100.0 if file.run.step == "ideal" else positive("step", file.run.step)


def _required(model: Model | None, kind: str) -> Model:
    if model is None:
        raise ArgumentError(f"kind = {kind!r} needs a [switching] section: a model to rely on.")
    return model


def _optimal_law(
    plant: SwitchedSystem, file: schema.ProblemFile, section: schema.OptimalLaw, model: Model
) -> OptimalPredictor:
    """The optimal law for its own weights, or those of the gains, or the identity."""
    weights = file.gains.lqr
    Q = section.Q or (weights.Q if weights else np.eye(plant.states))
    R = section.R or (weights.R if weights else np.eye(plant.inputs))
    return OptimalPredictor(plant, model, Q, R)


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
        A = A if section.A is None else real_array("A", section.A, "(n, n)", 2)
        B = B if section.B is None else real_array("B", section.B, "(n, m)", 2)
    if section is not None and section.gain is not None:
        gain = real_array("gain", section.gain, "(m, n)", 2)
    elif file.gains.K is not None or isinstance((file.gains.poles or [0])[0], list):
        gain = gains.mean(axis=0)
    else:
        gain = _gains(SwitchedSystem(A[None], B[None], model.delay), file.gains)[0]
    dwell_time = None if section is None else section.dwell_time
    return MeanPredictor(model, gain, gains, dwell_time, (A, B), allow_unstable=allow)
