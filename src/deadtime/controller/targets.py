"""The targets of `deadtime export`: each entry is an option, with its help and its report."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from deadtime.controller.export import ExportedFmu
    from deadtime.controller.running import RunningLaw


class Written(NamedTuple):
    """The output of a target: facts as a record and in words, its files, its self-check."""

    facts: Mapping[str, Any]
    files: Sequence[Path]
    lines: Sequence[str]
    passed: bool | None = None


class Target(NamedTuple):
    """A target: its path in a word, its help, and the function that writes it.

    `write` receives the options of `export_c`, `export_fmu` and `export_plant_fmu` together, by
    name, and uses its own.
    """

    path: str
    help: str
    write: Callable[[RunningLaw, Path, Mapping[str, Any]], Written]


def _some(options: Mapping[str, Any], *names: str) -> dict[str, Any]:
    return {name: options[name] for name in ("staging", *names)}


def _write_c(controller: RunningLaw, folder: Path, options: Mapping[str, Any]) -> Written:
    from deadtime.base.json_records import record
    from deadtime.controller.export import export_c

    own = _some(options, "precision", "accuracy", "names", "rom_budget", "name", "prediction")
    made = export_c(controller, folder, **own)
    facts = record(made, "folder", "files", "form", "rom", "ram", "error")
    facts |= {"passed": made.check.passed, "check": made.check.message}
    lines = (
        f"C, {own['precision']}: {made.folder}: {', '.join(made.files)}",
        f"  {made.form}\n  tables (ROM) {made.rom:,} bytes, state (RAM) {made.ram:,} bytes",
        f"  self-check: {made.check.message}",
    )
    return Written(facts, [made.folder / name for name in made.files], lines, made.check.passed)


def _write_fmu(controller: RunningLaw, path: Path, options: Mapping[str, Any]) -> Written:
    from deadtime.controller.export import export_fmu

    own = _some(options, "precision", "accuracy", "names", "version", "u0")
    return _fmu("controller", export_fmu(controller, path, **own))


def _write_plant_fmu(controller: RunningLaw, path: Path, options: Mapping[str, Any]) -> Written:
    from deadtime.controller.export import export_plant_fmu

    plant, point = options["plant"], controller.operating_point
    changes = max(4096, 2 * math.ceil(plant.longest_delay / controller.step))
    own = _some(options, "version", "x0", "u0") | {"names": options["plant_names"]}
    made = export_plant_fmu(plant, path, changes=changes, operating_point=point, **own)
    return _fmu("plant", made)


def _fmu(of: str, made: ExportedFmu) -> Written:
    from deadtime.base.json_records import record

    facts = record(made, "path", "version", "binary")
    return Written(facts, [made.path], [f"FMU of the {of}: {made}"])


TARGETS: Mapping[str, Target] = {
    "c": Target(
        "FOLDER",
        "Folder for the C: made if it is not there. Files in it that deadtime wrote are replaced; "
        'one that lacks "Written by deadtime" is not, and nothing is written.',
        _write_c,
    ),
    "fmu": Target(
        "FILE", "FMU of the controller, a path in .fmu; replaced if it is there.", _write_fmu
    ),
    "plant_fmu": Target(
        "FILE",
        "FMU of the plant with its delay, from the problem's x0 and u0; the same holds.",
        _write_plant_fmu,
    ),
}
