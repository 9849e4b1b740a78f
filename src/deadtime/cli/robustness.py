"""`deadtime robustness`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from deadtime.cli.application import (
    JUDGE,
    AsJson,
    FirstLaw,
    Picture,
    ProblemFile,
    Step,
    app,
    lines,
)
from deadtime.cli.printing import (
    output_file,
    print_heading,
    print_json,
    print_table,
    progress_bar,
    save_figure,
)
from deadtime.cli.problems import problem_of

if TYPE_CHECKING:
    from deadtime.margins import DrawnStability, Robustness, Tolerance


@app.command(
    group=JUDGE,
    help_epilogue=lines(
        "deadtime robustness problem.toml",
        "deadtime robustness follower --law mean",
    ),
)
def robustness(
    problem: ProblemFile,
    *,
    law: FirstLaw = None,
    step: Step = None,
    scenarios: int = 20,
    seed: int = 0,
    out: Picture = None,
    json_output: AsJson = False,
) -> None:
    """What does the loop stand? Wrong delay and gain, lost and late samples, late modes, noise.

    Where the file has an [uncertainty], as `deadtime identify` writes it, also on how many of 100
    plants drawn from it every law is stable.

    Parameters
    ----------
    scenarios
        Runs for each value of what is random.
    seed
        Of the first of them.
    """
    from deadtime.base.checks import positive
    from deadtime.base.wording import with_names
    from deadtime.margins import robustness as assess
    from deadtime.margins.robustness import STEPS
    from deadtime.problems.asked import step_of
    from deadtime.problems.slips import slips_of
    from deadtime.reports.figures.robustness import plot_robustness
    from deadtime.reports.tables import drawn_plants

    chosen = problem_of(problem)
    path = output_file("out", out, f"{chosen.name}-robustness")
    name = next(iter(chosen.laws)) if law is None else law
    chosen_law = chosen.law(name)
    period = step_of(chosen) if step is None else positive("step", step)
    with progress_bar(len(STEPS), quiet=json_output) as advance:
        result = assess(
            chosen.plant,
            chosen_law,
            chosen.signal,
            chosen.x0,
            chosen.horizon,
            period,
            scenarios=scenarios,
            seed=seed,
            imperfections=chosen.imperfections,
            u0=chosen.u0,
            weight=chosen.weight,
            names=chosen.inputs,
            progress=advance,
        )
    save_figure(plot_robustness(result, f"{chosen.title}: law “{name}”", chosen.modes), path)
    slips = slips_of(chosen, period)
    drawn = drawn_plants.drawn_of(chosen, period, seed)
    if json_output:
        setting = {"problem": chosen.name, "law": name, "step": period}
        print_json(setting | _record(result, slips, drawn), [path])
        return
    print_heading(chosen.title)
    print(f"Law “{name}”, sampled every {period:g} s:")
    for sentence in (*result.sentences, *slips):
        print(f"• {with_names(sentence, chosen.modes)}")
    if drawn:
        print("\nPlants drawn from [uncertainty]:")
        print_table(drawn_plants.HEADINGS, drawn_plants.drawn_rows(drawn))
    print(f"\nFigure: {path}")


def _record(
    result: Robustness, slips: list[str], drawn: dict[str, DrawnStability]
) -> dict[str, Any]:
    """The figures for JSON."""
    from deadtime.base.json_records import record
    from deadtime.plant.weight import record_of
    from deadtime.reports.tables.drawn_plants import drawn_record

    delay, gain = result.delay, result.gain
    return {
        "delay_margin": delay and [delay.lower, delay.upper],
        "delay_margin_of_inputs": [[one.lower, one.upper] for one in result.of_inputs],
        "gain_margin": gain and [gain.lower, gain.upper],
        "stabilising_gain": gain and gain.stabilising,
        "lost_samples": _tolerance(result.drops),
        "late_samples": _tolerance(result.late),
        "detection_lag": result.lag and _tolerance(result.lag),
        "noise": record(result.noise, "base", "doubling"),
        "sentences": [*result.sentences, *slips],
        **({"drawn_plants": drawn_record(drawn)} if drawn else {}),
        **record_of(result.weight),
    }


def _tolerance(one: Tolerance) -> dict[str, Any]:
    from deadtime.base.json_records import record

    lost = one.lost.mean(axis=1)
    return record(one, "tolerated", "failed", "values") | {"lost": lost}
