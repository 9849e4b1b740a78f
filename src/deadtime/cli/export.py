"""`deadtime export`."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from deadtime.base.errors import ArgumentError
from deadtime.cli import options
from deadtime.cli.application import BUILD, app, lines
from deadtime.cli.printing import print_json

if TYPE_CHECKING:
    from deadtime.controller import Controller
    from deadtime.feedback import Law
    from deadtime.problems import Problem

_FMU = ("path", "version", "binary")


@app.command(
    group=BUILD,
    help_epilogue=lines(
        "deadtime export problem.toml --c out/",
        "deadtime export paper --law mean --c out/ --float",
        "deadtime export paper --fmu law.fmu --plant-fmu plant.fmu",
    ),
)
def export(
    problem: options.ProblemFile,
    *,
    c: Path | None = None,
    fmu: Path | None = None,
    plant_fmu: Path | None = None,
    law: options.FirstLaw = None,
    step: options.Step = None,
    single: Annotated[bool, Parameter(name="--float", negative="", show_default=False)] = False,
    accuracy: float | None = None,
    rom_budget: int | None = None,
    name: str = "controller",
    prediction: Annotated[bool, Parameter(negative="", show_default=False)] = False,
    fmi: Literal["3.0", "2.0"] = "3.0",
    json_output: options.AsJson = False,
) -> int:
    """Write a law of a problem as C99, as an FMU, or both.

    The inputs are limited where the problem has a saturation. What is written takes and gives
    absolute values where the problem has an operating point. Exit code 1 if the C fails its
    self-check.

    Parameters
    ----------
    c
        Folder for the C: made if it is not there. Files in it that deadtime wrote are replaced;
        one that lacks "Written by deadtime" is not, and nothing is written.
    fmu
        FMU of the controller, a path in .fmu; replaced if it is there.
    plant_fmu
        FMU of the plant with its delay, from the problem's x0 and u0; the same holds.
    single
        Single precision.
    accuracy
        What a dense table may lose to take less room, of the sum of the moduli of a row's taps.
    rom_budget
        Bytes that the tables may take.
    name
        Prefix of names and files in the C.
    prediction
        Let the C say, too, which state its input will meet: NAME_predict.
    fmi
        Version of FMI.
    """
    if prediction and c is None:
        raise ArgumentError("--prediction is for the C: give --c FOLDER, too.")
    if c is None and fmu is None and plant_fmu is None:
        raise ArgumentError("nothing to write: give --c FOLDER, --fmu FILE or --plant-fmu FILE.")
    from deadtime.base.files import Staging
    from deadtime.base.json_records import record
    from deadtime.controller.export import Names, export_c, export_fmu, export_plant_fmu
    from deadtime.reports.verdict import observer_reads_mode

    chosen = options.problem_of(problem)
    called, asked = options.law_of(chosen, law)
    controller = _controller(chosen, asked, step)
    precision = "float" if single else "double"
    given = Names(called, chosen.states, chosen.modes, chosen.inputs)
    names = given
    if asked.outputs is not None:
        names = replace(given, outputs=chosen.outputs, tracked=chosen.tracked)
    shared: dict[str, Any] = {"precision": precision, "accuracy": accuracy, "names": names}
    code = law_fmu = model = None
    with Staging() as staging:  # all that is asked for, or nothing
        if c is not None:
            own: dict[str, Any] = {"rom_budget": rom_budget, "name": name, "prediction": prediction}
            code = export_c(controller, c, staging=staging, **own, **shared)
        if fmu is not None:
            law_fmu = export_fmu(
                controller, fmu, version=fmi, u0=chosen.u0, staging=staging, **shared
            )
        if plant_fmu is not None:
            model = export_plant_fmu(
                chosen.plant,
                plant_fmu,
                x0=chosen.x0,
                u0=chosen.u0,
                version=fmi,
                changes=max(4096, 2 * math.ceil(chosen.plant.longest_delay / controller.step)),
                names=replace(given, title=f"Plant: {chosen.title}"),
                operating_point=chosen.operating_point,
                staging=staging,
            )
    if json_output:
        point = chosen.operating_point
        told: dict[str, Any] = {"law": called, "step": controller.step}
        told["operating_point"] = None if point is None else {"x": point.x, "u": point.u}
        if code is not None:
            parts = record(code, "folder", "files", "form", "rom", "ram", "error")
            told["c"] = parts | {"passed": code.check.passed, "check": code.check.message}
        fmus = {"fmu": law_fmu, "plant_fmu": model}
        told |= {key: record(one, *_FMU) for key, one in fmus.items() if one is not None}
        written = [] if code is None else [Path(code.folder) / name for name in code.files]
        print_json(told, [*written, *(Path(told[key]["path"]) for key in fmus if key in told)])
    else:
        print(f"{chosen.title}: law {called}, {_limits_in_words(controller)}{_built_in(chosen)}")
        for sentence in observer_reads_mode(chosen, [called]):
            print(sentence)
        if code is not None:
            print(f"C, {precision}: {code.folder}: {', '.join(code.files)}")
            print(f"  {code.form}\n  ROM {code.rom:,} bytes, RAM {code.ram:,} bytes")
            print(f"  self-check: {code.check.message}")
        for of, fmu_file in (("controller", law_fmu), ("plant", model)):
            if fmu_file is not None:
                print(f"FMU of the {of}: {fmu_file}")
    return 1 if code is not None and code.check.passed is False else 0


def _built_in(problem: Problem) -> str:
    """A line that says of what is written that it takes absolute values, where it does."""
    point = problem.operating_point
    if point is None:
        return ""
    return (
        "\nWhat is measured goes in and inputs come out as absolute values: the operating point, "
        f"{point.in_words(problem.states, problem.inputs)}, is built in."
    )


def _controller(problem: Problem, law: Law, step: float | None) -> Controller:
    """The controller of a law of the problem, within the limits of its inputs."""
    import numpy as np

    from deadtime.controller import Controller
    from deadtime.imperfections import Sizes
    from deadtime.problems.file.servo import absolute_limits
    from deadtime.problems.switching_assumptions import step_of

    period = step_of(problem, step)
    point = problem.operating_point
    rest = 0.0 if point is None else point.u  # of which the file's limits are deviations
    clips = absolute_limits(problem.imperfections, Sizes.of(problem.plant, period))
    limits = None
    if clips:  # one after the other: what all of them allow
        low, high = np.max([low for low, _ in clips], axis=0), np.min([h for _, h in clips], axis=0)
        if (low > high).any():
            raise ArgumentError("the problem's saturations have no input in common.")
        limits = (low + rest, high + rest)
    return Controller(law, period, limits=limits, operating_point=point)


def _limits_in_words(controller: Controller) -> str:
    import numpy as np

    low, high = controller.limits
    if np.isinf(low).all() and np.isinf(high).all():
        return "no limits of the inputs"
    return f"inputs within {low.tolist()} and {high.tolist()}"
