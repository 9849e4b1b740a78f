"""`deadtime identify` and `fit`: from logs to a plant, and to a model of its switching."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from deadtime.base.errors import ArgumentError
from deadtime.cli import options
from deadtime.cli.application import BUILD, app, command_line, lines, with_options
from deadtime.cli.printing import (
    output_file,
    print_answer,
    print_details,
    print_json,
    print_table,
    require_writable,
    save_figure,
    stage_line,
)

if TYPE_CHECKING:
    from deadtime.feedback import Law
    from deadtime.identification import Identification
    from deadtime.switching import SwitchingSignal


_OF_VALIDATION = (
    "outputs",
    "free_run",
    "one_step",
    "last_value",
    "several_steps",
    "horizon",
    "samples",
    "judged",
    "worse_than_constant",
    "sentences",
)
_OF_HIDDEN = ("numbers", "bic", "chain", "sure", "widening", "starts", "agreed")


@app.command(
    group=BUILD,
    help_epilogue=lines(
        "deadtime identify log.csv --out problem.toml",
        "deadtime identify log.csv --one-mode --delay 0 0.5",
        "deadtime identify log.csv --modes 1..3 --switches samples    # modes not logged",
        "deadtime identify log.csv --order 2 --outputs position    # speed is not logged",
        "deadtime identify log.csv --model fopdt --one-mode --delay 0 60    # step test",
        "deadtime identify log.csv --one-mode --test half    # or --test second.csv",
        "deadtime identify monday.csv tuesday.csv --modes gear --beside problem.toml",
    ),
)
def identify(
    *logs: Path,
    modes: str = "mode",
    one_mode: options.Flag = False,
    delay: tuple[float, float] = (0.0, 2.0),
    per_mode: options.Flag = False,
    noise: Annotated[bool | None, Parameter(negative="--no-noise")] = None,
    switches: Literal["anywhere", "samples"] = "anywhere",
    states: list[str] | None = None,
    inputs: list[str] | None = None,
    outputs: list[str] | None = None,
    order: list[int] | None = None,
    zeros: Annotated[bool | None, Parameter(negative="--no-zeros")] = None,
    model: Literal["fopdt", "sopdt", "integrating"] | None = None,
    rest: Annotated[bool | None, Parameter(negative="--no-rest")] = None,
    hold: Literal["held", "linear"] | None = None,
    test: list[str] | None = None,
    time: str | None = None,
    step: float | None = None,
    sep: str | None = None,
    decimal: str | None = None,
    on_change: list[str] | None = None,
    beside: Path | None = None,
    law: str | None = None,
    out: options.File = None,
    figure: Path | None = None,
    report: Path | None = None,
    json_output: options.AsJson = False,
) -> int:
    """Identify a plant from logs: matrices, delays and noise, each with its 95 % interval.

    The exit code is 1 if a delay is not found, because it fits best at an end of the range
    searched, or if the plant predicts its log, or that of test, worse than a constant.

    Parameters
    ----------
    logs
        Text files with columns t (or time), x1, x2, …, u1, u2, … and the mode; separators, decimal
        commas, stamps, units and lines before the header are recognised.
    modes
        Column of the mode, if not mode; without one the plant has one mode. For modes that were not
        logged their number, or a range such as 1..3.
    one_mode
        The plant has one mode, and the log no mode column.
    delay
        Range of the delays, two numbers, in seconds.
    per_mode
        Every mode has its own delays.
    noise
        Whether measurements are noisy; by default tried if the residuals are not white.
    switches
        Whether the mode changes at any time or at samples only.
    states
        Columns of the states, if not x1, x2, …, separated by commas; the option may be repeated. A
        column whose name contains a comma is kept whole.
    inputs
        Columns of the inputs, likewise, if not u1, u2, …
    outputs
        With order or model: columns of the outputs, if not y1, y2, …
    order
        Number of states per output where not all states are logged: 2 for a position without its
        speed.
    zeros
        With order: whether inputs act on all states of an output, not on the last derivative alone;
        by default if the log requires it.
    model
        Process model of one output, y1 or x1 or chosen by outputs: gain, time constants and dead
        time; fopdt is of first order, sopdt of second, integrating has a velocity gain, and with
        --order 2 a lag.
    rest
        Whether inputs before the log equal those of its first row; by default if the log begins at
        rest and its residuals do not contradict that.
    hold
        Whether inputs are held between samples or change linearly; by default held, and tested.
    test
        Another log to validate the plant with; or half, or a share such as 0.3, to hold out the
        last rows for that. The option may be repeated.
    time
        Column of the times, if not t or time: seconds, stamps, or a clock that counts from 1970.
    step
        Sampling period of a log without times, seconds.
    sep
        Separator of columns, such as ";"; found by default.
    decimal
        Sign of decimals, "." or ","; found by default.
    on_change
        Columns of inputs, or of the mode, in whose empty cells the value before still holds.
    beside
        A problem file with a law, whose delay margin is compared with the delay's interval.
    law
        The law of that file, by its name; the first by default.
    out
        The problem file to write.
    figure
        The figure to write, PNG, SVG, PDF or PGF.
    report
        The page to write, HTML: the sentences, all intervals, and figures of the fit.
    """
    from deadtime.identification import identify as identified
    from deadtime.reports.identification_report import (
        HEADINGS,
        PROCESS_HEADINGS,
        VALIDATION_HEADINGS,
        interval_rows,
        process_rows,
        sampling_of,
        validation_rows,
    )

    if not logs:
        raise ArgumentError("logs must be given: the CSV files to identify a plant from.")
    if one_mode and modes != "mode":
        raise ArgumentError(f"modes must be left out beside one-mode, got {modes!r}.")
    require_writable("out", out)
    figure = None if figure is None else output_file("figure", figure)
    require_writable("report", report, (".html", ".htm"))
    tested = _test(test)
    tests = tested if isinstance(tested, list) else []
    _require_apart([*logs, beside, *tests], [out, figure, report])
    whose = _law_of(beside, law)
    failed = None
    columns = _columns((states, inputs, outputs, on_change), logs[0], time, sep, decimal)
    with stage_line(quiet=json_output) as stage:
        fit = identified(
            list(logs),
            None if one_mode else _modes(modes),
            delay,
            per_mode=per_mode,
            noise=noise,
            switches=switches,
            states=columns[0],
            inputs=columns[1],
            outputs=columns[2],
            order=None if order is None else order[0] if len(order) == 1 else order,
            zeros=zeros,
            model=model,
            rest=rest,
            hold=hold,
            test=tested,
            time=time,
            step=step,
            sep=sep,
            decimal=decimal,
            on_change=columns[3] or (),
            progress=stage,
        )
        sentences = [with_options(one) for one in fit.sentences]
        try:
            if whose is not None:
                stage("computing the delay margin of the law")
                sentences.append(_verdict(fit, *whose))
        except ArgumentError as error:  # of the law: the identification is still written
            failed = error
        written = _write(fit, sentences, logs, (out, figure, report), stage)
    if json_output:
        print_json(_record(fit, sentences), written)
    else:
        answer, *details = sentences
        print_answer(answer, f"A plant from {sampling_of(fit)}{_numbered(fit)}", "")
        if fit.processes:
            wide = process_rows(fit)  # intervals below estimates fit on a narrow terminal
            rows = [(name, *(one.replace(" (", "\n(") for one in cells)) for name, *cells in wide]
            print_table(PROCESS_HEADINGS, rows)
            print()
        print_table(HEADINGS, interval_rows(fit))
        if fit.validation is not None:
            print()
            print_table(VALIDATION_HEADINGS, validation_rows(fit.validation))
        print()
        print_details(details)
        for path in written:
            print(f"\nWritten: {path}")
    if failed is not None:
        raise failed
    return 1 if fit.delays_not_found or fit.worse_than_constant else 0


def _test(given: list[str] | None) -> str | float | list[Path] | None:
    """ "half", a share, or paths of logs."""
    if given is None:
        return None
    if given == ["half"]:
        return "half"
    shares = [one for one in given if one == "half" or re.fullmatch(r"0?\.\d+|\d+", one)]
    if shares and len(given) > 1:
        raise ArgumentError(
            f"test must be half, a share or logs, got {shares[0]} and others: give one of them."
        )
    return float(shares[0]) if shares else [Path(one) for one in given]


def _require_apart(read: list[Path | None], written: list[Path | None]) -> None:
    """Refuse to overwrite an input file, or to write one file twice."""
    seen = {path.resolve() for path in read if path is not None}
    for path in written:
        if path is None:
            continue
        if path.resolve() in seen:
            raise ArgumentError(f"{path} is read, or written twice: choose another name for one.")
        seen.add(path.resolve())


def _write(
    fit: Identification,
    sentences: list[str],
    logs: tuple[Path, ...],
    targets: tuple[Path | None, Path | None, Path | None],
    stage: Callable[[str], None],
) -> list[Path]:
    from deadtime.reports.identification_report import write_identification

    out, figure, report = targets
    if out is not None:
        fit.save(out)
    if figure is not None or report is not None:
        stage("drawing the likelihood of the delays")
    if figure is not None:
        save_figure(fit.plot(), figure)
    if report is not None:
        name = f"A plant from {logs[0].name}" + (f" and {len(logs) - 1} more" * (len(logs) > 1))
        write_identification(fit, report, sentences, name, command_line())
    return [path for path in targets if path is not None]


def _numbered(fit: Identification) -> str:
    each = [f"{i} = {name}" for i, name in enumerate(fit.modes)]
    own = any(name not in (str(i), f"mode {i}") for i, name in enumerate(fit.modes))
    return f"; modes {', '.join(each)}" if own else ""


def _modes(text: str) -> str | int | range:
    """A number of modes, a range of numbers, or the name of a column."""
    match = re.fullmatch(r"(\d+)(?:\.\.(\d+))?", text)
    if match is None:
        return text
    first, last = int(match[1]), match[2]
    return first if last is None else range(first, int(last) + 1)


def _columns(
    options: Sequence[list[str] | None],
    log: Path,
    time: str | None,
    sep: str | None,
    decimal: str | None,
) -> list[list[str] | None]:
    """Names split at commas, except columns of the log whose names contain commas."""
    if not any("," in text for given in options for text in given or ()):
        return list(options)
    from deadtime.base.row_clocks import TIMES
    from deadtime.base.text_tables import read_text_table

    whole = read_text_table(log, sep, decimal, TIMES if time is None else (time,)).columns

    def split(text: str) -> list[str]:
        return [text] if text in whole else [name.strip() for name in text.split(",")]

    return [
        given if given is None else [name for text in given for name in split(text)]
        for given in options
    ]


def _law_of(beside: Path | None, name: str | None) -> tuple[str, Law, float] | None:
    """The law of the delay margin: its name, the law, and its period."""
    if beside is None:
        if name is not None:
            raise ArgumentError("law needs beside: the problem file whose law it is.")
        return None
    from deadtime.problems.switching_assumptions import step_of

    problem = options.problem_of(beside)
    return *options.law_of(problem, name), step_of(problem)


def _verdict(fit: Identification, name: str, law: Law, step: float) -> str:
    from deadtime.reports.identification_report import law_beside

    sizes = [(p.modes, p.states, p.inputs) for p in (fit.plant, law.plant)]
    if sizes[0] != sizes[1]:
        raise ArgumentError(
            f"beside must have the modes, states and inputs of the log, {sizes[0]}, got {sizes[1]}."
        )
    return law_beside(fit, name, law, step)


def _record(fit: Identification, sentences: list[str]) -> dict:
    from deadtime.base.json_records import record
    from deadtime.reports.identification_report import listed_names

    point, rest = fit.operating_point, None
    if point is not None:
        rest = {"x": point.x, "u": point.u, "x_error": fit.rest_error, "offset": fit.offset}
    missing = set(fit.delays_not_found)
    delay_ends = [
        [
            None if missing & {"delay", f"delay[{j}]", f"delay[{i}][{j}]"} else ends
            for j, ends in enumerate(row)
        ]
        for i, row in enumerate(fit.delay_interval.tolist())
    ]
    ends = {name: None if name in missing else fit.interval(name) for name in listed_names(fit)}
    return {
        "samples": fit.samples,
        "step": fit.step,
        "modes": fit.modes,
        "A": fit.plant.A,
        "B": fit.plant.B,
        "delays": fit.delays,
        "delay_interval": delay_ends,
        "delays_not_found": fit.delays_not_found,
        "processes": fit.processes,
        "operating_point": rest,
        "disturbance": fit.disturbance,
        "noise": fit.noise,
        "intervals": ends,
        "log_likelihood": fit.log_likelihood,
        "hidden": fit.hidden and record(fit.hidden, *_OF_HIDDEN),
        "departures": [one._asdict() for one in fit.departures],
        "validation": fit.validation and record(fit.validation, *_OF_VALIDATION),
        "read_as": fit.read_as,
        "sentences": sentences,
    }


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
    time: str | None = None,
    mode: str = "mode",
    sep: str | None = None,
    decimal: str | None = None,
    dwell_time: str | None = None,
    maximum_dwell: str | None = None,
    step: float | None = None,
    out: options.File = None,
    json_output: options.AsJson = False,
) -> None:
    """Fit a model of the switching to logs, and print it as a section for a problem file.

    Parameters
    ----------
    logs
        Text files with the columns t (or time) and mode, as for identify.
    family
        Family of the sojourns: exponential, shifted exponential, gamma, weibull, uniform,
        lognormal, fixed; auto takes the best.
    first
        drop if the logs begin in the middle of a sojourn.
    labels
        Mode of each text in the logs, such as --labels.idle 0 --labels.busy 1.
    unit
        Unit of times that are numbers; s by default, or what counts from 1970 to a date of today.
    time
        Column of the times, if not t or time.
    mode
        Column of the mode.
    sep
        Separator of columns, such as ";"; found by default.
    decimal
        Sign of decimals, "." or ","; found by default.
    dwell_time
        Known shortest sojourn, seconds, or one per mode separated by commas: families are
        truncated there.
    maximum_dwell
        Known longest sojourn likewise, inf for none.
    step
        Fit a Markov chain of this period, seconds, instead of sojourns: it switches at samples
        only, and has no family and no figure.
    out
        The figure, PNG, SVG, PDF or PGF; fit.png by default.
    """
    from deadtime.problems.switching_assumptions import one_or_all
    from deadtime.reports.fit import HEADINGS, fit_record, fit_rows, fit_sentence, plot_fit
    from deadtime.switching import SwitchingSignal
    from deadtime.switching.log import read_log
    from deadtime.switching.models.markov_chain import MarkovChain
    from deadtime.switching.models.semi_markov import SemiMarkov

    if not logs:
        raise ArgumentError("logs must be given: the CSV files to fit a model to.")
    picture = output_file("out", out, "fit")
    given = {"labels": labels, "unit": unit, "time": time, "mode": mode}
    read = [read_log(log, **given, sep=sep, decimal=decimal) for log in logs]
    signals = [SwitchingSignal.of_log(one) for one in read]
    read_as = list(dict.fromkeys(one.read_as for one in read if one.read_as))
    if step is not None:
        if family != "auto" or any(one is not None for one in (dwell_time, maximum_dwell, out)):
            raise ArgumentError(
                "step fits a chain, which has neither families nor limits of sojourns, and no "
                "figure: leave out family, dwell-time, maximum-dwell and out, or the step."
            )
        chain = MarkovChain.fit(signals, step)
        record = {"P": chain.P.tolist(), "step": chain.step} | _off_grid(signals, chain.step)
        if json_output:
            print_json(record | {"read_as": read_as}, [])
            return
        between, switches = record["off_grid"], record["switches"]
        if between:
            print(
                f"# Between samples of {chain.step:g} s: {between:,} of {switches:,} switches; "
                "the chain moves each to the next sample."
            )
        for sentence in read_as:
            print(f"# {sentence}")
        print(chain.section())
        return
    least, most = (
        None if text is None else one_or_all(options.numbers_of(name, text))
        for name, text in (("dwell-time", dwell_time), ("maximum-dwell", maximum_dwell))
    )
    model = SemiMarkov.fit(
        signals, family=family, first=first, dwell_time=least, maximum_dwell=most
    )
    texts = {mode: text for text, mode in (labels or {}).items()}
    names = [texts.get(mode, f"mode {mode}") for mode in range(model.modes)]
    save_figure(plot_fit(model, signals, names, first=first), picture)
    if json_output:
        print_json(fit_record(model, names) | {"read_as": read_as}, [picture])
        return
    print_answer(fit_sentence(model, names), "")
    print_table(HEADINGS, fit_rows(model, names))
    if read_as:
        print()
        print_details(read_as)
    print(f"\n{model.section()}")
    print(f"\nFigure: {picture}")


def _off_grid(signals: list[SwitchingSignal], step: float) -> dict[str, int]:
    """How many switches the logs have, and how many of them lie between samples."""
    import numpy as np

    from deadtime.plant.discretisation import snap_all

    periods = snap_all(np.concatenate([one.times[1:] for one in signals]) / step)
    return {"switches": periods.size, "off_grid": int(np.sum(periods != np.round(periods)))}
