"""`deadtime certify` and `verify`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from deadtime.checks import positive
from deadtime.cli.entry import JUDGE, AsJson, File, app, lines
from deadtime.cli.printing import print_json, print_table, progress_bar
from deadtime.cli.problems import problem_of

if TYPE_CHECKING:
    from deadtime.certificate_table import Judged
    from deadtime.problems import Problem


@app.command(
    group=JUDGE,
    help_epilogue=lines(
        "deadtime certify problem.toml",
        "deadtime certify paper --law averaged",
        "deadtime certify problem.toml --dwell-time 0.5 --out cert.json",
    ),
)
def certify(
    problem: Path,
    *,
    law: str | None = None,
    dwell_time: float | None = None,
    step: float | None = None,
    decay_rate: float | None = None,
    out: File = None,
    json_output: AsJson = False,
) -> int:
    """Is the loop stable for every switching signal with the dwell time? With a proof, or a signal.

    With `--law` the exit code is 1 unless that law is proved stable.

    Parameters
    ----------
    problem
        A problem file, or paper, three-mode, follower.
    law
        One law of the problem, by its name; all by default.
    dwell_time
        Dwell time in seconds; that of the problem's signal by default, in whole periods.
    step
        Sampling period in seconds; the problem's by default, 0.01 where its loop is ideal.
    decay_rate
        The decay rate to certify, in 1/s; by default one close to that of the slowest mode.
    out
        Save the certificates that are proofs, for `deadtime verify`; of several laws, each into
        a file named after the law.
    json_output
        Print the results as JSON instead of text.
    """
    from deadtime.certificate_table import STEP, asked_of, judge, judged_record

    chosen = problem_of(problem)
    if step is not None:
        chosen = replace(chosen, step=positive("step", step))
    if dwell_time is None:
        dwell, period = asked_of(chosen, chosen.given_signal)
    else:
        dwell, period = dwell_time, chosen.step or STEP
    names = None if law is None else [law]
    with progress_bar(len(names or chosen.laws), quiet=json_output) as advance:
        judged = judge(chosen, dwell, period, names, decay_rate, advance)
    saved = [] if out is None else _save(judged, out)
    if json_output:
        record = {"problem": chosen.name, "dwell_time": dwell, "step": period}
        record["laws"] = judged_record(judged)
        print_json(record, saved)
    else:
        _print_judged(chosen, judged, dwell, period, law is not None)
        if out is not None:
            print("\nCertificates: " + (", ".join(map(str, saved)) or "none to save"))
    return 0 if law is None or judged[0].stable else 1


@app.command(
    group=JUDGE,
    help_epilogue=lines(
        "deadtime verify cert.json",
        "deadtime verify cert.json --json",
    ),
)
def verify(certificate: Path, *, json_output: AsJson = False) -> int:
    """Prove a saved certificate again, from its file alone; exit code 1 if it proves nothing.

    Needs no optimisation solver.

    Parameters
    ----------
    certificate
        A file that `deadtime certify --out` or `Certificate.save` wrote, its sidecar beside it.
    json_output
        Print the result as JSON instead of text.
    """
    from deadtime.certificates import verify as check

    result = check(certificate)
    if json_output:
        record = {
            "proven": result.proven,
            "message": result.message,
            "statement": list(result.statement),
            "seconds": result.seconds,
        }
        print_json(record)
    else:
        print(result.message)
        for sentence in result.statement:
            if sentence not in result.message:
                print(f"• {sentence}")
        print(f"({'proven' if result.proven else 'not proven'} in {result.seconds:.2g} s)")
    return 0 if result.proven else 1


def _save(judged: list[Judged], out: Path) -> list[Path]:
    """Save every certificate that says stable; one file for one law."""
    certificates = {one.law: one.certificate for one in judged if one.stable}
    saved = []
    for name, certificate in certificates.items():
        assert certificate is not None
        word = "".join(c if c.isalnum() else "-" for c in name.lower())
        path = out if len(judged) == 1 else out.with_stem(f"{out.stem}-{word}")
        saved.append(certificate.save(path))
    return saved


def _print_judged(
    problem: Problem, judged: list[Judged], dwell: float, step: float, in_full: bool
) -> None:
    from deadtime.certificate_table import HEADINGS, LEGEND, judged_rows, judged_sentences
    from deadtime.cli.console import Terminal

    console = Terminal()
    console.print(problem.title, style="bold", markup=False)
    console.print(
        f"Every signal that stays in each mode for at least {dwell:.4g} s, switches at any time; "
        f"sampling period {step:g} s.\n",
        markup=False,
    )
    print_table(HEADINGS, judged_rows(judged))
    console.print(f"{LEGEND}\n", style="dim", markup=False)
    for sentence in judged_sentences(judged):
        console.print(f"• {sentence}", markup=False)
    if not in_full:
        return
    for one in judged:
        for sentence in one.certificate.statement if one.certificate is not None else ():
            console.print(f"  – {sentence}", markup=False)
        if one.margin is not None:
            console.print(f"• Delay: {one.margin.message}.", markup=False)
