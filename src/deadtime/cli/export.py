"""`deadtime export`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypedDict

from cyclopts import Parameter

from deadtime.base.errors import ArgumentError
from deadtime.cli import options
from deadtime.cli.application import BUILD, app, lines
from deadtime.cli.printing import print_json
from deadtime.controller.targets import TARGETS

if TYPE_CHECKING:
    from deadtime.controller import Controller
    from deadtime.feedback import Law
    from deadtime.problems import Problem

    Paths = dict[str, Path]
else:  # an option for every target
    Paths = TypedDict(
        "Paths",
        {key: Annotated[Path, Parameter(help=one.help)] for key, one in TARGETS.items()},
        total=False,
    )


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
    paths: Annotated[Paths | None, Parameter(name="*")] = None,
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

    A saturation of the problem limits the inputs. With an operating point, measurements and inputs
    are absolute values. Exit code 1 if the C fails its self-check.

    Parameters
    ----------
    single
        Single precision.
    accuracy
        Allowed error of a compressed table, relative to the sum of |coefficients| of the law.
    rom_budget
        Largest size of the tables, bytes.
    name
        Prefix of names and files in the C.
    prediction
        Also write the predicted state at the arrival of the input to the C: NAME_predict.
    fmi
        Version of FMI.
    """
    paths = paths or {}
    if prediction and "c" not in paths:
        raise ArgumentError("--prediction is for the C: give --c FOLDER, too.")
    if not paths:
        *some, last = (f"--{key.replace('_', '-')} {one.path}" for key, one in TARGETS.items())
        raise ArgumentError(f"nothing to write: give {', '.join(some)} or {last}.")
    from deadtime.base.files import Staging
    from deadtime.controller.export import Names
    from deadtime.reports.verdict import observer_reads_mode

    chosen = options.problem_of(problem)
    law_name, chosen_law = options.law_of(chosen, law)
    controller = _controller(chosen, chosen_law, step)
    given = Names(law_name, chosen.states, chosen.modes, chosen.inputs)
    names = given
    if chosen_law.outputs is not None:
        names = replace(given, outputs=chosen.outputs, tracked=chosen.tracked)
    with Staging() as staging:  # all files or none
        shared = {
            "precision": "float" if single else "double",
            "accuracy": accuracy,
            "names": names,
            "rom_budget": rom_budget,
            "name": name,
            "prediction": prediction,
            "version": fmi,
            "plant": chosen.plant,
            "plant_names": replace(given, title=f"Plant: {chosen.title}"),
            "x0": chosen.x0,
            "u0": chosen.u0,
            "staging": staging,
        }
        made = {
            key: one.write(controller, paths[key], shared)
            for key, one in TARGETS.items()
            if key in paths
        }
    if json_output:
        point = chosen.operating_point
        result: dict[str, Any] = {"law": law_name, "step": controller.step}
        result["operating_point"] = None if point is None else {"x": point.x, "u": point.u}
        result |= {key: one.facts for key, one in made.items()}
        print_json(result, [file for one in made.values() for file in one.files])
    else:
        print(f"{chosen.title}: law {law_name}, {_limits_in_words(controller)}{_built_in(chosen)}")
        for sentence in observer_reads_mode(chosen, [law_name]):
            print(sentence)
        for one in made.values():
            print(*one.lines, sep="\n")
    return 1 if any(one.passed is False for one in made.values()) else 0


def _built_in(problem: Problem) -> str:
    """A line on the operating point; empty without one."""
    point = problem.operating_point
    if point is None:
        return ""
    return (
        "\nMeasurements and inputs are absolute values: the operating point, "
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
    rest = 0.0 if point is None else point.u  # the file's limits are deviations from it
    clips = absolute_limits(problem.imperfections, Sizes.of(problem.plant, period))
    limits = None
    if clips:  # in series: their intersection
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
    pairs = (f"{a:g} to {b:g}" for a, b in zip(low.tolist(), high.tolist(), strict=True))
    return f"inputs limited to {' and '.join(pairs)}"
