"""`deadtime design`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from deadtime.base.errors import ArgumentError
from deadtime.cli import options
from deadtime.cli.application import BUILD, app, lines
from deadtime.cli.printing import (
    PICTURES,
    output_file,
    print_answer,
    print_json,
    print_table,
    progress_bar,
    require_name,
    save_figure,
)

if TYPE_CHECKING:
    from deadtime.problems import Problem
    from deadtime.synthesis import Design, InitialStates, StationaryNoise

Kind = Literal["averaged", "mean"]


@app.command(
    group=BUILD,
    help_epilogue=lines(
        "deadtime design follower --delay-margin 0.05",
        "deadtime design problem.toml --delay-margin 0.02 --mode 0 --out mode0",
        "deadtime design follower --decay-rate 1.5 --input-limit 3 --initial 0.5,1,1",
        "deadtime design problem.toml --input-limit 3 --noise --probability 0.95",
    ),
)
def design(
    problem: options.ProblemFile,
    *,
    delay_margin: float | None = None,
    law: Kind = "averaged",
    mode: str | None = None,
    step: options.Step = None,
    longest_step: float | None = None,
    decay_rate: float = 0.0,
    input_limit: str | None = None,
    initial: str | None = None,
    probability: float | None = None,
    noise: options.Flag = False,
    filtered: Annotated[bool | None, Parameter(negative="--unfiltered")] = None,
    budget: int = 800,
    out: options.Folder = Path("design"),
    json_output: options.AsJson = False,
) -> int:
    """Design gains and a law with a delay margin in every constant mode, at low cost.

    Writes OUT.toml, to be pasted into the problem file, and the chart OUT.png. Exit code 1 if the
    margin, the decay rate or the input limit is not reached.

    Parameters
    ----------
    delay_margin
        Delay error to be tolerated, as a fraction of the model's delay, not in seconds: 0.05 for
        ±5 %. Several delays err alike, by this fraction of the shortest. None by default.
    law
        The family of laws: averaged, or mean with the mean of the gains.
    mode
        Design one mode alone, by its number or name, for its own exact law; all modes by default.
    longest_step
        Allow longer periods, up to this, seconds.
    decay_rate
        Least decay rate of every constant mode, in 1/s.
    input_limit
        Bound of |u|, one number or one for each input, separated by commas.
    initial
        Initial states for which |u| stays below --input-limit: one number for every |x(0)| up to
        it, or half the width of a box for each state, separated by commas; 1 by default.
    probability
        Probability that |u| stays below --input-limit, for a normal x(0) whose standard deviations
        --initial gives; with --noise the fraction of the time, 0.99 by default.
    noise
        Bound |u| under the stationary noise of the file's imperfections, of kinds
        white-disturbance and noise, instead of from initial states.
    filtered
        Only laws with a low-pass filter, or only without; both by default.
    budget
        Number of designs to try.
    out
        Path of both files, without suffix.
    """
    from deadtime.base.files import replacing
    from deadtime.problems.switching_assumptions import step_of
    from deadtime.reports.design import design_record, plot_designs, problem_sections
    from deadtime.synthesis import design as designed

    chosen = options.problem_of(problem)
    require_name("out", out)
    both = ((".toml",), PICTURES)
    written = [output_file("out", Path(f"{out}{kinds[0]}"), kinds=kinds) for kinds in both]
    if chosen.tracked:
        raise ArgumentError(
            f"the problem {chosen.name!r} follows a reference, and design is for laws that "
            "regulate the state to 0: choose poles or weights for (x, q) by hand, and check them "
            "with deadtime loop."
        )
    plant, gains = chosen.plant, chosen.gains
    held = options.mode_of(chosen, mode)
    if held is not None:
        one = slice(held, held + 1)
        plant = plant.like(plant.A[one], plant.B[one], plant.delays[one])
        gains = gains[one]
    period = step_of(chosen, step)
    if noise and initial is not None:
        raise ArgumentError("--noise and --initial exclude each other: give one of them.")
    source = _noise(chosen, probability) if noise else None
    source = source or _initial(plant.states, initial, probability)
    limit = None if input_limit is None else options.one_or_several("input-limit", input_limit)
    with progress_bar(budget, quiet=json_output) as advance:
        result = designed(
            plant,
            delay_margin=delay_margin,
            step=period,
            law=None if law == "averaged" else _mean,
            gains=gains,
            filtered=filtered,
            longest_step=longest_step,
            decay_rate=decay_rate,
            input_limit=limit,
            initial=source,
            budget=budget,
            weight=chosen.weight,
            progress=advance,
        )
    title = chosen.name if held is None else f"{chosen.name}, {chosen.modes[held]}"
    with replacing(written[0], "out") as place:
        sections = problem_sections(result, law, chosen.plant, chosen.gains, held)
        place.write_text(sections, encoding="utf-8")
    save_figure(plot_designs({title: result}), written[1])
    if json_output:
        print_json(design_record(result), written)
    else:
        _print(chosen, result, held)
        print("\nGains and law: {}, chart: {}".format(*written))
    return 0 if result.reached else 1


def _mean(plant, gains):
    from deadtime.laws import MeanPredictor

    return MeanPredictor(plant, gains.mean(axis=0), gains, allow_unstable=True)


def _initial(states: int, initial: str | None, probability: float | None) -> InitialStates | None:
    """A ball or a box of initial states, or with a probability a normal distribution."""
    import numpy as np

    from deadtime.synthesis import InitialStates

    sizes = [1.0] if initial is None else options.numbers_of("initial", initial)
    if probability is not None:
        deviations = np.array(sizes * states if len(sizes) == 1 else sizes)
        return InitialStates.normal(deviations**2, probability)
    return InitialStates.ball(sizes[0]) if len(sizes) == 1 else InitialStates.box(sizes)


def _noise(problem: Problem, probability: float | None) -> StationaryNoise:
    import numpy as np

    from deadtime.synthesis import StationaryNoise

    if problem.outputs:
        raise ArgumentError(
            "--noise is for laws that measure the state: leave it out, since the problem "
            f"{problem.name!r} measures outputs."
        )
    W, V = options.process_noise(problem), np.diag(options.sensor_variances(problem))
    if not (W.any() or V.any()):
        raise ArgumentError(
            f"--noise needs an imperfection of the kind white-disturbance or noise, of which the "
            f"problem {problem.name!r} has none."
        )
    W = W[0] if (W[0] == W).all() else W
    return StationaryNoise(W, V, 0.99 if probability is None else probability)


def _print(problem: Problem, result: Design, mode: int | None) -> None:
    from deadtime.plant.weight import text_of
    from deadtime.reports.design import HEADINGS, LIMIT_HEADINGS, STEP, design_rows, limit_rows

    print_answer(result.message, problem.title, "")
    rows, at = design_rows(result), HEADINGS.index(STEP)
    if len({row[at] for row in rows}) > 1:
        print_table(HEADINGS, rows)
    else:  # in the sentence above
        keep = [i for i in range(len(HEADINGS)) if i != at]
        print_table([HEADINGS[i] for i in keep], [[row[i] for i in keep] for row in rows])
    print("plain: the gains of the problem.")
    print(f"Cost: {text_of(result.weight)}, each mode held, the mean over |x(0)| = 1.")
    what = "a bound" if result.initial.kind == "noise" else "the largest"
    print(f"Peak |u|: {what} under constant switching signals, for {result.initial.text}.")
    print("\nLimits of linear controllers of one mode alone:")
    names = problem.modes if mode is None else (problem.modes[mode],)
    print_table(LIMIT_HEADINGS, limit_rows(result, names))
