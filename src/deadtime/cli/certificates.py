"""`deadtime certify`, `verify` and `bound`: what is proved for every switching signal."""

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
    """Is the loop stable for every switching signal with the dwell time? With a proof, or a signal.

    With `--law` the exit code is 1 unless that law is proved stable.

    Parameters
    ----------
    dwell_time
        Dwell time in seconds, or one per mode with commas between them, such as 0.2,0.5,0.1; by
        default what the problem promises, else that of its signal, in whole periods. With a chatter
        above 1 it is an average dwell time.
    maximum_dwell
        Longest sojourn in seconds, or one per mode, inf for none; what the problem promises by
        default. Which mode may follow which is said by the problem: in its [signal], else by the
        zeros of its [switching].
    chatter
        N: any T seconds may hold N + T/τ switches, one in a period at most, τ the dwell time; 1 for
        a dwell time of every sojourn. That of the problem's average dwell time by default, else 1.
    at
        When modes may change: anywhere, or samples: only where the law samples, so that a dwell
        time of one period is meaningful. By default as the problem's [signal] has it: samples
        where a Markov chain of that period draws it.
    decay_rate
        The decay rate to certify, in 1/s; by default one close to that of the slowest mode.
    delays
        Lowest and highest true delays in seconds: two numbers, or two lists in brackets, without
        spaces, with a number for each input (or a list for each mode), as in [0.3,0.1] [0.32,0.12].
        What is proved then holds for every delay in its range; each range lies in one period.
    mode_lag
        How many periods late the mode is reported to the laws, as by the imperfection mode_delay.
    lost_samples
        How many samples in a row may be lost, at most, whichever: what is proved then holds for
        every loss of them, as by the imperfection dropout.
    uncertain
        Prove it for all plants that the file's [uncertainty], as `deadtime identify` writes it,
        leaves open: A and B in their ellipsoid of 95 %, each delay in its interval of 95 %.
    least_dwell_time
        Look for the least dwell time instead: the shortest proved, and the longest refuted. Several
        dwell times, of the problem or given, move in proportion.
    mode
        With --least-dwell-time: the dwell time of this mode moves alone, and the others stay.
    longest_mode_lag
        Look for the longest lag instead with which the mode is reported: the longest proved, and
        the shortest refuted.
    explain
        Print the formal statement of every proof, too: its assumptions, and how it was shown.
    out
        Save the certificates that are proofs, for `deadtime verify`, as JSON: a name that ends in
        .json or in nothing; of several laws, each into a file named after the law.
    """
    from deadtime.certificates.certificate import require_json
    from deadtime.reports.certificate_tables import certificate_record, judge

    chosen = options.with_step(options.problem_of(problem), step)
    if least_dwell_time:
        one = dwell_time is not None and "," not in dwell_time and mode is None
        given = uncertain or any(option is not None for option in (decay_rate, delays, out))
        if one or given or lost_samples != 0:
            raise ArgumentError(
                "--least-dwell-time looks for the dwell time itself: leave out --dwell-time (but "
                "for one per mode, to keep in proportion), --decay-rate, --delays, --lost-samples, "
                "--uncertain and --out."
            )
        signals = options.kept_by_search(chosen, dwell_time, maximum_dwell, mode, chatter, at)
        return least_dwell_times(chosen, law, signals, mode, json_output)
    if mode is not None:
        raise ArgumentError("--mode must come with --least-dwell-time: whose dwell time moves?")
    if longest_mode_lag:
        given = (decay_rate, delays, out)
        if any(one is not None for one in given) or mode_lag != 0 or lost_samples or uncertain:
            raise ArgumentError(
                "--longest-mode-lag looks for the lag itself: leave out --mode-lag, "
                "--lost-samples, --decay-rate, --delays, --uncertain and --out."
            )
    late: dict[str, Any] = {"at": at, "mode_lag": mode_lag, "lost_samples": lost_samples}
    asked, period = options.signals_and_step(chosen, dwell_time, maximum_dwell, chatter, **late)
    if longest_mode_lag:
        return longest_mode_lags(chosen, law, asked, period, json_output)
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
            asked.signals,
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
        record = about(chosen, period, asked.signals) | for_json(asked.signals, chosen.plant.modes)
        record |= {"delays": ranges}
        record |= {"uncertain": uncertain} if chosen.uncertain is not None else {}
        print_json(record | {"laws": certificate_record(judged)}, [*saved])
    else:
        _print_judged(chosen, judged, asked, period, explain, (uncertain, ranges))
        if out is not None:
            print("\nCertificates: " + (", ".join(map(str, saved)) or "none to save"))
            for path, limit in saved.items():
                if limit > 1:  # such as where many delays have ranges
                    print(f"More work than is usual: deadtime verify {path} --limit {limit}")
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
    """Prove a saved certificate again, from its file alone; exit code 1 if it proves nothing.

    Needs no optimisation solver. With a problem the certificate must be about it, too: its plant,
    its sampling period, its dwell time, and the table of one of its laws.

    Parameters
    ----------
    certificate
        A file that `deadtime certify --out` or `Certificate.save` wrote.
    problem
        A problem file, or paper, three-mode, follower, that the certificate must be about.
    law
        The law of the problem whose table it must be.
    dwell_time
        The dwell time in seconds that it must cover, or one per mode with commas between them; by
        default that of `certify` for the problem.
    maximum_dwell
        The longest sojourns that it must cover; with a problem as `certify` takes them.
    chatter
        The chatter of an average dwell time that it must cover; with a problem as `certify` has it.
    at
        When modes may change in the signals that it must cover; with a problem as `certify` has it.
    step
        The sampling period in seconds that it must have; by default that of the problem.
    mode_lag
        How many periods late the mode may be reported; with a problem 0 by default.
    lost_samples
        How many samples in a row it must allow to be lost.
    uncertain
        It must be about all plants that the problem's [uncertainty] leaves open.
    limit
        How many times as much work as is usual may be done for a file of its size.
    explain
        Print the formal statement, first numbers and digests, too.
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
            raise ArgumentError("--law must come with --problem: which plant is it a law of?")
        if uncertain:
            raise ArgumentError("--uncertain must come with --problem: whose [uncertainty]?")
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
        asked, period = options.signals_and_step(chosen, dwell_time, maximum_dwell, chatter, **late)
        dwell, chatter = asked.dwell.value, asked.signals.chatter
        only = None if law is None else laws[law]
        plant = uncertain_plant(chosen) if uncertain else chosen.plant
        result = check(certificate, plant, only, step=period, dwell_time=asked.signals, limit=limit)
        names = laws_of(certificate, laws) if result.proven else []
        if names:
            about = asked.in_words(chosen.modes, period)
            matches = {"problem": chosen.name, "laws": names, "dwell_time": dwell, "step": period}
            matches |= {"chatter": chatter} if chatter > 1 else {}
        elif result.proven:
            why = "Rejected: the certificate is about a table of none of the problem's laws."
            result = replace(result, proven=False, message=why, summary=(why,))
    if json_output:
        from deadtime.base.json_records import plain

        facts = plain(result)
        del facts["summary"]  # `statement` says it in full
        print_json(facts | {"matches": matches})
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
    """Save every certificate that says stable, one file for one law; the limit of each."""
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
    asked: AssumedSignals,
    step: float,
    explain: bool,
    left_open: tuple[bool, object],
) -> None:
    """The verdict, its signals, the table, then details; formal statements where asked for."""
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
        asked.in_words(problem.modes, step),
        *plants_in_words(problem, *left_open),
        "",
    )
    print_table(HEADINGS, certificate_rows(judged))
    print()
    if not alone:  # the table has all there is to say of a law that is proved stable
        sentences = [text for one, text in zip(judged, sentences, strict=True) if not one.stable]
    elif judged[0].margin is not None:
        sentences = [f"Delay: {with_names(judged[0].margin.message, problem.modes)}."]
    else:
        sentences = []
    print_details([*sentences, *left_out(problem, asked.signals)])
    if any(one.stable for one in judged):
        print_details([not_covered(asked.signals)])
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
        """For JSON; the dwell times of each mode where they are not one and the same."""
        each = self.certified_each, self.refuted_each
        several = any(len(set(one)) > 1 for one in each if one)
        kept = self._fields if several else self._fields[:3]
        return {name: getattr(self, name) for name in kept}


def least_dwell_times(
    problem: Problem, law: str | None, signals: SignalClass, mode: int | None, json_output: bool
) -> int:
    """The bracket of every law, or of one; 1 if that one has none."""
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
    kept = (with_names(one, problem.modes) for one in _kept(signals, modes, mode))
    said = [f"Sampling period {period:g} s.", *kept]
    table = ("law", "proved dwell time, s", "refuted dwell time, s"), cells
    return _answer(problem, law, bracket, ("least_dwell_times", record), said, table, json_output)


def longest_mode_lags(
    problem: Problem, law: str | None, asked: AssumedSignals, period: float, json_output: bool
) -> int:
    """The bracket of every law, or of one, in periods; 1 if that one has none."""
    from deadtime.margins import longest_mode_lag

    signals = asked.signals
    if signals.chatter > 1:
        raise ArgumentError(
            "--longest-mode-lag is asked of a dwell time, not of an average one: give "
            "--dwell-time and --chatter 1."
        )

    def bracket(one: Law) -> ProvedBracket:
        found = longest_mode_lag(problem.plant, one, signals, period)
        return ProvedBracket(found.certified_seconds, found.refuted_seconds, found.message)

    def cells(one: ProvedBracket) -> tuple[str, str]:
        ends = one.certified, one.refuted
        low, high = ("–" if seconds is None else f"{seconds:.4g}" for seconds in ends)
        return low, high

    record = about(problem, period) | for_json(signals, problem.plant.modes)
    said = [asked.in_words(problem.modes, period)]
    table = "law", "proved lag, s", "refuted lag, s"
    given = ("longest_mode_lags", record), said, (table, cells)
    return _answer(problem, law, bracket, *given, json_output)


def _answer(
    problem: Problem,
    law: str | None,
    bracket: Callable[[Law], ProvedBracket],
    record: tuple[str, dict[str, object]],
    said: list[str],
    table: tuple[tuple[str, ...], Callable[[ProvedBracket], tuple[str, str]]],
    json_output: bool,
) -> int:
    """Print the bracket of every law, with what refuses it in place of one, or of one law."""
    from deadtime.reports.certificate_tables import left_out

    names, found = list(problem.laws) if law is None else [law], dict[str, ProvedBracket]()
    laws = [problem.law(name) for name in names]
    with progress_bar(len(names), json_output, f"looking at {names[0]}") as advance:
        for name, one in zip(names, laws, strict=True):
            try:
                found[name] = bracket(one)
            except ArgumentError as error:
                if law is not None:
                    raise
                found[name] = ProvedBracket(None, None, str(error))
            advance(name)
    if json_output:
        key, about_them = record
        print_json(about_them | {key: {name: one.record() for name, one in found.items()}})
    else:
        headings, cells = table
        sentences = [f"{name}: {with_names(x.message, problem.modes)}" for name, x in found.items()]
        proved = [name for name, one in found.items() if one.certified is not None]
        answer = f"Proved for {', '.join(proved)}." if proved else "Nothing is proved for any law."
        alone = len(sentences) == 1
        print_answer(sentences[0] if alone else answer, problem.title, *said, "")
        print_table(headings, [(name, *cells(one)) for name, one in found.items()])
        print()
        print_details([*([] if alone else sentences), *left_out(problem)])
    return 0 if law is None or found[law].certified is not None else 1


def _kept(signals: SignalClass, modes: int, mode: int | None) -> list[str]:
    """Sentences on what a search for dwell times keeps of the signals."""
    limits, found = signals.limits(modes), []
    if mode is not None:
        found.append(f"The dwell time of mode {mode} moves; the others stay.")
    elif len(set(limits.dwell_time)) > 1:
        times = ", ".join(f"{one:g}" for one in limits.dwell_time)
        found.append(f"Dwell times of the modes stay in proportion to {times} s.")
    if signals.chatter > 1:
        often = f"{signals.chatter} + T/τ switches in any T seconds at most"
        found.append(f"Dwell times τ are averages: {often}.")
    if len(limits.lasting) < modes:
        found.append("No sojourn is longer than the maximum dwell time of its mode.")
    if signals.at == "samples" or signals.chatter > 1 or not limits.is_free:
        found.append(f"Every signal {signals.in_words(modes)[1]}.")
    return found


def for_json(signals: SignalClass, modes: int) -> dict[str, object]:
    """The signals that were asked about; nothing where there is no limit, null for none."""
    from deadtime.switching import SignalClass
    from deadtime.switching.constraint import one_or_each

    limits = signals.limits(modes)
    found: dict[str, object] = {"dwell_time": one_or_each(limits.dwell_time)}
    if len(limits.lasting) < modes:
        longest = limits.maximum_dwell
        found["maximum_dwell"] = [None if one == float("inf") else one for one in longest]
    if not limits.is_free:
        found["transitions"] = limits.transitions.astype(int)
    usual, names = SignalClass(1.0), ("at", "chatter", "mode_lag", "lost_samples")
    more = {name: getattr(signals, name) for name in names}
    return found | {name: x for name, x in more.items() if x != getattr(usual, name)}


def about(problem: Problem, step: float, signals: SignalClass | None = None) -> dict[str, object]:
    """The problem and the loop that answers are about, for JSON."""
    from deadtime.reports.certificate_tables import without_imperfections

    without = without_imperfections(problem, signals)
    return {"problem": problem.name, "step": step, "imperfections_left_out": without}


def _seconds(value: float | None, each: tuple[float, ...] | None, up: bool = False) -> str:
    from deadtime.margins.dwell_time import in_words

    if value is None or value == float("inf"):
        return "–" if value is None else "any"
    times = (value,) if each is None or len(set(each)) == 1 else each
    return ", ".join(in_words(one, up=up) for one in times)
