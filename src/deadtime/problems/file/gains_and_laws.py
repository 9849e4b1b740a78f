"""The [gains] and the laws of a problem file, each law with its own model of the plant."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from deadtime.base.checks import real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.estimation import Servo
from deadtime.feedback import Law
from deadtime.feedback.belief import BeliefFilter
from deadtime.gains import lqr, place
from deadtime.gains.state_feedback import check_gains
from deadtime.laws import LowPassPredictor
from deadtime.plant import SwitchedSystem, Weight
from deadtime.problems.file import schema
from deadtime.problems.file.estimators import build_mode_filter, observer_of
from deadtime.problems.file.servo import FileServo
from deadtime.problems.law_registry import LAWS, LawSetting, NamedLaw, build_law, name_of
from deadtime.problems.law_registry.entry import LawSection, ModelSection
from deadtime.problems.toml import section as _section
from deadtime.problems.toml.sections import kinds_of
from deadtime.switching import Rule, SwitchingModel

if TYPE_CHECKING:
    from deadtime.problems.file.schema import GainsSection


def build_gains(plant: SwitchedSystem, section: GainsSection) -> Float[np.ndarray, "mode m n"]:
    """K as given, or designed for this plant."""
    if section.K is not None:
        return check_gains(plant, section.K, section.allow_unstable)
    if section.poles is not None:
        gains = place(plant, as_numbers(section.poles), allow_unstable=section.allow_unstable)
        return check_gains(plant, gains, section.allow_unstable)
    assert section.lqr is not None
    return lqr(plant, section.lqr.Q, section.lqr.R)


def servo_gains(servo: Servo, section: GainsSection, step: float) -> Float[np.ndarray, "mode m z"]:
    """The gains of a servo, from those of (x, q), at the sampling period."""
    if section.K is not None:
        return servo.complete(section.K, step)
    if section.poles is not None:
        return servo.place(as_numbers(section.poles), step)
    assert section.lqr is not None
    return servo.lqr(section.lqr.Q, section.lqr.R, step)


def mean_gain(
    section: GainsSection, gains: Float[np.ndarray, "mode m n"], mean: SwitchedSystem
) -> Float[np.ndarray, "m n"]:
    """A gain designed for the mean plant as the others were.

    Where that is not defined (gains given as K, or poles per mode), the mean of the gains.
    """
    return gains.mean(axis=0) if _differ(section) else build_gains(mean, section)[0]


def servo_mean_gain(
    following: FileServo,
    section: GainsSection,
    gains: Float[np.ndarray, "mode m z"],
    step: float,
    mean: SwitchedSystem,
) -> Float[np.ndarray, "m z"]:
    """`mean_gain` for the mean of plants that a servo has extended."""
    if _differ(section):
        return gains.mean(axis=0)
    return servo_gains(following.of_mean(mean), section, step)[0]


def _differ(section: GainsSection) -> bool:
    return section.K is not None or isinstance((section.poles or [0])[0], list)


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
            # As MATLAB writes it.
            meant = str(given).replace(" ", "").replace("i", "j").replace("I", "j")
            complex(meant)
            hint = f': write "{meant}"'
        raise ArgumentError(
            f'poles must be numbers, or text such as "-1+2j", got {str(given)[:40]!r}{hint}.'
        ) from None


@dataclass(frozen=True, eq=False)
class Laws:
    """Builds the laws of a file.

    `gains` are (modes, m, n), or (modes, m, z) with a servo, `following`, where outputs follow a
    reference; `model`, `rule`, `weight` are as in `LawSetting`; `step` is None for an ideal loop.
    """

    file: schema.ProblemFile
    plant: SwitchedSystem
    gains: Float[np.ndarray, "mode m z"]
    model: SwitchingModel | None
    rule: Rule | None
    weight: Weight | None
    step: float | None
    following: FileServo | None

    def build(self) -> tuple[dict[str, Law], dict[str, Servo]]:
        """The laws of the file by name, or all that apply if it lists none; and their servos."""
        setting = self._setting()
        laws: dict[str, Law] = {}
        servos: dict[str, Servo] = {}
        for i, section in enumerate(self.file.law):
            with _section("law", i):
                self._require_fit(section)
                own, servo = self._extended(self._with_model(setting, section.model))
                law = build_law(section, own)
                if section.low_pass is not None:
                    law = LowPassPredictor(law, section.low_pass)
                name = section.name or name_of(law, self.file.plant.modes)
                if name in laws:
                    raise ArgumentError(f"name {name!r} is used twice: give the law another name.")
                laws[name] = law
                servos |= {name: servo} if servo is not None else {}
        return (laws, servos) if laws else self._usual(setting)

    def _setting(self) -> LawSetting:
        """The setting of a law of the file's own plant."""
        file, design, weight = self.file, self.file.gains.lqr, self.weight
        if weight is None and file.cost is None and design is not None and not self.following:
            weight = Weight(design.Q, design.R)
        return LawSetting(
            plant=self.plant,
            gains=self.gains,
            mean_gain=partial(mean_gain, file.gains, self.gains),
            period=_period(file, self.plant),
            model=self.model,
            rule=self.rule,
            weight=weight,
            mode_filter=self._mode_filter(),
            allow_unstable=file.gains.allow_unstable,
        )

    def _mode_filter(self) -> Callable[[SwitchedSystem], BeliefFilter] | None:
        """A function from the plant of a law to its mode filter, where the file has one."""
        file, step = self.file, self.step
        with _section("mode_filter"):
            observed = None
            if file.observer is not None and step is not None:
                observer = partial(
                    observer_of, section=file.observer, step=step, numbers=as_numbers
                )
                observed = observer, file.observer
            return build_mode_filter(file.mode_filter, self.plant, self.model, step, observed)

    def _with_model(self, setting: LawSetting, own: ModelSection) -> LawSetting:
        """The setting with a law's own model of the plant."""
        plant = change_plant(setting.plant, own)
        allow = setting.allow_unstable or own.A is not None or own.B is not None
        return replace(setting, plant=plant, period=_period(self.file, plant), allow_unstable=allow)

    def _extended(self, setting: LawSetting) -> tuple[LawSetting, Servo | None]:
        """The setting with the plant extended by the servo, for laws that follow a reference."""
        following = self.following
        if following is None or self.step is None:
            return setting, None
        servo, gains = following.of_plant(setting.plant), self.gains
        if setting.plant is not self.plant:
            gains = servo.complete(gains[:, :, servo.moving], self.step)
        tuned = partial(servo_mean_gain, following, self.file.gains, gains, self.step)
        changed = {"plant": servo.plant, "gains": gains, "mean_gain": tuned}
        return replace(setting, **changed, allow_unstable=True), servo

    def _require_fit(self, section: LawSection) -> None:
        """Refuse a law that follows no reference, where the file has one."""
        if self.following is not None and not section.follows:
            kinds = ", ".join(dict.fromkeys(k.kind for k in LAWS.values() if k.entry.follows))
            unmeasured = (
                " Where the mode is not measured, averaged and mean need none on an [observer] "
                'with model = "mean".'
            )
            raise ArgumentError(
                f'kind = "{kinds_of(type(section))[0]}" follows no reference: with a [servo] take '
                f"one of {kinds}.{unmeasured if 'mode_filter' in section.needs else ''}"
            )

    def _usual(self, setting: LawSetting) -> tuple[dict[str, Law], dict[str, Servo]]:
        """The default laws: the paper's, and those that use the file's [switching].

        With a rule the law that predicts by it comes first, and is the only one of an ideal loop.
        """
        modes = setting.plant.modes
        usual = [known for known in LAWS.values() if self._applies(known, setting)]
        usual.sort(key=lambda known: "rule" not in known.entry.needs)
        if setting.rule is not None and self.step is None:
            usual = usual[:1]
        laws: dict[str, Law] = {}
        setting, servo = self._extended(setting)
        for known in usual:
            with _section("switching" if "model" in known.entry.needs else "gains"):
                built = [known.build(setting, mode) for mode in known.modes(modes)]
            laws |= {name_of(law, self.file.plant.modes): law for law in built}
        return laws, {} if servo is None else dict.fromkeys(laws, servo)

    def _applies(self, known: NamedLaw, setting: LawSetting) -> bool:
        """Whether a law runs where the file names none."""
        return (
            known.named.in_files
            and (setting.plant.modes > 1 or not known.named.several)
            and all(map(setting.has, known.entry.needs))
            and (self.following is None or known.entry.follows)
        )


def change_plant(plant: SwitchedSystem, own: ModelSection) -> SwitchedSystem:
    """The plant with the parts that a section replaces, of the same sizes."""
    parts = {}
    for name, given in (("A", own.A), ("B", own.B)):
        mine = getattr(plant, name)
        array = mine if given is None else real_array(name, given, "(modes, n, n or m)", 3)
        parts[name] = require_shape(name, array, mine.shape, "that of [plant]")
    return SwitchedSystem(**parts, delay=plant.delays if own.delay is None else own.delay)


def _period(file: schema.ProblemFile, plant: SwitchedSystem) -> float:
    """The sampling period of the run; a short one where the law is updated continuously."""
    return plant.delays.min() / 100.0 if file.run.step == "ideal" else file.run.step
