"""`deadtime loop` and `robustness`: stability margins of a loop, and tolerated imperfections."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from deadtime.cli import options
from deadtime.cli.application import JUDGE, app, lines
from deadtime.cli.printing import (
    output_file,
    print_answer,
    print_details,
    print_json,
    print_table,
    progress_bar,
    save_figure,
)

if TYPE_CHECKING:
    from deadtime.feedback import Law
    from deadtime.margins import DrawnStability, Robustness, Tolerance
    from deadtime.margins.loop_view import LoopView, ModeView
    from deadtime.margins.step_response import StepResponse
    from deadtime.problems import Problem


_STEP_HEADINGS = ("mode", "rise, s", "settling, s", "overshoot, %", "peak", "steady state")
_HEADINGS = ("mode", "growth, 1/s", "phase margin", "at, rad/s", "disk margin", "peak |S|")


@app.command(
    group=JUDGE,
    help_epilogue=lines(
        "deadtime loop problem.toml",
        "deadtime loop follower --law mean --at output",
        "deadtime loop problem.toml --step ideal",
    ),
)
def loop(
    problem: options.ProblemFile,
    *,
    law: options.FirstLaw = None,
    step: options.StepOrIdeal = None,
    at: Literal["input", "output"] = "input",
    channel: int = 0,
    output: int = 0,
    out: options.Picture = None,
    json_output: options.AsJson = False,
) -> int:
    """Show stability margins, Bode, Nyquist, sensitivity and step response of every mode.

    The step is that of a reference; if nothing is tracked, a constant 1 at an input of the plant.

    Parameters
    ----------
    at
        Where the loop is opened: at the plant's inputs, or at the measurement.
    channel
        Number of the input with the step, from 0; in a file with a [servo], of the reference.
    output
        Number of the state, or with an observer of the output, in the step response, from 0.
    """
    from deadtime.base.wording import sentence_of, with_names
    from deadtime.margins.loop_view import loop_view
    from deadtime.margins.step_response import step_response
    from deadtime.reports.figures.loop import plot_loop
    from deadtime.reports.verdict import held_in_words

    chosen = options.problem_with(problem, step, None, None)
    path = output_file("out", out, f"{chosen.name}-loop")
    name, chosen_law = options.law_of(chosen, law)
    view, steps = loop_view(chosen.plant, chosen_law, chosen.step, at), []
    shown, pushed = None, "the plant input"
    if chosen.step is not None:
        args = chosen.plant, chosen_law
        steps = [
            step_response(*args, mode, chosen.step, channel=channel, output=output)
            for mode in range(chosen.plant.modes)
        ]
        shown = _shown(chosen, chosen_law, channel if chosen.tracked else output)
        if chosen.tracked:
            pushed = "its reference"
        elif len(chosen.inputs) > 1:
            pushed = f"input {chosen.inputs[channel]}"
    title = f"{chosen.title}: law “{name}”"
    save_figure(plot_loop(view, title, chosen.modes, steps, shown, pushed), path)
    stable = bool((view.gain.growth < 0.0).all())
    if json_output:
        setting = {"problem": chosen.name, "law": name, "step": chosen.step, "at": at}
        print_json(setting | _record(view, steps), [path])
        return 0 if stable else 1
    sentences = (sentence_of(margin.message) for margin in (view.gain, view.delay))
    growth, names = view.gain.growth.tolist(), chosen.modes
    judged, why = held_in_words(chosen, growth)
    held = "With each mode held, t" if len(names) > 1 else "T"
    print_answer(
        f"{held}he loop under the law “{name}” is {judged}: {why}.",
        chosen.title,
        "",
    )
    print_table(_HEADINGS, [_row(*each) for each in zip(names, growth, view.modes, strict=True)])
    if any(each.growth < 0.0 for each in steps):
        change = "a step of 1 of" if chosen.tracked else "a load step of 1 at"
        print(f"\n{shown} after {change} {pushed}:")
        print_table(_STEP_HEADINGS, [_step_row(*each) for each in zip(names, steps, strict=True)])
    print()
    details = [with_names(text, chosen.modes) for text in sentences]
    each_mode = zip(names, growth, view.modes, strict=True)
    low = [name for name, rate, mode in each_mode if rate < 0.0 and mode.phase is None]
    if low:
        where = f" in {', '.join(low)}" if len(names) > 1 else ""
        details.append(f"Phase margin –: none{where}, since the loop gain does not pass 1.")
    finals = [abs((each.info or {}).get("SteadyStateValue", 0.0)) for each in steps]
    if not chosen.tracked and max(finals, default=0.0) > 0.0:
        final = max(finals)
        up_to, where = "", ""
        if len(names) > 1:
            up_to, where = "up to ", f" in {names[finals.index(final)]}"
        details.append(
            f"After the load step {shown} stays {up_to}{final:.3g} off{where} (no integral action; "
            "[servo] on this output removes it)."
        )
    print_details(details)
    print(f"\nFigure: {path}")
    return 0 if stable else 1


def _row(name: str, growth: float, view: ModeView) -> list[str]:
    phase = "–" if view.phase is None else f"{view.phase:.3g}°"
    at = "–" if view.phase_frequency is None else f"{view.phase_frequency:.3g}"
    disk = "–" if view.disk is None else f"{view.disk:.3g}"
    return [name, f"{growth:+.3g}", phase, at, disk, f"{view.sensitivity.max():.3g}"]


def _shown(problem: Problem, law: Law, output: int) -> str:
    if problem.tracked:
        return problem.tracked[output]
    if law.outputs is not None:
        return problem.outputs[output] if problem.outputs else f"output {output}"
    return problem.states[output] if problem.states else f"x[{output}]"


def _step_row(name: str, answer: StepResponse) -> list[str]:
    found = answer.info or {}
    keys = ("RiseTime", "SettlingTime", "Overshoot", "Peak", "SteadyStateValue")
    return [name, *(f"{found[key]:.3g}" if key in found else "–" for key in keys)]


def _record(view: LoopView, steps: list[StepResponse]) -> dict[str, Any]:
    from deadtime.base.json_records import record

    margins = ("phase", "phase_frequency", "disk", "disk_frequency", "disk_gain", "disk_phase")
    return {
        "growth": view.gain.growth,
        "gain_margin": [view.gain.lower, view.gain.upper],
        "stabilising_gain": view.gain.stabilising,
        "delay_margin": [view.delay.lower, view.delay.upper],
        "modes": [
            record(each, "mode", *margins)
            | {"peak_sensitivity": each.sensitivity.max()}
            | {"step_info": steps[each.mode].info if steps else None}
            for each in view.modes
        ],
    }


@app.command(
    group=JUDGE,
    help_epilogue=lines(
        "deadtime robustness problem.toml", "deadtime robustness follower --law mean"
    ),
)
def robustness(
    problem: options.ProblemFile,
    *,
    law: options.FirstLaw = None,
    step: options.Step = None,
    scenarios: int = 20,
    seed: int = 0,
    out: options.Picture = None,
    json_output: options.AsJson = False,
) -> None:
    """Find the delay and gain errors, lost and late samples, late modes and noise a loop tolerates.

    With an [uncertainty] in the file, as `deadtime identify` writes it, also print for every law
    how many of 100 plants drawn from it are stable.

    Parameters
    ----------
    scenarios
        Runs per value of a random imperfection.
    seed
        Seed of the first run.
    """
    from deadtime.base.wording import with_names
    from deadtime.margins import robustness as assess
    from deadtime.margins.robustness import STEPS
    from deadtime.problems.switching_assumptions import step_of
    from deadtime.problems.unit_checks import unit_checks_of
    from deadtime.reports.robustness import DRAWN_HEADINGS, drawn_of, drawn_rows, plot_robustness

    chosen = options.problem_of(problem)
    path = output_file("out", out, f"{chosen.name}-robustness")
    (name, chosen_law), period = options.law_of(chosen, law), step_of(chosen, step)
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
    checks = unit_checks_of(chosen, period)
    drawn = drawn_of(chosen, period, seed)
    if json_output:
        setting = {"problem": chosen.name, "law": name, "step": period}
        print_json(setting | _robustness_record(result, checks, drawn), [path])
        return
    answer, *details = (with_names(one, chosen.modes) for one in (*result.sentences, *checks))
    print_answer(answer, f"{chosen.title}: law “{name}”, sampled every {period:g} s")
    print_details(details)
    if drawn:
        print("\nPlants drawn from [uncertainty]:")
        print_table(DRAWN_HEADINGS, drawn_rows(drawn))
    print(f"\nFigure: {path}")


def _robustness_record(
    result: Robustness, checks: list[str], drawn: dict[str, DrawnStability]
) -> dict[str, Any]:
    from deadtime.base.json_records import record
    from deadtime.plant.weight import record_of
    from deadtime.reports.robustness import drawn_record

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
        "sentences": [*result.sentences, *checks],
        **({"drawn_plants": drawn_record(drawn)} if drawn else {}),
        **record_of(result.weight),
    }


def _tolerance(one: Tolerance) -> dict[str, Any]:
    from deadtime.base.json_records import record

    lost = one.lost.mean(axis=1)
    return record(one, "tolerated", "failed", "values") | {"lost": lost}
