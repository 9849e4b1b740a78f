"""Studies from files: every cell is the problem file with the cell's values written into it."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from deadtime.base.errors import ArgumentError, DeadtimeError
from deadtime.feedback import Law
from deadtime.gains import place
from deadtime.plant import Weight
from deadtime.problems import Problem
from deadtime.problems.file import schema
from deadtime.problems.file.build import build_problem
from deadtime.problems.file.estimators import build_mode_filter
from deadtime.problems.file.gains_and_laws import as_numbers
from deadtime.problems.file.load import build_what_can
from deadtime.problems.file.switching import drawn_as, promise_of
from deadtime.problems.law_registry import LawSetting
from deadtime.problems.switching_assumptions import random_model
from deadtime.problems.toml import require_valid, section
from deadtime.scenarios.sweeps.axes import AXES, COARSE, INPUT_WEIGHT, Draft, axis_of, kinds_of
from deadtime.scenarios.sweeps.study import Cell, Loop, Study
from deadtime.switching import SwitchingModel

_TRIES = 100  # cells that are looked at for one where every law can be built


@dataclass(frozen=True, eq=False, kw_only=True)
class FileStudy(Study):
    """A study from a file, over a problem file (immutable).

    Attributes
    ----------
    problem : mapping
        The problem file with the study's changes.
    path : Path
        Its place, from which relative paths start.
    poles : tuple of complex, or None
        Closed-loop poles of every cell's modes, and of their mean, for the laws of
        `deadtime.scenarios.sweeps.axes`; None: the problem's own gains and laws run.
    files : mapping
        From the logs that the problem reads to their digests.
    """

    problem: Mapping[str, Any]
    path: Path
    poles: tuple[complex, ...] | None = None
    files: Mapping[str, str]

    def particulars(self) -> dict[str, Any]:
        poles = None if self.poles is None else [str(pole) for pole in self.poles]
        texts = ("title", "source")
        problem = {name: value for name, value in self.problem.items() if name not in texts}
        return {"poles": poles, "problem": problem, "files": dict(self.files)}

    @cached_property
    def base(self) -> Problem:
        """The problem of the file, before anything of the grid is written into it."""
        return build_problem(
            without_signal(require_valid(schema.ProblemFile, dict(self.problem))), self.path
        )

    @cached_property
    def own_laws(self) -> tuple[str, ...]:
        """Names of all laws of the problem file, in a cell where all can be built."""
        fault: ArgumentError | None = None
        for cell in itertools.islice(self.cells(), _TRIES):
            try:
                file = require_valid(schema.ProblemFile, self.draft(cell))
                return tuple(build_problem(without_signal(file), self.path).laws)
            except ArgumentError as error:
                fault = fault or error
        raise fault or ArgumentError("grid must hold at least one cell.")

    def draft(self, cell: Cell) -> Draft:
        """The problem file of a cell."""
        draft = deepcopy(dict(self.problem))
        ordered = [name for name in AXES if name in cell.values]
        # Paths first: named axes change the plant that paths have set.
        for name in [*(name for name in cell.values if name not in AXES), *ordered]:
            axis_of(name).write(draft, cell.values[name])
        return draft

    def loop(self, cell: Cell) -> Loop:
        file, problem, failed = build_what_can(self.draft(cell), self.path, without_signal)
        names = list(self.own_laws if self.poles is None else self.laws)
        reasons = {names[i]: why for i, why in failed.items()}
        names = [name for i, name in enumerate(names) if i not in failed]
        model = _model(file, problem.plant.modes, self.path.parent)
        if self.poles is None:
            laws = dict(zip(names, problem.laws.values(), strict=True))
            laws = {name: laws[name] for name in self.laws if name in laws}
            reasons = {name: why for name, why in reasons.items() if name in self.laws}
        else:
            laws, reasons = self._place_laws(file, problem, model, cell.values.get("dwell_time"))
        if problem.step is None:
            raise ArgumentError('step = "ideal" has no samples: give the study a step.')
        return Loop(
            problem.plant,
            laws,
            drawn_as(model, promise_of(file, model, problem.plant.modes), problem.step),
            problem.x0,
            problem.horizon,
            problem.step,
            problem.imperfections,
            reasons,
            problem.weight,
        )

    def _place_laws(
        self,
        file: schema.ProblemFile,
        problem: Problem,
        model: SwitchingModel,
        dwell_time: float | None,
    ) -> tuple[dict[str, Law], dict[str, str]]:
        """The study's laws for gains placed at its poles; and the faults of other laws."""
        plant = problem.model or problem.plant
        poles = as_numbers(file.gains.poles or [])
        mean_gain = place(plant.mean(), poles)[0]
        setting = LawSetting(
            plant=plant,
            gains=problem.gains,
            mean_gain=lambda _: mean_gain,
            period=max(problem.step or 0.0, plant.longest_delay / COARSE),
            model=model,
            weight=problem.weight or Weight(1.0, INPUT_WEIGHT),
            mode_filter=build_mode_filter(file.mode_filter, plant, model, problem.step, None),
        )
        laws, reasons = {}, {}
        kinds = kinds_of(plant.modes)
        for name in self.laws:
            try:
                laws[name] = kinds[name].make(setting, dwell_time)
            except DeadtimeError as error:
                reasons[name] = str(error)
        return laws, reasons


def without_signal(file: schema.ProblemFile) -> schema.ProblemFile:
    """The file with a constant signal, which costs nothing: runs draw their own."""
    signal = schema.ConstantSignal(kind="constant", mode=0)
    return file.model_copy(update={"signal": signal})


def _model(file: schema.ProblemFile, modes: int, folder: Path) -> SwitchingModel:
    """[switching], or the sojourns of a random signal."""
    if file.switching is not None:
        with section("switching"):
            return file.switching.model(modes, folder)
    signal = file.signal
    if isinstance(signal, schema.RandomSignal) and signal.dwell_time is not None:
        own = promise_of(file, None, modes).limits(modes)
        return random_model(own, signal.mean_sojourn)
    raise ArgumentError(
        "a study draws its signals: give grid.dwell_time, or the problem file a [switching] "
        "section."
    )
