"""The operating point of a controller in C: its arrays, and its description in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from deadtime.controller.export.c_text import Names, in_comment, initializer

if TYPE_CHECKING:
    import numpy as np

    from deadtime.controller.export.forms import Precision
    from deadtime.controller.running import RunningLaw


def arrays(controller: RunningLaw, prediction: bool) -> dict[str, tuple[np.ndarray, str]]:
    """Arrays for ROM, with a comment each; none without a point."""
    if controller.operating_point is None:
        return {}
    rest = controller.rest
    found = {
        "REST": (rest.given, "the measurement at the operating point"),
        "REST_U": (rest.u, "the inputs there"),
    }
    if rest.reference.size:
        found["REST_R"] = rest.reference, "the tracked outputs there"
    if prediction:
        found["REST_Z"] = rest.z, "the law's state vector there"
    return found


def values(controller: RunningLaw, precision: Precision) -> dict[str, str]:
    """Initializers on one line, for macros of the header."""
    both = {"rest": controller.rest.given, "rest_u": controller.rest.u}
    return {key: initializer(one, precision).replace("\n", " ") for key, one in both.items()}


def in_words(controller: RunningLaw, names: Names) -> str:
    """The operating point for a comment; nothing without one."""
    point = controller.operating_point
    return "" if point is None else in_comment(names.point_in_words(point, controller.law.plant))
