"""`deadtime certify`, `verify` and `bound`: proofs for every switching signal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

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

if TYPE_CHECKING:
    from deadtime.feedback import Law
    from deadtime.problems import Problem
    from deadtime.problems.switching_assumptions import AssumedSignals
    from deadtime.reports.certificate_tables import Judged
    from deadtime.switching import SignalClass

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
    mode: int | None = None,
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
        Search the least dwell time instead: print the shortest that is proved and the longest that
        is refuted. Several dwell times, of the problem or given, are scaled together.
    mode
        With --least-dwell-time: vary the dwell time of this mode alone, and keep the others.
    longest_mode_lag
        Search the longest mode detection delay instead: print the longest that is proved and the
        shortest that is refuted.
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
                "--least-dwell-time searches the dwell time: leave out --dwell-time (except one "
                "per mode, which are scaled together), --decay-rate, --delays, --lost-samples, "
                "--uncertain and --out."
            )
        signals = options.kept_by_search(chosen, dwell_time, maximum_dwell, mode, chatter, at)
        return least_dwell_times(chosen, law, signals, mode, json_output)
    if mode is not None:
        raise ArgumentError("--mode needs --least-dwell-time, whose search varies its dwell time.")
    if longest_mode_lag:
        given = (decay_rate, delays, out)
        if any(one is not None for one in given) or mode_lag != 0 or lost_samples or uncertain:
            raise ArgumentError(
                "--longest-mode-lag searches the lag: leave out --mode-lag, "
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
        record = about(chosen, period, assumed.signals) | for_json(
            assumed.signals, chosen.plant.modes
        )
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
    if any(one.stable for one in judged):
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


class ProvedBracket(NamedTuple):
    """The ends of a bracket, proved and refuted, in seconds; None where nothing is known."""

    certified: float | None
    refuted: float | None
    message: str
    certified_each: tuple[float, ...] | None = None
    refuted_each: tuple[float, ...] | None = None

    def record(self) -> dict[str, object]:
        """For JSON, with the dwell times of the modes if they differ."""
        each = self.certified_each, self.refuted_each
        several = any(len(set(one)) > 1 for one in each if one)
        kept = self._fields if several else self._fields[:3]
        return {name: getattr(self, name) for name in kept}


def least_dwell_times(
    problem: Problem, law: str | None, signals: SignalClass, mode: int | None, json_output: bool
) -> int:
    """Print the bracket of every law, or of one; 1 if nothing is proved for that one."""
    from deadtime.margins import least_dwell_time
    from deadtime.problems.switching_assumptions import step_of

    period, modes = step_of(problem), problem.plant.modes

    def bracket(one: Law) -> ProvedBracket:
        margin = least_dwell_time(problem.plant, one, period, dwell_time=signals, mode=mode)
        return ProvedBracket(*(getattr(margin, field) for field in ProvedBracket._fields))

    def cells(one: ProvedBracket) -> tuple[str, str]:
        proved = _seconds(one.certified, one.certified_each, up=True)
        return proved, _seconds(one.refuted, one.refuted_each)

    record = about(problem, period) | for_json(signals, modes)
    if mode is not None:
        record["mode"] = mode
    elif not isinstance(record["dwell_time"], tuple):
        del record["dwell_time"]
    kept = (with_names(one, problem.modes) for one in _kept_limits(signals, modes, mode))
    notes = [f"Sampling period {period:g} s.", *kept]
    table = ("law", "proved from", "refuted up to"), cells
    return _answer(problem, law, bracket, ("least_dwell_times", record), notes, table, json_output)


def longest_mode_lags(
    problem: Problem, law: str | None, assumed: AssumedSignals, period: float, json_output: bool
) -> int:
    """Print the bracket of every law, or of one; 1 if nothing is proved for that one."""
    from deadtime.margins import longest_mode_lag

    signals = assumed.signals
    if signals.chatter > 1:
        raise ArgumentError(
            "--longest-mode-lag needs a dwell time, not an average one: give --dwell-time and "
            "--chatter 1."
        )

    def bracket(one: Law) -> ProvedBracket:
        lag = longest_mode_lag(problem.plant, one, signals, period)
        return ProvedBracket(lag.certified_seconds, lag.refuted_seconds, lag.message)

    def cells(one: ProvedBracket) -> tuple[str, str]:
        ends = one.certified, one.refuted
        low, high = ("–" if seconds is None else f"{seconds:.4g} s" for seconds in ends)
        return low, high

    record = about(problem, period) | for_json(signals, problem.plant.modes)
    notes, table = [assumed.in_words(problem.modes, period)], ("law", "proved up to", "refuted at")
    given = ("longest_mode_lags", record), notes, (table, cells)
    return _answer(problem, law, bracket, *given, json_output)


def _answer(
    problem: Problem,
    law: str | None,
    bracket: Callable[[Law], ProvedBracket],
    record: tuple[str, dict[str, object]],
    notes: list[str],
    table: tuple[tuple[str, ...], Callable[[ProvedBracket], tuple[str, str]]],
    json_output: bool,
) -> int:
    """Print the bracket of every law, or the reason why it has none; or that of one law."""
    from deadtime.reports.certificate_tables import left_out

    names, brackets = list(problem.laws) if law is None else [law], dict[str, ProvedBracket]()
    laws = [problem.law(name) for name in names]
    with progress_bar(len(names), json_output, f"searching: {names[0]}") as advance:
        for name, one in zip(names, laws, strict=True):
            try:
                brackets[name] = bracket(one)
            except ArgumentError as error:
                if law is not None:
                    raise
                brackets[name] = ProvedBracket(None, None, str(error))
            advance(name)
    if json_output:
        key, about_them = record
        print_json(about_them | {key: {name: one.record() for name, one in brackets.items()}})
    else:
        headings, cells = table
        sentences = [
            f"{name}: {with_names(x.message, problem.modes)}" for name, x in brackets.items()
        ]
        proved = [name for name, one in brackets.items() if one.certified is not None]
        answer = f"Proved for {', '.join(proved)}." if proved else "Nothing is proved for any law."
        alone = len(sentences) == 1
        print_answer(sentences[0] if alone else answer, problem.title, *notes, "")
        print_table(headings, [(name, *cells(one)) for name, one in brackets.items()])
        print()
        print_details([*([] if alone else sentences), *left_out(problem)])
    return 0 if law is None or brackets[law].certified is not None else 1


def _kept_limits(signals: SignalClass, modes: int, mode: int | None) -> list[str]:
    """Sentences on the limits of the signals that a search for dwell times keeps."""
    limits, sentences = signals.limits(modes), []
    if mode is not None:
        sentences.append(f"The dwell time of mode {mode} varies; the others are kept.")
    elif len(set(limits.dwell_time)) > 1:
        times = ", ".join(f"{one:g}" for one in limits.dwell_time)
        sentences.append(f"Dwell times of the modes stay in proportion to {times} s.")
    if signals.chatter > 1:
        often = f"{signals.chatter} + T/τ switches in any T seconds at most"
        sentences.append(f"Dwell times τ are averages: {often}.")
    if len(limits.lasting) < modes:
        sentences.append("No sojourn is longer than the maximum dwell time of its mode.")
    if signals.at == "samples" or signals.chatter > 1 or not limits.is_free:
        sentences.append(f"Every signal {signals.in_words(modes)[1]}.")
    return sentences


def for_json(signals: SignalClass, modes: int) -> dict[str, object]:
    """The signals for JSON: the limits that they have, null for a mode without one."""
    from deadtime.switching import SignalClass
    from deadtime.switching.constraint import one_or_each

    limits = signals.limits(modes)
    record: dict[str, object] = {"dwell_time": one_or_each(limits.dwell_time)}
    if len(limits.lasting) < modes:
        longest = limits.maximum_dwell
        record["maximum_dwell"] = [None if one == float("inf") else one for one in longest]
    if not limits.is_free:
        record["transitions"] = limits.transitions.astype(int)
    usual, names = SignalClass(1.0), ("at", "chatter", "mode_lag", "lost_samples")
    more = {name: getattr(signals, name) for name in names}
    return record | {name: x for name, x in more.items() if x != getattr(usual, name)}


def about(problem: Problem, step: float, signals: SignalClass | None = None) -> dict[str, object]:
    """The problem, the sampling period and the imperfections left out, for JSON."""
    from deadtime.reports.certificate_tables import without_imperfections

    without = without_imperfections(problem, signals)
    return {"problem": problem.name, "step": step, "imperfections_left_out": without}


def _seconds(value: float | None, each: tuple[float, ...] | None, up: bool = False) -> str:
    from deadtime.margins.dwell_time import in_words

    if value is None or value == float("inf"):
        return "–" if value is None else "any"
    times = (value,) if each is None or len(set(each)) == 1 else each
    return ", ".join(in_words(one, up=up) for one in times) + " s"
