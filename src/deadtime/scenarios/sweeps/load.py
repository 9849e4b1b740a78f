"""Read a study file; every error names the file, the line and the key."""

from __future__ import annotations

import difflib
import hashlib
import tomllib
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deadtime.base.errors import ArgumentError, ProblemFileError, StudyFileError
from deadtime.problems import NAMED, Problem
from deadtime.problems.file import schema
from deadtime.problems.file.build import build_problem
from deadtime.problems.file.gains_and_laws import as_numbers
from deadtime.problems.templates import template
from deadtime.problems.toml import SectionError, read_toml, require_valid, section
from deadtime.scenarios.sweeps.axes import (
    AXES,
    DEFAULT,
    ORACLE,
    OVERWRITES,
    Draft,
    axis_of,
    kinds_of,
    path_of,
)
from deadtime.scenarios.sweeps.file_study import FileStudy, without_signal
from deadtime.scenarios.sweeps.schema import StudyFile, distinct, require_known
from deadtime.scenarios.sweeps.study import require_axis


class _Base(NamedTuple):
    """The problem of a study: its file as dictionaries, the file's path, and the problem."""

    draft: Draft
    path: Path
    problem: Problem


def load_study(path: str | PathLike[str]) -> FileStudy:
    """The study that a TOML file describes.

    Parameters
    ----------
    path : path
        The file; `studies/paper.toml` of the repository is a commented one to start from.

    Raises
    ------
    StudyFileError
        If the file is missing, is not TOML, has unknown keys or names, or its plant, poles and
        grid contradict each other. The message is one line.
    """
    source = Path(path)
    file, text = read_toml(source, StudyFile, StudyFileError)
    try:
        return _build(file, source, text.text)
    except SectionError as error:
        raise text.complaint(error) from None


def _build(file: StudyFile, source: Path, text: str) -> FileStudy:
    poles = _poles(file.poles)
    base = _base(file, source)
    grid = _grid(tomllib.loads(text)["grid"], file, base.draft)
    _require(file, base, grid)
    logs = base.draft.get("switching", {}).get("logs", [])
    study = FileStudy(
        title=file.title or source.stem,
        source=base.problem.source or base.problem.title,
        grid=grid,
        laws=(),
        scenarios=file.scenarios,
        seed=file.seed,
        metrics=tuple(file.metrics),
        text=text,
        problem=base.draft,
        path=base.path,
        poles=poles,
        files={
            log: hashlib.sha256((base.path.parent / log).read_bytes()).hexdigest() for log in logs
        },
    )
    return replace(study, laws=_laws(file.laws, study, base.problem.plant.modes))


def _base(file: StudyFile, source: Path) -> _Base:
    """The problem file that cells are made from, with the study's changes."""
    before = 0  # imperfections of the problem, which stand before the study's
    try:
        draft, path = _problem_file(file.problem, source)
        before = len(draft.get("imperfection", []))
        for name in ("horizon", "step"):
            if (value := getattr(file, name)) is not None:
                draft["run"][name] = value
        if file.poles is not None:
            # The laws are the study's own: one that costs nothing replaces the problem's.
            draft["gains"], draft["law"] = {"poles": file.poles}, [{"kind": "delayed"}]
        if file.cost is not None:
            draft["cost"] = file.cost.model_dump(exclude_unset=True)
        own = [section.model_dump(exclude_unset=True) for section in file.imperfection]
        if own:
            build_problem(_check(draft), path)
            draft["imperfection"] = [*draft.get("imperfection", []), *own]
        return _Base(draft, path, build_problem(_check(draft), path))
    except SectionError as error:
        raise _own_fault(error, file, before) from None
    except ValueError as error:
        raise SectionError(f"problem: {error}", ()) from None


def _own_fault(error: SectionError, file: StudyFile, before: int) -> SectionError:
    """A fault of the problem, reported under the key of the study that it comes from."""
    message, table = str(error), error.path[:1]
    if file.poles is not None and table == ("gains",):
        return SectionError(message if message.startswith("poles") else f"poles: {message}", ())
    if file.cost is not None and table == ("cost",):
        return SectionError(message, table)
    if table == ("imperfection",) and int(error.path[1]) >= before:
        return SectionError(message, ("imperfection", int(error.path[1]) - before))
    where = f"[{'.'.join(map(str, error.path))}] of " if error.path else ""
    return SectionError(f"problem: {where}{file.problem}: {message}", ())


def _check(draft: Draft) -> schema.ProblemFile:
    return without_signal(require_valid(schema.ProblemFile, draft))


def _problem_file(name: str, source: Path) -> tuple[Draft, Path]:
    """The draft and the path of a named problem, or of a file relative to the study's."""
    if name in NAMED or not Path(name).suffix:
        require_known("problem", name, tuple(NAMED))
        return tomllib.loads(template(name)), Path(f"{name}.toml")
    path = source.parent / name
    _, text = read_toml(path, schema.ProblemFile, ProblemFileError, "`deadtime init` writes one")
    return tomllib.loads(text.text), path.resolve()


def _require(file: StudyFile, base: _Base, grid: Mapping[str, tuple]) -> None:
    """Refuse problems that no sweep can run, and grids that contradict the problem."""
    problem, signal = base.problem, base.draft["signal"].get("kind")
    placed = file.poles is not None
    fixed = {
        "distance": ("A", "B"),
        "delay": ("delay",),
        "delay_error": ("delay",),
        "gain_error": ("B",),
    }
    overruled = [
        name
        for name, keys in fixed.items()
        if name in grid and any(key in base.draft.get("truth", {}) for key in keys)
    ]
    for wrong, message in (
        (problem.plant.modes < 2, "its plant has one mode: a study needs two."),
        (not problem.x0.any(), "its x0 is 0, from where every law stays at 0."),
        (signal in schema.RULES, "its state decides the mode: give it a signal."),
        (bool(np.any(problem.u0)), "its u0 must be 0, as all Monte Carlo runs have it."),
        (problem.predict != "applied", 'its predict must be "applied".'),
        (
            placed and "observer" in base.draft,
            "the laws that poles are for read the state, remove its [observer].",
        ),
        (
            placed and "servo" in base.draft,
            "the laws that poles are for follow no reference, remove its [servo].",
        ),
        (
            bool(overruled),
            f"its [truth] fixes what grid.{(overruled or [''])[0]} changes: remove it.",
        ),
        (
            "switching" not in base.draft
            and "dwell_time" not in grid
            and base.draft["signal"].get("dwell_time") is None,
            "it does not say how modes switch: give grid.dwell_time, or the file a [switching].",
        ),
    ):
        if wrong:
            raise SectionError(f"problem: {message}", ())
    if problem.step is None and "step" not in grid:
        raise SectionError("step must be given: the problem's loop is ideal.", ())
    if file.step is not None and "step" in grid:
        raise SectionError("step is given twice, here and in [grid]: remove one.", ())
    if file.horizon is not None and "horizon" in grid:
        raise SectionError("horizon is given twice, here and in [grid]: remove one.", ())
    if "sojourn" in grid and "dwell_time" not in grid:
        raise SectionError("sojourn needs dwell_time beside it.", ("grid",))


def _poles(given: list | None) -> tuple[complex, ...] | None:
    """The poles, checked for stability; whether gains can place them shows in the cells."""
    if given is None:
        return None
    try:
        poles = tuple(as_numbers(given))
    except ArgumentError as error:
        raise SectionError(str(error), ()) from None
    if max(pole.real for pole in poles) >= 0.0:
        raise SectionError(f"poles must lie left of the imaginary axis, got {given}.", ())
    return poles


def _laws(names: list[str] | None, study: FileStudy, modes: int) -> tuple[str, ...]:
    """The laws in their order; with poles the oracle is the last, the reference of regret."""
    placed = study.poles is not None
    try:
        able = tuple(kinds_of(modes)) if placed else study.own_laws
    except SectionError as error:
        where = f"[{'.'.join(map(str, error.path))}] of " if error.path else ""
        raise SectionError(f"problem: {where}{study.path.name}: {error}", ()) from None
    except ArgumentError as error:
        raise SectionError(str(error), ("grid",)) from None
    chosen = (DEFAULT if placed else able) if names is None else names
    try:
        laws = [require_known("law", name, able) for name in chosen]
    except ValueError as error:
        raise SectionError(f"laws: {error}", ()) from None
    if not laws:
        raise SectionError("laws must hold at least one law.", ())
    return (*(law for law in laws if law != ORACLE), ORACLE) if placed else tuple(laws)


def _grid(raw: Draft, file: StudyFile, draft: Draft) -> dict[str, tuple]:
    """Values by axis, in the order of the file."""
    checked = file.grid.model_dump(exclude_none=True)
    grid: dict[str, tuple] = {}
    for name, given in raw.items():
        if name in AXES:
            grid[name] = tuple(checked[name])
            continue
        for path, values in _flat(name, given):
            where = ("grid", *path.split("."))
            with section(*where):
                require_axis(path, list(grid))
            grid[path] = _values(path, values, draft)
    _require_no_overlap(grid, draft)
    return grid


def _require_no_overlap(grid: Mapping[str, tuple], draft: Draft) -> None:
    """Refuse paths that another axis overwrites, and paths that change nothing."""
    for path in (name for name in grid if name not in AXES):
        parts, where = path_of(path).split("."), ("grid", *path.split("."))
        vain = parts[0] in ("title", "source") or path == "run.seed"
        vain |= parts[0] == "law" and parts[-1] in ("kind", "name")
        vain |= parts[0] == "signal" and ("switching" in draft or "dwell_time" in grid)
        if vain:
            raise SectionError(f"{path} changes no result: remove it.", where)
        for name in grid:
            for own in OVERWRITES.get(name, ()):
                wide = own.split(".")
                if all(a in (b, "*") for a, b in zip(wide, parts, strict=False)):
                    raise SectionError(f"{path} is overwritten by {name}: keep one of them.", where)


def _flat(name: str, given: Any) -> list[tuple[str, Any]]:
    """Tables inside tables as dotted paths."""
    if not isinstance(given, dict):
        return [(name, given)]
    return [pair for key, inner in given.items() for pair in _flat(f"{name}.{key}", inner)]


def _values(path: str, given: Any, draft: Draft) -> tuple:
    """The values of an axis that is a path into the problem file, each checked in the file."""
    where = ("grid", *path.split("."))
    if "." not in path:
        known_paths = [leaf for leaf in _leaves(draft) if "." in leaf]
        near = difflib.get_close_matches(path, [*AXES, *known_paths], 1)
        advice = f"did you mean {near[0]}?" if near else f"known are {', '.join(AXES)}"
        raise SectionError(
            f"{path} is not known: {advice}; or a path into the problem file, such as run.horizon.",
            where,
        )
    try:
        values = distinct(given if isinstance(given, list) else [given])
    except ValueError as error:
        raise SectionError(f"{path}: {error}.", where) from None
    for value in values:
        # A copy of the section that the path leads into: the others are not written.
        head = path_of(path).split(".")[0]
        trial = draft | ({head: deepcopy(draft[head])} if head in draft else {})
        try:
            axis_of(path).write(trial, value)
            require_valid(schema.ProblemFile, trial)
        except ArgumentError as error:
            raise SectionError(str(error), where) from None
    return tuple(values)


def _leaves(draft: Any, path: str = "") -> list[str]:
    """Paths to the values of a problem file."""
    if not isinstance(draft, dict):
        return [path]
    return [
        leaf
        for key, value in draft.items()
        for leaf in _leaves(value, f"{path}.{key}" if path else key)
    ]
