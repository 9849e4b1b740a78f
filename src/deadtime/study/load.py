"""Read a study file; every error names the file, the line and the key."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from deadtime.errors import ArgumentError, StudyFileError
from deadtime.gains import place
from deadtime.imperfections import Sizes
from deadtime.problem_file import load_problem
from deadtime.problem_file.imperfections import build_imperfections
from deadtime.problems import NAMED, Problem
from deadtime.study.laws import DEFAULT, ORACLE, kinds_of
from deadtime.study.schema import StudyFile, known
from deadtime.study.study import AXES, OPTIONAL, Study
from deadtime.toml_file import SectionError, read_toml


def load_study(path: str | PathLike[str]) -> Study:
    """The study that a TOML file describes.

    Parameters
    ----------
    path : path
        The file; `studies/paper.toml` of the repository is a commented one to start from.

    Raises
    ------
    StudyFileError
        If the file is missing, is not TOML, has unknown keys or names, or its plant, poles and
        grid do not hold together. The message is one line.
    """
    source = Path(path)
    file, text = read_toml(source, StudyFile, StudyFileError)
    try:
        return _build(file, source, text.text)
    except SectionError as error:
        raise text.complaint(error) from None


def _build(file: StudyFile, source: Path, text: str) -> Study:
    problem = _problem(file.problem, source)
    poles = _poles(file, problem)
    return Study(
        title=file.title or source.stem,
        source=problem.source or problem.title,
        plant=problem.plant,
        poles=poles,
        laws=_laws(file.laws, problem.plant.modes),
        x0=problem.x0,
        horizon=file.horizon if file.horizon is not None else problem.horizon,
        step=_step(file, problem),
        scenarios=file.scenarios,
        seed=file.seed,
        grid=_grid(file, problem),
        text=text,
        imperfections=(
            *problem.imperfections,
            *build_imperfections(file.imperfection, _sizes(problem, file)),
        ),
    )


def _problem(name: str, source: Path) -> Problem:
    """The named problem, or that of a file relative to the study's."""
    try:
        problem = _named_problem(name, source)
    except ValueError as error:
        raise SectionError(f"problem: {error}", ()) from None
    if problem.plant.modes < 2:
        raise SectionError("problem: its plant has one mode: a study needs two.", ())
    if problem.model is not None:
        raise SectionError("problem: a study makes its own plants, remove its [truth].", ())
    if any(law.outputs is not None for law in problem.laws.values()):
        raise SectionError(
            "problem: the laws of a study read the state, remove its [observer].", ()
        )
    if not problem.x0.any():
        raise SectionError("problem: its x0 is 0, from where every law stays at 0.", ())
    return problem


def _named_problem(name: str, source: Path) -> Problem:
    if name in NAMED or not Path(name).suffix:
        return NAMED[known("problem", name, tuple(NAMED))]()
    return load_problem(source.parent / name)


def _poles(file: StudyFile, problem: Problem) -> tuple[complex, ...]:
    """The poles, if gains exist that place them for the problem's own plant."""
    try:
        poles = tuple(complex(pole) for pole in file.poles)
    except ValueError:
        raise SectionError(
            f'poles must be numbers, or text such as "-1+2j", got {file.poles}.', ()
        ) from None
    if max(pole.real for pole in poles) >= 0.0:
        raise SectionError(f"poles must lie left of the imaginary axis, got {file.poles}.", ())
    try:
        place(problem.plant, poles)
    except ArgumentError as error:
        text = str(error)
        raise SectionError(text if text.startswith("poles") else f"poles: {text}", ()) from None
    return poles


def _step(file: StudyFile, problem: Problem) -> float:
    """The sampling period of cells, where the grid lists none."""
    if file.grid.step is not None:
        if file.step is not None:
            raise SectionError("step is given twice, here and in [grid]: remove one.", ())
        return file.grid.step[0]
    step = problem.step if file.step is None else file.step
    if step is None:
        raise SectionError("step must be given: the problem's loop is ideal.", ())
    return step


def _sizes(problem: Problem, file: StudyFile) -> Sizes:
    """Those of every cell, with the shortest of the periods."""
    plant, step = problem.plant, min(file.grid.step or [_step(file, problem)])
    return Sizes(plant.modes, plant.states, plant.inputs, step)


def _laws(names: list[str] | None, modes: int) -> tuple[str, ...]:
    """The laws in their order, the oracle last: regret is measured against it."""
    chosen = list(DEFAULT) if names is None else names
    try:
        laws = [known("law", name, tuple(kinds_of(modes))) for name in chosen]
    except ValueError as error:
        raise SectionError(f"laws: {error}", ()) from None
    return (*(law for law in laws if law != ORACLE), ORACLE)


def _grid(file: StudyFile, problem: Problem) -> dict[str, tuple]:
    """Values by axis, in the order of `AXES`."""
    given = file.grid.model_dump(exclude_none=True)
    values = {"delay": [problem.plant.delay]} | given
    return {name: tuple(values[name]) for name in AXES if name in values or name not in OPTIONAL}
