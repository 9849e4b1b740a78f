"""`deadtime fit` and `study`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from deadtime.base.errors import ArgumentError
from deadtime.cli.application import (
    BUILD,
    COMPARE,
    AsJson,
    CellSignals,
    Folder,
    StudyFile,
    app,
    lines,
)
from deadtime.cli.printing import (
    output_file,
    output_folder,
    print_answers,
    print_json,
    print_table,
    save_figure,
)


@app.command(
    group=BUILD,
    help_epilogue=lines(
        "deadtime fit log.csv",
        "deadtime fit week-*.csv --first drop",
        "deadtime fit log.csv --dwell-time 0.2 --maximum-dwell 3,inf",
        "deadtime fit log.csv --labels.throttle 0 --labels.brake 1",
        "deadtime fit log.csv --step 0.05",
    ),
)
def fit(
    *logs: Path,
    family: str = "auto",
    first: Literal["whole", "drop"] = "whole",
    labels: dict[str, int] | None = None,
    unit: Literal["s", "ms", "us", "ns"] | None = None,
    dwell_time: str | None = None,
    maximum_dwell: str | None = None,
    step: float | None = None,
    out: Folder = Path("fit.png"),
    json_output: AsJson = False,
) -> None:
    """Fit a model of the switching to logs, and print it as a section for a problem file.

    Parameters
    ----------
    logs
        CSV files with the columns t (or time) and mode, as for identify.
    family
        Family of the sojourns: exponential, shifted exponential, gamma, weibull, uniform,
        lognormal, fixed; auto takes the best.
    first
        drop, if the logs begin in the middle of a sojourn.
    labels
        Mode of each text in the logs, such as --labels.idle 0 --labels.busy 1.
    unit
        Of the times; s by default.
    dwell_time
        The shortest sojourn, seconds, where it is known, or one per mode with commas between them:
        families are fitted as truncated there.
    maximum_dwell
        The longest sojourn likewise, inf for none.
    step
        Fit a Markov chain of this period, seconds, in place of sojourns: it switches at samples
        only. It has no family and no figure.
    out
        The figure, PNG, SVG, PDF or PGF.
    """
    from deadtime.cli.problems import numbers_of
    from deadtime.problems.asked import one_or_all
    from deadtime.reports.figures.fit import plot_fit
    from deadtime.reports.tables import fit as fit_report
    from deadtime.switching import SwitchingSignal
    from deadtime.switching.models.markov_chain import MarkovChain
    from deadtime.switching.models.semi_markov import SemiMarkov

    if not logs:
        raise ArgumentError("logs must be given: the CSV files to fit a model to.")
    out = output_file("out", out)
    signals = [SwitchingSignal.from_csv(log, labels=labels, unit=unit) for log in logs]
    if step is not None:
        if family != "auto" or dwell_time is not None or maximum_dwell is not None:
            raise ArgumentError(
                "step fits a chain, which has neither families nor limits of sojourns: leave out "
                "family, dwell-time and maximum-dwell, or the step."
            )
        chain = MarkovChain.fit(signals, step)
        if json_output:
            print_json({"P": chain.P.tolist(), "step": chain.step}, [])
        else:
            print(chain.section())
        return
    least, most = (
        None if text is None else one_or_all(numbers_of(name, text))
        for name, text in (("dwell-time", dwell_time), ("maximum-dwell", maximum_dwell))
    )
    model = SemiMarkov.fit(
        signals, family=family, first=first, dwell_time=least, maximum_dwell=most
    )
    texts = {mode: text for text, mode in (labels or {}).items()}
    names = [texts.get(mode, f"mode {mode}") for mode in range(model.modes)]
    save_figure(plot_fit(model, signals, names, first=first), out)
    if json_output:
        print_json(fit_report.fit_record(model, names), [out])
        return
    print_table(fit_report.HEADINGS, fit_report.fit_rows(model, names))
    print(f"\n{fit_report.fit_sentence(model, names)}\n\n{model.section()}")
    print(f"\nFigure: {out}")


@app.command(
    group=COMPARE,
    help_epilogue=lines(
        "deadtime study studies/paper.toml",
        "deadtime study studies/paper.toml --scenarios 20 --out quick-look",
    ),
)
def study(
    file: StudyFile,
    *,
    out: Folder = Path("study-report"),
    scenarios: CellSignals = None,
    workers: int | None = None,
    scheduler: str | None = None,
    json_output: AsJson = False,
) -> None:
    """Run laws over a grid of plants and switching, and write a report with maps and answers.

    What the folder holds of the same study is not computed again: after an interruption the same
    command goes on.

    Parameters
    ----------
    out
        Folder for the report.
    workers
        Processes; as many as there are processors by default. The result is the same.
    scheduler
        Address of a Dask scheduler, whose workers reach the folder, instead of this machine.
    """
    from deadtime.cli.sweep import progress_of, with_scenarios
    from deadtime.reports.study.report import write_study
    from deadtime.scenarios.sweeps import load_study
    from deadtime.scenarios.sweeps.plan import plan_of

    chosen, command = load_study(file), f"deadtime study {file}"
    out = output_folder("out", out)
    if scenarios is not None:
        chosen = with_scenarios(chosen, scenarios)
        command += f" --scenarios {scenarios}"
    plan = plan_of(chosen, out / "data" / "study.zarr")
    with progress_of(plan, quiet=json_output, remote=scheduler is not None) as report:
        result = write_study(chosen, out, workers, report, command, scheduler)
    if json_output:
        print_json(result.record, [result.path])
        return
    print_answers(chosen.title, result.answers)
    print(f"Report: {result.path}")
