"""The [gains] of a problem file: given, or designed, for a plant or for its servo."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from deadtime.base.errors import ArgumentError
from deadtime.estimation import Servo
from deadtime.gains import lqr, place
from deadtime.gains.state_feedback import check_gains
from deadtime.plant import SwitchedSystem

if TYPE_CHECKING:
    from deadtime.problems.file.schema import GainsSection
    from deadtime.problems.file.servo import FileServo


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
    """The same of the mean of plants that a servo has extended."""
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
            meant = str(given).replace(" ", "").replace("i", "j").replace("I", "j")
            complex(meant)
            hint = f': write "{meant}"'
        raise ArgumentError(
            f'poles must be numbers, or text such as "-1+2j", got {str(given)[:40]!r}{hint}.'
        ) from None
