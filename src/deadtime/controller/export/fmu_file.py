"""The file of an FMU: description, sources, and a binary for this machine."""

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
from typing import Any

from deadtime.base.errors import ArgumentError
from deadtime.base.files import Staging, unwritable
from deadtime.base.version import __version__
from deadtime.controller.export.c_code import environment
from deadtime.controller.export.compiler import compile_and_link
from deadtime.controller.export.export_folder import require_suffix
from deadtime.controller.export.fmi_description import (
    FmuDescription,
    Variable,
    Version,
    build_description,
    description,
)

_LONG_AGO = (1980, 1, 1, 0, 0, 0)  # the same FMU twice is the same file
_SUFFIX = {"linux": "so", "darwin": "dylib", "win32": "dll"}
_SYSTEM = {"linux": "linux", "darwin": "darwin", "win32": "windows"}
_OLD_SYSTEM = {"linux": "linux", "darwin": "darwin", "win32": "win"}


@dataclass(frozen=True)
class ExportedFmu:
    """What was exported (immutable): the file, its version of FMI, and its binary, or None."""

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

    A half-written FMU is never seen; with `staging` it appears together with its others.
    """
    if version not in ("2.0", "3.0"):
        raise ArgumentError(f"version must be '2.0' or '3.0', got {version!r}.")
    require_suffix(path, ".fmu")
    wrapper = f"fmi{version[0]}.c"
    sources = sources | {wrapper: render(wrapper, {})}
    kinds = {"reals": "Real", "integers": "Integer", "booleans": "Boolean"}
    counts: dict[str, Any] = {
        key: [v for v in variables if v.kind == kind] for key, kind in kinds.items()
    }
    setters = {"input": "INPUT", "parameter": "PARAMETER"}
    counts["setters"] = ", ".join(setters.get(v.causality, "FIXED") for v in variables)
    told = repr((title, variables, sorted(sources.items()))).encode()
    token = "{" + hashlib.sha256(told).hexdigest()[:32] + "}"
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
        complaint = compile_and_link(units, library, *options)
        if complaint is not None:
            return None, f"sources only: {complaint}"
        entries[target] = library.read_bytes()
    return target, f"sources and {target}"
