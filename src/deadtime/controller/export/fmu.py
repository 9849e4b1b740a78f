"""`export_fmu`: a controller, and a plant with its delay, as FMUs for co-simulation."""

from __future__ import annotations

import hashlib
import platform
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from deadtime.base.checks import bound, count, instance, real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.base.files import Staging, unwritable
from deadtime.base.version import __version__
from deadtime.controller.export.belief_code import outputs_of
from deadtime.controller.export.c_code import c_sources, environment, given_of
from deadtime.controller.export.c_text import Names, brackets, initializer, literal
from deadtime.controller.export.compiler import compile_and_link, require_suffix
from deadtime.controller.export.fmi_description import (
    FmuDescription,
    Variable,
    Version,
    build_description,
    controller_variables,
    description,
    plant_variables,
)
from deadtime.controller.export.forms import Precision
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
    """See `Controller.export_fmu`; with `staging` it appears together with the others."""
    name, plant = "controller", controller.law.plant
    past, names = _finite(u0, plant.inputs) + controller.rest.u, names or Names()
    texts, _ = c_sources(controller, precision, accuracy, None, name, names)
    kept = {file: texts[file] for file in (f"{name}.c", f"{name}.h", f"{name}_tables.h")}
    values = {
        "p": name,
        "belief": controller.mode_belief is not None,
        "observer": controller.observing is not None,
        "outputs": outputs_of(controller.mode_belief),
        **given_of(controller),
        "begun": initializer(past, "double"),
        "rest": {key: initializer(array, "double") for key, array in _at_rest(controller).items()},
        "slack": literal(1e-3 * controller.step, "double"),
        "include": (
            f'#include "{name}.h"\n\ntypedef struct {{\n    {name}_controller controller;\n'
            "    double start, next; /* time of sample 0; next sample */\n"
            f"    {name}_real past[{name.upper()}_TAPS * {name.upper()}_INPUTS];\n}} inner_state;"
        ),
    }
    sources = kept | {"model.c": render("controller_model.c.j2", values)}
    title = f"Controller: {names.title or controller.law.label}"
    title += _about(controller.operating_point, names, plant)
    variables = controller_variables(controller, names, past)
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
    arrive after the delays of the present mode, within steps, too: the state is exact to round-off.
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
        Equilibrium of the plant. With it u, x and the parameters of the FMU are absolute; x0 and u0
        here are still deviations from it.
    staging : Staging, optional
        Other files, with which this one appears together.

    Raises
    ------
    ArgumentError
        If the file cannot be written.
    """
    instance("plant", plant, SwitchedSystem)
    n, m, name, names = plant.states, plant.inputs, "plant", names or Names()
    names.require(states=n, modes=plant.modes, inputs=m)
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
            "typedef struct {\n"
            "    int first, count; /* of the inputs that act now or later */\n"
            "    double began[CHANGES];\n    double u[CHANGES][M];\n} inner_state;"
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
    """The operating point, for the title; nothing without one."""
    if point is None:
        return ""
    return f"; absolute values, at rest {names.point_in_words(point, plant)}"


def _at_rest(controller: RunningLaw) -> dict[str, np.ndarray]:
    """Values of a controller's variables at the operating point; none without one."""
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


_LONG_AGO = (1980, 1, 1, 0, 0, 0)  # one date, so that equal FMUs are equal files
_SUFFIX = {"linux": "so", "darwin": "dylib", "win32": "dll"}
_SYSTEM = {"linux": "linux", "darwin": "darwin", "win32": "windows"}
_OLD_SYSTEM = {"linux": "linux", "darwin": "darwin", "win32": "win"}


@dataclass(frozen=True)
class ExportedFmu:
    """An exported FMU (immutable): the file, its version of FMI, and its binary, or None."""

    path: Path
    version: str
    binary: str | None
    message: str

    def __str__(self) -> str:
        return f"{self.path}: FMI {self.version}; {self.message}"


def render(template: str, values: dict) -> str:
    """The text of a template of FMUs."""
    return environment("fmu").get_template(template).render(values | {"version": __version__})


def write_fmu(
    path: Path,
    version: Version,
    name: str,
    title: str,
    step: float | None,
    variables: Sequence[Variable],
    sources: dict[str, str],
    values: dict,
    staging: Staging | None,
) -> ExportedFmu:
    """Zip description, sources and, where there is a compiler, a binary for this machine.

    The file appears when it is complete, and with `staging` together with its other files.
    """
    if version not in ("2.0", "3.0"):
        raise ArgumentError(f"version must be '2.0' or '3.0', got {version!r}.")
    require_suffix(path, ".fmu")
    wrapper = f"fmi{version[0]}.c"
    sources = sources | {wrapper: render(f"{wrapper}.j2", {})}
    kinds = {"reals": "Real", "integers": "Integer", "booleans": "Boolean"}
    counts: dict[str, Any] = {
        key: [v for v in variables if v.kind == kind] for key, kind in kinds.items()
    }
    setters = {"input": "INPUT", "parameter": "PARAMETER"}
    counts["setters"] = ", ".join(setters.get(v.causality, "FIXED") for v in variables)
    identity = repr((title, variables, sorted(sources.items()))).encode()
    token = "{" + hashlib.sha256(identity).hexdigest()[:32] + "}"
    sources["model.h"] = render("model.h.j2", {**values, **counts, "token": token})
    units = sorted(file for file in sources if file.endswith(".c"))
    model = FmuDescription(name, title, token, step, units)
    entries: dict[str, bytes] = {
        "modelDescription.xml": description(model, variables, version).encode()
    }
    entries |= {f"sources/{file}": text.encode() for file, text in sorted(sources.items())}
    if version == "3.0":
        entries["sources/buildDescription.xml"] = build_description(model).encode()
    binary, message = _binary(sources, name, version, entries)
    with Staging() if staging is None else nullcontext(staging) as staged:
        place = staged.file(path)
        try:
            with zipfile.ZipFile(place, "w", zipfile.ZIP_DEFLATED) as archive:
                for file, content in entries.items():
                    entry = zipfile.ZipInfo(file, _LONG_AGO)
                    archive.writestr(entry, content, zipfile.ZIP_DEFLATED)
        except OSError as error:
            raise unwritable("path", path, error) from None
    return ExportedFmu(path, version, binary, message)


def _binary(
    sources: dict[str, str], name: str, version: Version, entries: dict[str, bytes]
) -> tuple[str | None, str]:
    """Add the binary of this machine; return its path and a message, or why there is none."""
    system, machine = sys.platform, platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    if system not in _SUFFIX:
        return None, f"sources only: no name for binaries of {system} is known"
    folder = f"{machine}-{_SYSTEM[system]}"
    if version == "2.0":
        folder = _OLD_SYSTEM[system] + ("64" if sys.maxsize > 2**32 else "32")
    target = f"binaries/{folder}/{name}.{_SUFFIX[system]}"
    with tempfile.TemporaryDirectory() as place:
        for file, text in sources.items():
            (Path(place) / file).write_text(text, encoding="utf-8")
        units = [Path(place) / file for file in sorted(sources) if file.endswith(".c")]
        library = Path(place) / "library"
        # The standard prescribes arguments that this FMU does not need.
        options = ("-Wno-unused-parameter", "-fvisibility=hidden", "-fPIC", "-shared")
        complaint = compile_and_link(units, library, *options)
        if complaint is not None:
            return None, f"sources only: {complaint}"
        entries[target] = library.read_bytes()
    return target, f"sources and {target}"
