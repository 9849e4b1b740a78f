"""The targets of `deadtime export`: an entry here is an option there, with its help and report."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from deadtime.base.json_records import record

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float
    from numpy.typing import ArrayLike

    from deadtime.base.files import Staging
    from deadtime.controller.export import ExportedFmu, Names
    from deadtime.controller.export.fmi_description import Version
    from deadtime.controller.export.forms import Precision
    from deadtime.controller.running import RunningLaw
    from deadtime.plant import SwitchedSystem


class ExportRequest(NamedTuple):
    """A controller, the plant that it is for, and the options of all targets.

    x0, u0, plant_names : what the plant begins with, as deviations, and what its FMU is called
    others : as in `Controller.export_c` and `Controller.export_fmu`
    """

    controller: RunningLaw
    names: Names
    plant: SwitchedSystem
    plant_names: Names
    x0: Float[np.ndarray, " n"]
    u0: ArrayLike
    precision: Precision
    accuracy: float | None
    rom_budget: int | None
    name: str
    prediction: bool
    fmi: Version
    staging: Staging

    def some(self, *names: str) -> dict[str, Any]:
        """Options by their names, those of every target among them."""
        return {name: getattr(self, name) for name in ("staging", *names)}


class Written(NamedTuple):
    """What a target wrote: a record of it, its files, lines for readers, and its self-check."""

    facts: Mapping[str, Any]
    files: Sequence[Path]
    lines: Sequence[str]
    passed: bool | None = None


class Target(NamedTuple):
    """A target: what its path is, in a word and in a sentence, and what writes it there."""

    path: str
    help: str
    write: Callable[[ExportRequest, Path], Written]


def _write_c(asked: ExportRequest, folder: Path) -> Written:
    from deadtime.controller.export import export_c

    own = asked.some("precision", "accuracy", "names", "rom_budget", "name", "prediction")
    made = export_c(asked.controller, folder, **own)
    facts = record(made, "folder", "files", "form", "rom", "ram", "error")
    facts |= {"passed": made.check.passed, "check": made.check.message}
    lines = (
        f"C, {asked.precision}: {made.folder}: {', '.join(made.files)}",
        f"  {made.form}\n  ROM {made.rom:,} bytes, RAM {made.ram:,} bytes",
        f"  self-check: {made.check.message}",
    )
    return Written(facts, [made.folder / name for name in made.files], lines, made.check.passed)


def _write_fmu(asked: ExportRequest, path: Path) -> Written:
    from deadtime.controller.export import export_fmu

    own = asked.some("precision", "accuracy", "names", "u0")
    return _fmu("controller", export_fmu(asked.controller, path, version=asked.fmi, **own))


def _write_plant_fmu(asked: ExportRequest, path: Path) -> Written:
    from deadtime.controller.export import export_plant_fmu

    periods = math.ceil(asked.plant.longest_delay / asked.controller.step)
    made = export_plant_fmu(
        asked.plant,
        path,
        version=asked.fmi,
        changes=max(4096, 2 * periods),
        names=asked.plant_names,
        operating_point=asked.controller.operating_point,
        **asked.some("x0", "u0"),
    )
    return _fmu("plant", made)


def _fmu(of: str, made: ExportedFmu) -> Written:
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
        "FILE",
        "FMU of the controller, a path in .fmu; replaced if it is there.",
        _write_fmu,
    ),
    "plant_fmu": Target(
        "FILE",
        "FMU of the plant with its delay, from the problem's x0 and u0; the same holds.",
        _write_plant_fmu,
    ),
}
