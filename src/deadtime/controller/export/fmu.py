"""`export_fmu`: a controller, and a plant with its delay, as FMUs for co-simulation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import bound, count, instance, real_array, require_shape
from deadtime.base.files import Staging
from deadtime.controller.export.belief_code import outputs_of
from deadtime.controller.export.c_code import c_sources, given_of
from deadtime.controller.export.fmi_description import Version
from deadtime.controller.export.fmu_file import ExportedFmu, render, write_fmu
from deadtime.controller.export.fmu_variables import controller_variables, plant_variables
from deadtime.controller.export.forms import Precision
from deadtime.controller.export.literals import brackets, initializer, literal
from deadtime.controller.export.names import Names
from deadtime.controller.export.observer_code import ObserverForm
from deadtime.plant import OperatingPoint, SwitchedSystem

if TYPE_CHECKING:
    from deadtime.controller.running import RunningLaw


def export_fmu(
    controller: RunningLaw,
    path: str | Path,
    *,
    version: Version = "3.0",
    precision: Precision = "double",
    accuracy: float | None = None,
    u0: ArrayLike = 0.0,
    names: Names | None = None,
    staging: Staging | None = None,
) -> ExportedFmu:
    """See `Controller.export_fmu`; with `staging` the file appears together with its others."""
    name, plant = "controller", controller.law.plant
    past, names = _finite(u0, plant.inputs) + controller.rest.u, names or Names()
    texts, _ = c_sources(controller, precision, accuracy, None, name, names)
    kept = {file: texts[file] for file in (f"{name}.c", f"{name}.h", f"{name}_tables.h")}
    observer = None if controller.observing is None else ObserverForm.of(controller.observing)
    outputs = outputs_of(controller.believing)
    values = {
        "p": name,
        "belief": controller.believing is not None,
        "observer": observer is not None,
        "outputs": outputs,
        **given_of(observer, outputs),
        "begun": initializer(past, "double"),
        "rest": {key: initializer(array, "double") for key, array in _at_rest(controller).items()},
        "slack": literal(1e-3 * controller.step, "double"),
        "include": (
            f'#include "{name}.h"\n\ntypedef struct {{\n    {name}_controller controller;\n'
            "    double start, next; /* of the samples */\n"
            f"    {name}_real past[{name.upper()}_TAPS * {name.upper()}_INPUTS];\n}} memory;"
        ),
    }
    sources = kept | {"model.c": render("controller_model.c.j2", values)}
    title = f"Controller: {names.title or controller.law.label}"
    title += _about(controller.operating_point, names, plant)
    believes = controller.believing is not None
    variables = controller_variables(
        plant, names, past, controller.rest, believes, observer, bool(outputs)
    )
    return write_fmu(
        Path(path), version, name, title, controller.step, variables, sources, values, staging
    )


def export_plant_fmu(
    plant: SwitchedSystem,
    path: str | Path,
    *,
    x0: ArrayLike | None = None,
    u0: ArrayLike = 0.0,
    version: Version = "3.0",
    changes: int = 4096,
    names: Names | None = None,
    operating_point: OperatingPoint | None = None,
    staging: Staging | None = None,
) -> ExportedFmu:
    """Write a plant with its input delay as an FMU for co-simulation.

    Its inputs are u and the mode, held over a step of any length; its outputs the state. Inputs
    arrive exactly their delays later, those of the mode in force, on the grid of the steps or off
    it: the state is exact to round-off.
    Parameters set the state at the start, and the constant input before it.

    Parameters
    ----------
    plant : SwitchedSystem
    path : path of the FMU, in .fmu
    x0 : (n,), optional
        The state at the start, 0 by default; a parameter of the FMU, too.
    u0 : number or (m,)
        The constant input before the start; parameters, too.
    version : "3.0" or "2.0"
        Of FMI.
    changes : int
        How often the input may change within the longest delay D: more than D / h.
    names : Names, optional
        Of states, inputs and modes, for the descriptions.
    operating_point : OperatingPoint, optional
        Where the plant rests. With it u and x of the FMU, and its parameters, are absolute; x0 and
        u0 are given as deviations from it all the same.
    staging : Staging, optional
        What the file is to appear together with.

    Raises
    ------
    ArgumentError
        If the file cannot be written.
    """
    instance("plant", plant, SwitchedSystem)
    n, m, name, names = plant.states, plant.inputs, "plant", names or Names()
    names.require(plant)
    past = _finite(u0, m)
    start = (
        np.zeros(n)
        if x0 is None
        else require_shape("x0", real_array("x0", x0, "(n,)", 1), (n,), "(n,)")
    )
    size = count("changes", changes, 2)
    point = OperatingPoint(np.zeros(n), np.zeros(m)) if operating_point is None else operating_point
    instance("operating_point", point, OperatingPoint)
    rest = require_shape("operating_point.x", point.x, (n,), "(n,)")
    start, past = start + rest, past + require_shape("operating_point.u", point.u, (m,), "(m,)")
    values = {
        "delay": literal(plant.longest_delay, "double"),
        "slack": literal(1e-6 * plant.longest_delay, "double"),
        "include": (
            f"enum {{ N = {n}, M = {m}, MODES = {plant.modes}, CHANGES = {size} }};\n\n"
            "typedef struct {\n    int first, count; /* of the inputs that have not passed */\n"
            "    double began[CHANGES];\n    double u[CHANGES][M];\n} memory;"
        ),
        "tables": [
            {"name": key, "shape": brackets(array), "text": initializer(array, "double")}
            for key, array in (
                ("A", plant.A),
                ("B", plant.B),
                ("DELAYS", plant.delays),
                ("REST_X", rest),
                ("REST_U", point.u),
                ("START", start),
                ("PAST", past),
            )
        ],
    }
    sources = {"model.c": render("plant_model.c.j2", values)}
    title = names.title or f"Plant with a delay of {plant.delay_text} s"
    title += _about(operating_point, names, plant)
    variables = plant_variables(names, start, past, point.u)
    return write_fmu(Path(path), version, name, title, None, variables, sources, values, staging)


def _about(point: OperatingPoint | None, names: Names, plant: SwitchedSystem) -> str:
    """The operating point, for the title of what takes absolute values; nothing without one."""
    if point is None:
        return ""
    return f"; absolute values, at rest {names.point_in_words(point, plant)}"


def _at_rest(controller: RunningLaw) -> dict[str, np.ndarray]:
    """Values of a controller's variables while its plant rests; none without a point."""
    if controller.operating_point is None:
        return {}
    given, u, reference, z = controller.rest
    found = {"X": given, "APPLIED": u}
    if reference.size:
        found["REFERENCE"] = reference
    return found | ({} if controller.observing is None else {"ESTIMATE": z})


def _finite(u0: ArrayLike, m: int) -> np.ndarray:
    """A constant input for each of m."""
    past = bound("u0", u0, m)
    return real_array("u0", past, "(m,)", 1)
