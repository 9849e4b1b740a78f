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
    """Design inputs whose log identifies the delays of a plant best, as a CSV table.

    Parameters
    ----------
    problem
        A problem file, such as `deadtime identify` writes from a first log; or paper, three-mode,
        follower.
    input_limit
        Bound of |u|, one number or one for each input, separated by commas; where the problem has
        an operating point, u and x are deviations from it, and the table has absolute inputs.
    state_limit
        Bound of |x|, likewise, at three standard deviations of the noise.
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
        The law of the file to which the inputs of the experiment are added; none by default.
    sojourn
        Visit the modes in turn, each for this many seconds; by default as in the file's signal.
    hold
        Least number of periods for which a value is held.
    seed
        Seed of the search, and of the signal where the file draws it.
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
    result = design_experiment(
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
    result.to_csv(out, chosen.operating_point)
    if json_output:
        print_json(_record(result, chosen.operating_point), [out])
        return
    rows = f"{result.time.size:,} rows, every {period:.4g} s"
    answer, *details = result.sentences
    print_answer(answer, f"An experiment of {rows}", "")
    errors = zip(result.names, result.errors, strict=True)
    print_table(("", "standard error"), [(name, f"{error:.3g}") for name, error in errors])
    print()
    print_details([*_absolute(chosen, result), *details])
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
            "noise must be given where the problem measures outputs: the standard deviations of "
            "the sensors of the states, such as --noise 0.01, or 0."
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


def _absolute(problem: Problem, result: Experiment) -> list[str]:
    """A sentence on the table's inputs, where the problem has an operating point."""
    if problem.operating_point is None:
        return []
    where = problem.operating_point.in_words(problem.states, problem.inputs)
    table = "to be added to the law's" if result.added else "absolute"
    return [f"The plant rests at {where}; limits are deviations from it, table inputs are {table}."]


def _record(result: Experiment, point: OperatingPoint | None) -> dict:
    return {
        "t": result.time,
        "inputs": result.sent(point),
        "mode": result.mode,
        "added": result.added,
        "delay_errors": dict(result.delay_errors),
        "errors": dict(zip(result.names, result.errors, strict=True)),
        "largest": result.largest,
        "sentences": list(result.sentences),
    }
