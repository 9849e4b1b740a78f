"""From a checked problem file to a problem: plant, gains, laws and signal are built here."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from deadtime.base.checks import positive, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.estimation import ModeFilter, OutputModeFilter
from deadtime.feedback import Law
from deadtime.gains import lqr, place
from deadtime.gains.checked import check_gains
from deadtime.imperfections import Imperfection, Sizes
from deadtime.laws import LowPassPredictor
from deadtime.plant import SwitchedSystem
from deadtime.plant.weight import Weight, weight_of
from deadtime.problems.file import schema
from deadtime.problems.file.imperfections import build_imperfections
from deadtime.problems.file.mode_filter import build_mode_filter
from deadtime.problems.file.observer import add_observers, observer_of
from deadtime.problems.file.switching import build_model, build_rule, build_signal
from deadtime.problems.law_registry import LAWS, Model, Setting, build_law
from deadtime.problems.law_registry.entry import ModelSection
from deadtime.problems.problem import Problem
from deadtime.problems.toml import section as _section
from deadtime.switching import Rule


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
    weight = _weight(file, plant)
    laws = _laws(file, plant, gains, model, rule, weight)
    with _section("run"):
        run = file.run
        x0 = require_shape("x0", real_array("x0", run.x0, "(n,)", 1), (plant.states,), "(n,)")
        u0 = real_array("u0", np.atleast_1d(run.u0), "(m,)", 1)
        if u0.size == 1:
            u0 = np.full(plant.inputs, u0[0])
        require_shape("u0", u0, (plant.inputs,), "(m,)")
        horizon = positive("horizon", run.horizon)
        step = None if run.step == "ideal" else positive("step", run.step)
    with _section("observer"):
        laws = add_observers(laws, file.observer, step, as_numbers)
    with _section("truth"):
        truth = _change_plant(plant, file.truth) if file.truth is not None else plant
    imperfections = _imperfections(file, plant, laws, step)
    with _section("signal"):
        longest = max(truth.longest_delay, *(law.plant.longest_delay for law in laws.values()))
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
        weight=weight,
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


def _weight(file: schema.ProblemFile, plant: SwitchedSystem) -> Weight | None:
    """The weight of the cost; None for the identity."""
    if file.cost is None:
        return None
    with _section("cost"):
        return weight_of(Weight(file.cost.Q, file.cost.R).of(plant, where=""), plant)


def _names(what: str, names: list[str], count: int) -> tuple[str, ...]:
    if names and len(names) != count:
        raise ArgumentError(f"{what} must name all {count}, got {len(names)} names.")
    return tuple(names)


def _gains(plant: SwitchedSystem, section: schema.GainsSection) -> np.ndarray:
    """K as given, or designed for this plant."""
    if section.K is not None:
        return check_gains(plant, section.K, section.allow_unstable)
    if section.poles is not None:
        gains = place(plant, as_numbers(section.poles), allow_unstable=section.allow_unstable)
        return check_gains(plant, gains, section.allow_unstable)
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


def _laws(
    file: schema.ProblemFile,
    plant: SwitchedSystem,
    gains: np.ndarray,
    model: Model | None,
    rule: Rule | None,
    weight: Weight | None,
) -> dict[str, Law]:
    """The laws of the file by name, or all that apply if it lists none."""
    design = file.gains.lqr
    if weight is None and file.cost is None and design is not None:
        weight = Weight(design.Q, design.R)
    setting = Setting(
        plant=plant,
        gains=gains,
        mean_gain=partial(_mean_gain, file.gains, gains),
        period=_period(file, plant),
        model=model,
        rule=rule,
        weight=weight,
        mode_filter=_mode_filter(file, plant, model),
        allow_unstable=file.gains.allow_unstable,
    )
    laws: dict[str, Law] = {}
    for i, section in enumerate(file.law):
        with _section("law", i):
            law = build_law(section, _with_belief(setting, file, section.model))
            if section.low_pass is not None:
                law = LowPassPredictor(law, section.low_pass)
            name = section.name or _name_of(law)
            if name in laws:
                raise ArgumentError(f"name {name!r} is used twice: give the law another name.")
            laws[name] = law
    return laws or _all_laws(file, setting)


def _mode_filter(
    file: schema.ProblemFile, plant: SwitchedSystem, model: Model | None
) -> Callable[[SwitchedSystem], ModeFilter | OutputModeFilter] | None:
    """What makes the filter of a law that believes in a plant, where the file has one."""
    with _section("run"):
        step = None if file.run.step == "ideal" else positive("step", file.run.step)
    with _section("mode_filter"):
        observed = None
        if file.observer is not None and step is not None:
            observer = partial(observer_of, section=file.observer, step=step, numbers=as_numbers)
            observed = observer, file.observer
        return build_mode_filter(file.mode_filter, plant, model, step, observed)


def _with_belief(setting: Setting, file: schema.ProblemFile, own: ModelSection) -> Setting:
    """The setting with the plant that a law believes in."""
    plant = _change_plant(setting.plant, own)
    allow = setting.allow_unstable or own.A is not None or own.B is not None
    return replace(setting, plant=plant, period=_period(file, plant), allow_unstable=allow)


def _all_laws(file: schema.ProblemFile, setting: Setting) -> dict[str, Law]:
    """The paper's laws, and those that use what the file says about the switching.

    Where a rule switches the loop the law that knows it comes first, and an ideal loop can have
    no other.
    """
    modes = setting.plant.modes
    usual = [
        known
        for known in LAWS.values()
        if known.named.in_files
        and (modes > 1 or not known.named.several)
        and all(map(setting.has, known.entry.needs))
    ]
    usual.sort(key=lambda known: "rule" not in known.entry.needs)
    if setting.rule is not None and file.run.step == "ideal":
        usual = usual[:1]
    laws: dict[str, Law] = {}
    for known in usual:
        with _section("switching" if "model" in known.entry.needs else "gains"):
            built = [known.build(setting, mode) for mode in known.modes(modes)]
        laws |= {_name_of(law): law for law in built}
    return laws


def _name_of(law: Law) -> str:
    """A law's name in a file, in which all are observed or none is."""
    return law.label.removesuffix(", observed")


def _change_plant(plant: SwitchedSystem, own: ModelSection) -> SwitchedSystem:
    """The plant with what a section says otherwise, of the same sizes."""
    parts = {}
    for name, given in (("A", own.A), ("B", own.B)):
        mine = getattr(plant, name)
        array = mine if given is None else real_array(name, given, "(modes, n, n or m)", 3)
        parts[name] = require_shape(name, array, mine.shape, "that of [plant]")
    return SwitchedSystem(**parts, delay=plant.delays if own.delay is None else own.delay)


def _period(file: schema.ProblemFile, plant: SwitchedSystem) -> float:
    """The sampling period of the run; a fine one where the law is updated continuously."""
    return plant.delays.min() / 100.0 if file.run.step == "ideal" else file.run.step


def _mean_gain(section: schema.GainsSection, gains: np.ndarray, mean: SwitchedSystem) -> np.ndarray:
    """A gain designed for the mean plant as the others were.

    Where that is not defined (gains given as K, or poles per mode), the mean of the gains.
    """
    if section.K is not None or isinstance((section.poles or [0])[0], list):
        return gains.mean(axis=0)
    return _gains(mean, section)[0]
