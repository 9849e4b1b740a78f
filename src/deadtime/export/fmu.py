"""`export_fmu`: a controller, and a plant with its delay, as FMUs for co-simulation."""

from __future__ import annotations

import hashlib
import os
import platform
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from deadtime.checks import bound, count, instance, real_array, shaped
from deadtime.errors import ArgumentError
from deadtime.export.c_code import c_sources, environment
from deadtime.export.compiler import compiled
from deadtime.export.files import require_suffix
from deadtime.export.fmi_description import (
    Model,
    Variable,
    Version,
    build_description,
    description,
)
from deadtime.export.forms import Precision
from deadtime.export.literals import brackets, initializer, literal
from deadtime.export.names import Names
from deadtime.plant import SwitchedSystem
from deadtime.version import __version__

if TYPE_CHECKING:
    from deadtime.controller import Controller

_LONG_AGO = (1980, 1, 1, 0, 0, 0)  # the same FMU twice is the same file
_SUFFIX = {"linux": "so", "darwin": "dylib", "win32": "dll"}
_SYSTEM = {"linux": "linux", "darwin": "darwin", "win32": "windows"}
_OLD_SYSTEM = {"linux": "linux", "darwin": "darwin", "win32": "win"}


@dataclass(frozen=True)
class ExportedFmu:
    """What was written (immutable): the file, its version of FMI, and the binary in it, or None."""

    path: Path
    version: str
    binary: str | None
    message: str

    def __str__(self) -> str:
        return f"{self.path}: FMI {self.version}; {self.message}"


def export_fmu(
    controller: Controller,
    path: str | Path,
    *,
    version: Version = "3.0",
    precision: Precision = "double",
    accuracy: float | None = None,
    u0: ArrayLike = 0.0,
    names: Names | None = None,
) -> ExportedFmu:
    """See `Controller.export_fmu`."""
    name, plant = "controller", controller.law.plant
    past, names = _finite(u0, plant.inputs), names or Names()
    texts, _ = c_sources(controller, precision, accuracy, None, name, names)
    kept = {file: texts[file] for file in (f"{name}.c", f"{name}.h", f"{name}_tables.h")}
    n, m = plant.states, plant.inputs
    variables = [
        Variable("time", "Real", "independent", "time, s"),
        *(
            Variable(
                f"x[{i}]", "Real", "input", _called("state at the sample", names.state(i - 1)), 0.0
            )
            for i in _from1(n)
        ),
        *(
            Variable(f"applied[{i}]", "Real", "input", "what the actuator had", 0.0)
            for i in _from1(m)
        ),
        *(
            Variable(f"u[{i}]", "Real", "output", "input, held", follows=f"u0[{i}]")
            for i in _from1(m)
        ),
        *(
            Variable(f"u0[{i}]", "Real", "parameter", "input before the start", float(past[i - 1]))
            for i in _from1(m)
        ),
        Variable(
            "mode", "Integer", "input", _called("mode at the sample, from 0", names.all_modes()), 0
        ),
        Variable("status", "Integer", "output", "what became of the last sample, 0: all is well"),
        Variable("mode_age", "Integer", "parameter", "age of the first mode, samples", 0),
        Variable("report_applied", "Boolean", "parameter", "whether applied is read", False),
    ]
    values = {
        "p": name,
        "begun": initializer(past, "double"),
        "slack": literal(1e-3 * controller.step, "double"),
        "include": (
            f'#include "{name}.h"\n\ntypedef struct {{\n    {name}_controller controller;\n'
            "    double start, next; /* of the samples */\n"
            f"    {name}_real past[{name.upper()}_TAPS * {name.upper()}_INPUTS];\n}} memory;"
        ),
    }
    sources = kept | {"model.c": _rendered("controller_model.c.j2", values)}
    title = f"Controller: {names.title or controller.law.label}"
    return _write(Path(path), version, name, title, controller.step, variables, sources, values)


def export_plant_fmu(
    plant: SwitchedSystem,
    path: str | Path,
    *,
    x0: ArrayLike | None = None,
    u0: ArrayLike = 0.0,
    version: Version = "3.0",
    changes: int = 4096,
    names: Names | None = None,
) -> ExportedFmu:
    """Write a plant with its input delay as an FMU for co-simulation.

    Its inputs are u and the mode, held over a step of any length; its outputs the state. Inputs
    arrive exactly D later, on the grid of the steps or off it: the state is exact to round-off.
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
        How often the input may change within the delay: more than D / h.
    names : Names, optional
        Of states and modes, for the descriptions.

    Raises
    ------
    ArgumentError
        If the file cannot be written.
    """
    instance("plant", plant, SwitchedSystem)
    n, m, name, names = plant.states, plant.inputs, "plant", names or Names()
    names.require(n, plant.modes)
    past = _finite(u0, m)
    start = (
        np.zeros(n) if x0 is None else shaped("x0", real_array("x0", x0, "(n,)", 1), (n,), "(n,)")
    )
    variables = [
        Variable("time", "Real", "independent", "time, s"),
        *(Variable(f"u[{i}]", "Real", "input", "input, held over a step", 0.0) for i in _from1(m)),
        *(
            Variable(
                f"x[{i}]", "Real", "output", _called("state", names.state(i - 1)), None, f"x0[{i}]"
            )
            for i in _from1(n)
        ),
        *(
            Variable(f"x0[{i}]", "Real", "parameter", "state at the start", float(start[i - 1]))
            for i in _from1(n)
        ),
        *(
            Variable(f"u0[{i}]", "Real", "parameter", "input before the start", float(past[i - 1]))
            for i in _from1(m)
        ),
        Variable(
            "mode", "Integer", "input", _called("mode over a step, from 0", names.all_modes()), 0
        ),
    ]
    size = count("changes", changes, 2)
    values = {
        "delay": literal(plant.delay, "double"),
        "slack": literal(1e-6 * plant.delay, "double"),
        "include": (
            f"enum {{ N = {n}, M = {m}, MODES = {plant.modes}, CHANGES = {size} }};\n\n"
            "typedef struct {\n    int first, count; /* of the inputs that have not passed */\n"
            "    double began[CHANGES];\n    double u[CHANGES][M];\n} memory;"
        ),
        "tables": [
            {"name": key, "shape": brackets(array), "text": initializer(array, "double")}
            for key, array in (("A", plant.A), ("B", plant.B), ("START", start), ("PAST", past))
        ],
    }
    sources = {"model.c": _rendered("plant_model.c.j2", values)}
    title = names.title or f"Plant with a delay of {plant.delay:g} s"
    return _write(Path(path), version, name, title, None, variables, sources, values)


def _from1(size: int) -> range:
    return range(1, size + 1)


def _called(what: str, name: str) -> str:
    return f"{what}: {name}" if name else what


def _rendered(template: str, values: dict) -> str:
    return environment("fmu").get_template(template).render(values | {"version": __version__})


def _finite(u0: ArrayLike, m: int) -> np.ndarray:
    """A constant input for each of m."""
    past = bound("u0", u0, m)
    return real_array("u0", past, "(m,)", 1)


def _write(
    path: Path,
    version: Version,
    name: str,
    title: str,
    step: float | None,
    variables: Sequence[Variable],
    sources: dict[str, str],
    values: dict,
) -> ExportedFmu:
    """Zip description, sources and, where there is a compiler, a binary for this machine."""
    if version not in ("2.0", "3.0"):
        raise ArgumentError(f"version must be '2.0' or '3.0', got {version!r}.")
    require_suffix(path, ".fmu")
    wrapper = f"fmi{version[0]}.c"
    sources = sources | {wrapper: _rendered(wrapper, {})}
    kinds = {"reals": "Real", "integers": "Integer", "booleans": "Boolean"}
    counts: dict[str, Any] = {
        key: [v for v in variables if v.kind == kind] for key, kind in kinds.items()
    }
    setters = {"input": "INPUT", "parameter": "PARAMETER"}
    counts["setters"] = ", ".join(setters.get(v.causality, "FIXED") for v in variables)
    told = repr((title, variables, sorted(sources.items()))).encode()
    token = "{" + hashlib.sha256(told).hexdigest()[:32] + "}"
    sources["model.h"] = _rendered("model.h.j2", {**values, **counts, "token": token})
    units = sorted(file for file in sources if file.endswith(".c"))
    model = Model(name, title, token, step, units)
    entries: dict[str, bytes] = {
        "modelDescription.xml": description(model, variables, version).encode()
    }
    entries |= {f"sources/{file}": text.encode() for file, text in sorted(sources.items())}
    if version == "3.0":
        entries["sources/buildDescription.xml"] = build_description(model).encode()
    binary, message = _binary(sources, name, version, entries)
    beside = path.with_name(f".{path.name}.{os.getpid()}")  # a half-written FMU is never seen
    try:
        with zipfile.ZipFile(beside, "w", zipfile.ZIP_DEFLATED) as archive:
            for file, content in entries.items():
                archive.writestr(zipfile.ZipInfo(file, _LONG_AGO), content, zipfile.ZIP_DEFLATED)
        beside.replace(path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        why = error.strerror
        raise ArgumentError(f"path {str(path)!r} cannot be written: {why}.") from None
    return ExportedFmu(path, version, binary, message)


def _binary(
    sources: dict[str, str], name: str, version: Version, entries: dict[str, bytes]
) -> tuple[str | None, str]:
    """Add the binary of this machine, and say so; or why there is none."""
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
        options = ("-Wno-unused-parameter", "-fvisibility=hidden", "-fPIC", "-shared")
        complaint = compiled(units, library, *options)
        if complaint is not None:
            return None, f"sources only: {complaint}"
        entries[target] = library.read_bytes()
    return target, f"sources and {target}"
