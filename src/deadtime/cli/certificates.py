"""`deadtime certify`, `verify` and `bound`: proofs for every switching signal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import file_names, with_names
from deadtime.cli import options
from deadtime.cli.application import JUDGE, app, lines
from deadtime.cli.printing import (
    output_file,
    print_answer,
    print_details,
    print_json,
    print_table,
    progress_bar,
)
from deadtime.cli.proved_brackets import least_dwell_times, longest_mode_lags, setting_record

if TYPE_CHECKING:
    from deadtime.problems import Problem
    from deadtime.problems.switching_assumptions import AssumedSignals
    from deadtime.reports.certificate_tables import Judged

_OF_VERIFICATION = ("proven", "message", "statement", "decay_rate", "seconds", "about")


@app.command(
    group=JUDGE,
    help_epilogue=lines(
        "deadtime certify problem.toml",
        "deadtime certify paper --law averaged",
        "deadtime certify problem.toml --dwell-time 0.5 --out cert.json",
        "deadtime certify three-mode --law averaged --dwell-time 0.5,0.8,0.5 --maximum-dwell 3",
        "deadtime certify problem.toml --law averaged --least-dwell-time",
        "deadtime certify problem.toml --law mean --delays [0.3,0.1] [0.32,0.12]",
        "deadtime certify problem.toml --law expected --mode-lag 3",
        "deadtime certify problem.toml --law expected --longest-mode-lag",
        "deadtime certify problem.toml --lost-samples 2",
        "deadtime certify problem.toml --law averaged --dwell-time 2 --chatter 3",
        "deadtime certify problem.toml --dwell-time 0.05 --step 0.05 --at samples",
        "deadtime certify identified.toml --uncertain",
    ),
)
def certify(
    problem: options.ProblemFile,
    *,
    law: options.AllLaws = None,
    dwell_time: str | None = None,
    maximum_dwell: str | None = None,
    chatter: int | None = None,
    at: Literal["anywhere", "samples"] | None = None,
    step: options.Step = None,
    decay_rate: float | None = None,
    delays: tuple[str, str] | None = None,
    mode_lag: int = 0,
    lost_samples: int = 0,
    uncertain: bool = False,
    least_dwell_time: bool = False,
    mode: str | None = None,
    longest_mode_lag: bool = False,
    explain: options.Flag = False,
    out: options.File = None,
    json_output: options.AsJson = False,
) -> int:
    """Prove that the loop is stable for every switching signal, or find one that destabilises it.

    With `--law` the exit code is 1 unless that law is proved stable.

    Parameters
    ----------
    dwell_time
        Dwell time in seconds, or one per mode separated by commas, such as 0.2,0.5,0.1; by default
        the problem's, else that of its signal in whole periods. With a chatter above 1 it is an
        average dwell time.
    maximum_dwell
        Longest sojourn in seconds, or one per mode, inf for none; the problem's by default. The
        problem also states the allowed transitions: in its [signal], else by the zeros of its
        [switching].
    chatter
        N: any T seconds contain at most N + T/τ switches, at most one per period, τ the dwell time;
        1 for a dwell time of every sojourn. The problem's by default, 1 where it has no average
        dwell time.
    at
        Where modes may change: anywhere, or samples: only at the law's samples, so that a dwell
        time of one period is meaningful. By default as in the problem's [signal]: samples if a
        Markov chain of that period draws it.
    decay_rate
        Decay rate to certify, in 1/s; by default one close to that of the slowest mode.
    delays
        Lowest and highest true delays in seconds: two numbers, or two lists in brackets, without
        spaces, with a number for each input (or a list for each mode), as in [0.3,0.1] [0.32,0.12].
        The proof then covers every delay in its range; each range lies in one period.
    mode_lag
        Mode detection delay of the laws in periods, as of the imperfection mode_delay.
    lost_samples
        Largest number of samples lost in a row: the proof then covers every such loss, as by the
        imperfection dropout.
    uncertain
        Cover all plants of the file's [uncertainty], as `deadtime identify` writes it: A and B in
        their ellipsoid of 95 %, each delay in its interval of 95 %.
    least_dwell_time
        Search for the least dwell time instead: print the shortest that is proved and the longest
        that is refuted. Several dwell times, of the problem or given, are scaled together.
    mode
        With --least-dwell-time: vary the dwell time of this mode alone, by its number or name, and
        keep the others.
    longest_mode_lag
        Search for the longest mode detection delay instead: print the longest that is proved and
        the shortest that is refuted.
    explain
        Also print the formal statement of every proof: its assumptions, and how it was shown.
    out
        JSON file for the certificates that are proofs, for `deadtime verify`; the suffix .json may
        be left out. For several laws, one file each, named after the law.
    """
    from deadtime.certificates.certificate import require_json
    from deadtime.reports.certificate_tables import certificate_record, judge

    chosen = options.with_step(options.problem_of(problem), step)
    if least_dwell_time:
        one = dwell_time is not None and "," not in dwell_time and mode is None
        given = uncertain or any(option is not None for option in (decay_rate, delays, out))
        if one or given or lost_samples != 0:
            raise ArgumentError(
                "--least-dwell-time searches for the dwell time: leave out --dwell-time (except "
                "one per mode, which are scaled together), --decay-rate, --delays, --lost-samples, "
                "--uncertain and --out."
            )
        varied = options.mode_of(chosen, mode)
        signals = options.kept_by_search(chosen, dwell_time, maximum_dwell, varied, chatter, at)
        return least_dwell_times(chosen, law, signals, varied, json_output)
    if mode is not None:
        raise ArgumentError("--mode needs --least-dwell-time, whose search varies its dwell time.")
    if longest_mode_lag:
        given = (decay_rate, delays, out)
        if any(one is not None for one in given) or mode_lag != 0 or lost_samples or uncertain:
            raise ArgumentError(
                "--longest-mode-lag searches for the lag: leave out --mode-lag, "
                "--lost-samples, --decay-rate, --delays, --uncertain and --out."
            )
    late: dict[str, Any] = {"at": at, "mode_lag": mode_lag, "lost_samples": lost_samples}
    assumed, period = options.signals_and_step(chosen, dwell_time, maximum_dwell, chatter, **late)
    if longest_mode_lag:
        return longest_mode_lags(chosen, law, assumed, period, json_output)
    names = None if law is None else [law]
    if out is not None:
        out = output_file("--out", require_json("--out", out), kinds=(".json",))
    laws = names or list(chosen.laws)
    with progress_bar(len(laws), json_output, f"certifying {laws[0]}") as advance:
        ranges = (
            None
            if delays is None
            else (options.delays_from(delays[0]), options.delays_from(delays[1]))
        )
        judged = judge(
            chosen,
            assumed.signals,
            period,
            laws=names,
            decay_rate=decay_rate,
            progress=advance,
            delays=ranges,
            uncertain=uncertain,
            trying=lambda what: advance(what, 0),
        )
    saved = {} if out is None else _save(judged, out)
    if json_output:
        record = setting_record(chosen, period, assumed.signals, assumed.signals)
        record |= {"delays": ranges}
        record |= {"uncertain": uncertain} if chosen.uncertain is not None else {}
        print_json(record | {"laws": certificate_record(judged)}, [*saved])
    else:
        _print_judged(chosen, judged, assumed, period, explain, (uncertain, ranges))
        if out is not None:
            print("\nCertificates: " + (", ".join(map(str, saved)) or "none to save"))
            for path, limit in saved.items():
                if limit > 1:  # such as with ranges of many delays
                    print(f"It needs more work than usual: deadtime verify {path} --limit {limit}")
    return 0 if law is None or judged[0].stable else 1


@app.command(
    group=JUDGE,
    help_epilogue=lines(
        "deadtime verify cert.json",
        "deadtime verify cert.json --problem problem.toml --law mean --dwell-time 0.5",
        "deadtime verify cert.json --json",
    ),
)
def verify(
    certificate: Path,
    *,
    problem: Path | None = None,
    law: str | None = None,
    dwell_time: str | None = None,
    maximum_dwell: str | None = None,
    chatter: int | None = None,
    at: Literal["anywhere", "samples"] | None = None,
    step: float | None = None,
    mode_lag: int | None = None,
    lost_samples: int | None = None,
    uncertain: bool = False,
    limit: float = 1.0,
    explain: options.Flag = False,
    json_output: options.AsJson = False,
) -> int:
    """Verify a saved certificate from its file alone; exit code 1 if it proves nothing.

    Needs no optimisation solver. With a problem the certificate must also cover its plant, its
    sampling period, its dwell time, and the table of one of its laws.

    Parameters
    ----------
    certificate
        A file written by `deadtime certify --out` or `Certificate.save`.
    problem
        A problem file, or paper, three-mode, follower, that the certificate must cover.
    law
        The law of the problem whose table the certificate must contain.
    dwell_time
        Dwell time in seconds that it must cover, or one per mode separated by commas; with a
        problem as in `certify` by default.
    maximum_dwell
        Longest sojourns that it must cover; with a problem as in `certify`.
    chatter
        Chatter of an average dwell time that it must cover; with a problem as in `certify`.
    at
        Where modes may change in the signals that it must cover; with a problem as in `certify`.
    step
        Sampling period in seconds that it must have; the problem's by default.
    mode_lag
        Mode detection delay in periods that it must cover; with a problem 0 by default.
    lost_samples
        Number of samples lost in a row that it must cover.
    uncertain
        It must cover all plants of the problem's [uncertainty].
    limit
        Allowed work, relative to the usual limit for a file of its size.
    explain
        Also print the formal statement, first numbers and digests.
    """
    from deadtime.certificates import verify as check
    from deadtime.certificates.verification import laws_of
    from deadtime.problems.switching_assumptions import one_or_all
    from deadtime.reports.certificate_tables import uncertain_plant

    late: dict[str, Any] = {"at": at, "mode_lag": mode_lag, "lost_samples": lost_samples}
    late = {name: value for name, value in late.items() if value is not None}
    matches, about = None, ""
    if problem is None:
        if law is not None:
            raise ArgumentError("--law needs --problem, the file of that law.")
        if uncertain:
            raise ArgumentError("--uncertain needs --problem, the file with the [uncertainty].")
        times = (
            options.times_from("dwell-time", dwell_time),
            options.times_from("maximum-dwell", maximum_dwell),
        )
        least, most = (one_or_all(one) for one in times)
        if chatter is not None:
            late["chatter"] = chatter
        result = check(
            certificate, dwell_time=least, maximum_dwell=most, step=step, limit=limit, **late
        )
    else:
        chosen = options.with_step(options.problem_of(problem), step)
        laws = {law: chosen.law(law)} if law is not None else chosen.laws
        assumed, period = options.signals_and_step(
            chosen, dwell_time, maximum_dwell, chatter, **late
        )
        dwell, chatter = assumed.dwell.value, assumed.signals.chatter
        only = None if law is None else laws[law]
        plant = uncertain_plant(chosen) if uncertain else chosen.plant
        result = check(
            certificate, plant, only, step=period, dwell_time=assumed.signals, limit=limit
        )
        names = laws_of(certificate, laws) if result.proven else []
        if names:
            about = assumed.in_words(chosen.modes, period)
            matches = {"problem": chosen.name, "laws": names, "dwell_time": dwell, "step": period}
            matches |= {"chatter": chatter} if chatter > 1 else {}
        elif result.proven:
            why = "Rejected: its table belongs to none of the problem's laws."
            result = replace(result, proven=False, message=why, summary=(why,))
    if json_output:
        from deadtime.base.json_records import record

        print_json(record(result, *_OF_VERIFICATION) | {"matches": matches})
        return 0 if result.proven else 1
    print("\n".join(result.summary))
    if matches is not None:
        its = f"its plant and its law {' = '.join(matches['laws'])}"
        print(f"Matches {matches['problem']}: {its}. {about}")
    if explain:
        for sentence in (*result.statement, *result.about):
            print(f"• {sentence}")
        print(f"({'proven' if result.proven else 'not proven'} in {result.seconds:.2g} s)")
    return 0 if result.proven else 1


def _save(judged: list[Judged], out: Path) -> dict[Path, int]:
    """Save every certificate of a stable loop, a file per law; the work limits of the files."""
    certificates = {one.law: one.certificate for one in judged if one.stable}
    saved, names = {}, file_names(one.law for one in judged)
    for name, certificate in certificates.items():
        assert certificate is not None
        path = out if len(judged) == 1 else out.with_stem(f"{out.stem}-{names[name]}")
        saved[certificate.save(path)] = certificate.limit
    return saved


def _print_judged(
    problem: Problem,
    judged: list[Judged],
    assumed: AssumedSignals,
    step: float,
    explain: bool,
    plants: tuple[bool, object],
) -> None:
    """Print the verdict, its signals, the table and details; with `explain` formal statements."""
    from deadtime.certificates.certificate import not_covered
    from deadtime.cli.console import Terminal
    from deadtime.reports.certificate_tables import (
        HEADINGS,
        LEGEND,
        certificate_rows,
        certificate_sentences,
        left_out,
        plants_in_words,
        summary_of,
        without_imperfections,
    )

    sentences = certificate_sentences(judged, problem)
    alone = len(judged) == 1
    print_answer(
        sentences[0] if alone else summary_of(judged),
        problem.title,
        assumed.in_words(problem.modes, step),
        *plants_in_words(problem, *plants),
        "",
    )
    print_table(HEADINGS, certificate_rows(judged))
    print()
    if not alone:  # the table says everything about a law that is proved stable
        sentences = [text for one, text in zip(judged, sentences, strict=True) if not one.stable]
    elif judged[0].margin is not None:
        sentences = [f"Delay: {with_names(judged[0].margin.message, problem.modes)}."]
    else:
        sentences = []
    print_details([*sentences, *left_out(problem, assumed.signals)])
    if any(one.stable for one in judged) and not without_imperfections(problem, assumed.signals):
        print_details([not_covered(assumed.signals)])
    Terminal().print(f"\n{LEGEND}", style="dim", markup=False)
    if explain:
        for one in judged:
            if one.certificate is not None and one.certificate.statement:
                print_answer("", f"{one.law}, formally:")
                print_details(one.certificate.statement)


@app.command(
    group=JUDGE,
    help_epilogue=lines("deadtime bound problem.toml", "deadtime bound paper --dwell-time 0.2"),
)
def bound(
    problem: options.ProblemFile,
    *,
    dwell_time: float | None = None,
    json_output: options.AsJson = False,
) -> None:
    """Print the constants of the paper's stability theorem for a plant, in three forms.

    Parameters
    ----------
    dwell_time
        Dwell time in seconds; that of the problem by default, as `certify` takes it.
    """
    from deadtime.problems.switching_assumptions import dwell_time_of
    from deadtime.reports.certificate_tables import (
        bound_headings,
        bound_rows,
        bound_sentence,
        bounds_of,
        bounds_record,
    )

    chosen = options.problem_of(problem)
    dwell, source = dwell_time_of(chosen, chosen.signal, dwell_time)
    bounds = bounds_of(chosen, dwell)
    if json_output:
        print_json(bounds_record(bounds))
        return
    print_answer(bound_sentence(bounds), f"Dwell time {dwell:.4g} s ({source}).", "")
    print_table(bound_headings(bounds, chosen.constants), bound_rows(bounds, chosen.constants))
    print("\nFor a proof of the sampled loop: deadtime certify.")
