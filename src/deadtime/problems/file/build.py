"""From a checked problem file to a problem: plant, gains, laws, imperfections and signal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import index, positive, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.base.wording import numbered
from deadtime.estimation.observer import output_matrices
from deadtime.feedback import Law
from deadtime.imperfections import Imperfection, SensorImperfection, Sizes, StepDisturbance, require
from deadtime.plant import OperatingPoint, SwitchedSystem
from deadtime.plant.weight import Weight, weight_of
from deadtime.problems.file import schema
from deadtime.problems.file.estimators import add_observers, names_of
from deadtime.problems.file.gains_and_laws import (
    Laws,
    as_numbers,
    build_gains,
    change_plant,
    servo_gains,
)
from deadtime.problems.file.mode_names import with_mode_numbers
from deadtime.problems.file.servo import FileServo
from deadtime.problems.file.switching import build_rule, build_signal, promise_of
from deadtime.problems.imperfection_registry import ImperfectionSection, build_imperfection
from deadtime.problems.problem import Problem
from deadtime.problems.toml import section as _section
from deadtime.switching import SignalClass


def require_units(units: Mapping[str, str], names: Sequence[str]) -> None:
    """Refuse an empty unit, one of an unknown name, and one that the name already has.

    Examples
    --------
    >>> require_units({"speed": "m/s"}, ["position (m)", "speed"])
    >>> require_units({"sped": "m/s"}, ["position (m)", "speed"])
    Traceback (most recent call last):
    deadtime.ArgumentError: units must belong to states, inputs or outputs, 'position (m)', \
'speed', got 'sped': give that a name first, or correct it.
    """
    for name, unit in units.items():
        if name not in names:
            known = ", ".join(map(repr, dict.fromkeys(names))) or "of which none has a name"
            raise ArgumentError(
                f"units must belong to states, inputs or outputs, {known}, got {name!r}: give "
                "that a name first, or correct it."
            )
        if not unit.strip():
            raise ArgumentError(f"units of {name!r} must not be empty: leave it out, or say 1.")
        if name.endswith(")"):
            raise ArgumentError(
                f"units of {name!r} must not be given twice, got {unit!r}, too: remove the "
                "brackets from the name."
            )


def labels(names: Sequence[str], units: Mapping[str, str]) -> tuple[str, ...]:
    """Names with their units in brackets, where they have some.

    Examples
    --------
    >>> labels(["position", "gear"], {"position": "m"})
    ('position (m)', 'gear')
    """
    return tuple(f"{name} ({units[name].strip()})" if name in units else name for name in names)


def build_imperfections(
    sections: Sequence[ImperfectionSection], sizes: Sizes, measured: int | None = None
) -> tuple[Imperfection, ...]:
    """The imperfections of a file, each checked against the sizes of its loop.

    `measured` is the number of measured outputs, where the state is not measured.
    """
    sensors = sizes if measured is None else sizes._replace(states=measured)
    built = []
    for i, one in enumerate(sections):
        with _section("imperfection", i):
            made = build_imperfection(one)
            require(made, sensors if isinstance(made, SensorImperfection) else sizes)
            built.append(made)
    return tuple(built)


def offsets_of(
    sections: Sequence[schema.OffsetSection], plant: SwitchedSystem
) -> Float[np.ndarray, "mode n"]:
    """The constant force of every mode, 0 where there is no section."""
    force, named = np.zeros((plant.modes, plant.states)), set()
    for i, one in enumerate(sections):
        with _section("offset", i):
            mode = index("mode", one.mode, plant.modes)
            if mode in named:
                raise ArgumentError(f"mode {mode} has an offset already: give one for each mode.")
            named.add(mode)
            given = real_array("force", one.force, "(n,)", 1)
            force[mode] = require_shape("force", given, (plant.states,), "(n,)")
    return force


def build_problem(file: schema.ProblemFile, source: Path) -> Problem:
    """The problem that a checked file describes; relative paths start at the file's folder."""
    file = with_mode_numbers(file)
    with _section("plant"):
        plant = SwitchedSystem(file.plant.A, file.plant.B, file.plant.delay)
        states = _names("states", file.plant.states, plant.states)
        inputs = _names("inputs", file.plant.inputs, plant.inputs)
        modes = _names("modes", file.plant.modes, plant.modes)
    with _section("run"):
        step = None if file.run.step == "ideal" else positive("step", file.run.step)
    outputs, following = _measured(file, plant, states, step, source.parent)
    units = file.plant.units
    with _section("plant"):
        require_units(units, (*states, *inputs, *outputs))
    with _section("gains"):
        gains = _gains(file, plant, following, step)
    model = None
    if file.switching is not None:
        with _section("switching"):
            model = file.switching.model(plant.modes, source.parent)
    with _section("signal"):
        rule = build_rule(file.signal)
        if rule is not None:
            rule.require(plant)
    weight = uncertain = point = None
    if file.cost is not None:
        with _section("cost"):
            given = Weight(file.cost.Q, file.cost.R)
            weight = weight_of(given.of(plant, where=""), plant)  # None for the identity
    laws, servos = Laws(file, plant, gains, model, rule, weight, step, following).build()
    with _section("run"):
        x0 = real_array("x0", file.run.x0, "(n,)", 1)
        x0 = require_shape("x0", x0, (plant.states,), "(n,)")
        u0 = real_array("u0", np.atleast_1d(file.run.u0), "(m,)", 1)
        u0 = np.full(plant.inputs, u0[0]) if u0.size == 1 else u0
        u0 = require_shape("u0", u0, (plant.inputs,), "(m,)")
        horizon = positive("horizon", file.run.horizon)
    with _section("observer"):
        laws = add_observers(laws, file.observer, step, as_numbers, servos, following)
    with _section("truth"):
        truth = change_plant(plant, file.truth) if file.truth is not None else plant
    imperfections = _imperfections(file, plant, laws, step, following)
    signal, promise = rule, SignalClass()
    if signal is None:
        longest = max(truth.longest_delay, *(law.plant.longest_delay for law in laws.values()))
        end = horizon + longest + min(step or 0.0, horizon)  # of the oracle's last prediction
        with _section("signal"):
            signal = build_signal(file.signal, plant, end, source.parent, model, step)
            signal.require_modes(plant.modes)
            promise = promise_of(file, model, plant.modes, step)
    if file.uncertainty is not None:
        with _section("uncertainty"):
            kind: Any = schema.UNCERTAINTIES[type(file.uncertainty)]
            uncertain = kind(plant, **file.uncertainty.model_dump())
    if file.operating_point is not None:
        with _section("operating_point"):
            point = OperatingPoint(file.operating_point.x, file.operating_point.u)
            require_shape("x", point.x, (plant.states,), "(n,)")
            require_shape("u", point.u, (plant.inputs,), "(m,)")
    return Problem(
        name=source.stem,
        title=file.title or source.stem,
        source=file.source,
        plant=truth,
        gains=gains[:, :, : plant.states],
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
        weight=weight,
        states=labels(states, units),
        inputs=labels(inputs, units),
        modes=modes,
        outputs=labels(outputs, units),
        tracked=() if following is None else labels(following.names, units),
        switching=model,
        signals=promise,
        mean_sojourn=getattr(file.signal, "mean_sojourn", None),
        uncertain=uncertain,
        operating_point=point,
    )


def _imperfections(
    file: schema.ProblemFile,
    plant: SwitchedSystem,
    laws: dict[str, Law],
    step: float | None,
    following: FileServo | None,
) -> tuple[Imperfection, ...]:
    """The imperfections of the file, checked against what its laws measure and follow."""
    if not file.imperfection and not file.offset and following is None:
        return ()
    if step is None:
        with _section("run"):
            raise ArgumentError(
                'step = "ideal" has no samples, at which offsets and imperfections act: give a '
                "period."
            )
    outputs = next(iter(laws.values())).outputs
    measured = None if outputs is None else outputs.shape[1]
    sizes = Sizes(plant.modes, plant.states, plant.inputs, step)
    force = offsets_of(file.offset, plant)
    imperfections = build_imperfections(file.imperfection, sizes, measured)
    if following is not None:
        with _section("servo"):
            following.require_reach(plant, imperfections, step, force)
    return (StepDisturbance(force.tolist()), *imperfections) if file.offset else imperfections


def _names(what: str, names: list[str], count: int) -> tuple[str, ...]:
    if names and len(names) != count:
        raise ArgumentError(f"{what} must name all {count}, got {len(names)} names.")
    return tuple(names)


def _measured(
    file: schema.ProblemFile,
    plant: SwitchedSystem,
    states: tuple[str, ...],
    step: float | None,
    folder: Path,
) -> tuple[tuple[str, ...], FileServo | None]:
    """Names of the measured outputs with an observer or a servo; and the servo."""
    if file.observer is None and file.servo is None:
        return (), None
    states = states or numbered("x", plant.states)
    with _section("observer"):
        C, outputs = np.eye(plant.states), states
        if file.observer is not None:
            C = output_matrices(file.observer.C, plant)
            outputs = _names("outputs", file.observer.outputs, C.shape[1]) or names_of(C, states)
    if file.servo is None:
        return outputs, None
    with _section("servo"):
        if step is None:
            raise ArgumentError(
                'a servo runs at samples: give [run] a step in seconds, not "ideal".'
            )
        if file.observer is None and file.servo.disturbance is not None:
            raise ArgumentError(
                "disturbance is estimated by an observer: give an [observer] for the states and "
                "the disturbance, or leave it out, since the sum of errors compensates it, too."
            )
        return outputs, FileServo.of(file.servo, C, outputs, folder)


def _gains(
    file: schema.ProblemFile, plant: SwitchedSystem, following: FileServo | None, step: float | None
) -> np.ndarray:
    """K (modes, m, n), or with a servo (modes, m, z)."""
    if following is None or step is None:
        return build_gains(plant, file.gains)
    with _section("servo"):
        servo = following.of_plant(plant)
    return servo_gains(servo, file.gains, step)
