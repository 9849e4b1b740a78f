"""`deadtime experiment`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from deadtime.base.errors import ArgumentError
from deadtime.cli import options
from deadtime.cli.application import BUILD, app, lines
from deadtime.cli.printing import output_file, print_answer, print_details, print_json, print_table

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from deadtime.identification import Experiment
    from deadtime.plant import OperatingPoint
    from deadtime.problems import Problem
    from deadtime.switching import SwitchingSignal


@app.command(
    group=BUILD,
    help_epilogue=lines(
        "deadtime experiment problem.toml --input-limit 1",
        "deadtime experiment problem.toml --input-limit 1 --state-limit 0.5,2",
        "deadtime experiment paper --input-limit 5 --law averaged --disturbance 1e-5",
    ),
)
def experiment(
    problem: Path,
    *,
    input_limit: str,
    state_limit: str | None = None,
    horizon: float | None = None,
    step: float | None = None,
    disturbance: str | None = None,
    noise: str | None = None,
    law: str | None = None,
    sojourn: float | None = None,
    hold: int = 1,
    seed: int = 0,
    out: Path = Path("experiment.csv"),
    json_output: options.AsJson = False,
) -> None:
    """Design the inputs whose log tells the delays of a plant best, as a CSV table.

    Parameters
    ----------
    problem
        A problem file, such as `deadtime identify` writes from a first log; or paper, three-mode,
        follower.
    input_limit
        What |u| must not exceed, one number or one for each input, with commas; where the problem
        has an operating point, u and x are deviations from it, and the table has absolute inputs.
    state_limit
        What |x| must not exceed, likewise, at three standard deviations of the noise.
    horizon
        Length of the experiment, seconds; the problem's by default.
    step
        Sampling period, seconds; the problem's by default.
    disturbance
        Intensity of the process noise, x² per second, one number or one for each state; that of
        the file's white-disturbance by default.
    noise
        Standard deviation of the sensors, one number or one for each state; that of the file's
        noise by default, 0 where it has none.
    law
        The law of the file to whose inputs those of the experiment are added; none by default.
    sojourn
        Take the modes in turn, each for so many seconds; by default the file's signal says.
    hold
        For how many periods each value is held at least.
    seed
        Of the search, and of the signal where the file draws it.
    out
        The table to write, CSV.
    """
    from deadtime.base.checks import positive
    from deadtime.identification import design_experiment
    from deadtime.problems.switching_assumptions import step_of

    out = output_file("out", out, kinds=(".csv",))
    chosen = options.problem_of(problem)
    period = step_of(chosen, step)
    length = chosen.horizon if horizon is None else positive("horizon", horizon)
    found = design_experiment(
        chosen.plant,
        length,
        period,
        options.one_or_several("input-limit", input_limit),
        disturbance=_disturbance(chosen, disturbance),
        noise=_noise(chosen, noise),
        signal=_signal(chosen, length, sojourn, seed),
        law=None if law is None else chosen.law(law),
        state_limit=None
        if state_limit is None
        else options.one_or_several("state-limit", state_limit),
        hold=hold,
        seed=seed,
    )
    found.to_csv(out, chosen.operating_point)
    if json_output:
        print_json(_record(found, chosen.operating_point), [out])
        return
    rows = f"{found.time.size:,} rows, every {period:.4g} s"
    answer, *details = found.sentences
    print_answer(answer, f"An experiment of {rows}", "")
    errors = zip(found.names, found.errors, strict=True)
    print_table(("", "standard error"), [(name, f"{error:.3g}") for name, error in errors])
    print()
    print_details([*_absolute(chosen, found), *details])
    print(f"\nWritten: {out}")


def _disturbance(problem: Problem, given: str | None) -> ArrayLike:
    from deadtime.imperfections import WhiteDisturbance

    if given is not None:
        return options.one_or_several("disturbance", given)
    if any(isinstance(one, WhiteDisturbance) for one in problem.imperfections):
        return options.process_noise(problem)
    raise ArgumentError(
        "disturbance must be given where the problem has no white-disturbance: the intensity of "
        "the process noise, x² per second, such as --disturbance 1e-3."
    )


def _noise(problem: Problem, given: str | None) -> ArrayLike:
    """The standard deviations of the sensors as given, or those of the file."""
    from deadtime.imperfections import Noise

    if given is not None:
        return options.one_or_several("noise", given)
    noisy = any(isinstance(one, Noise) for one in problem.imperfections)
    if noisy and problem.outputs:
        raise ArgumentError(
            "noise must be given where the problem measures outputs, as its own is of those: the "
            "standard deviations of the sensors of the states, such as --noise 0.01, or 0."
        )
    return options.sensor_variances(problem) ** 0.5 if noisy else 0.0


def _signal(
    problem: Problem, horizon: float, sojourn: float | None, seed: int
) -> SwitchingSignal | None:
    """The modes in turn, drawn from the file's model, or as its signal says."""
    from deadtime.switching import SwitchingSignal

    modes = problem.plant.modes
    if modes == 1:
        return None
    if sojourn is not None:
        return SwitchingSignal.periodic([sojourn] * modes, range(modes), horizon)
    if problem.switching is not None:
        return problem.switching.sample(horizon, seed)
    return problem.given_signal


def _absolute(problem: Problem, found: Experiment) -> list[str]:
    """A sentence on the table's inputs, where the plant does not rest at 0."""
    if problem.operating_point is None:
        return []
    where = problem.operating_point.in_words(problem.states, problem.inputs)
    table = "to be added to the law's" if found.added else "absolute"
    return [f"The plant rests at {where}; limits are about it, and inputs of the table {table}."]


def _record(found: Experiment, point: OperatingPoint | None) -> dict:
    return {
        "t": found.time,
        "inputs": found.sent(point),
        "mode": found.mode,
        "added": found.added,
        "delay_errors": dict(found.delay_errors),
        "errors": dict(zip(found.names, found.errors, strict=True)),
        "largest": found.largest,
        "sentences": list(found.sentences),
    }
