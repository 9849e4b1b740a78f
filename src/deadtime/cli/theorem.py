"""`deadtime bound`."""

from __future__ import annotations

from deadtime.cli.application import JUDGE, AsJson, ProblemFile, app, lines
from deadtime.cli.printing import print_json, print_table
from deadtime.cli.problems import problem_of


@app.command(
    group=JUDGE,
    help_epilogue=lines(
        "deadtime bound problem.toml",
        "deadtime bound paper --dwell-time 0.2",
    ),
)
def bound(
    problem: ProblemFile,
    *,
    dwell_time: float | None = None,
    json_output: AsJson = False,
) -> None:
    """What the paper's stability theorem says about a plant: its constants in three forms.

    Parameters
    ----------
    dwell_time
        Dwell time in seconds; that of the problem by default, as `certify` takes it.
    """
    from deadtime.problems.asked import dwell_time_of
    from deadtime.reports.tables.constants import (
        bound_headings,
        bound_rows,
        bound_sentence,
        bounds_of,
        bounds_record,
    )

    chosen = problem_of(problem)
    dwell, source = dwell_time_of(chosen, chosen.signal, dwell_time)
    bounds = bounds_of(chosen, dwell)
    if json_output:
        print_json(bounds_record(bounds))
        return
    print_table(bound_headings(bounds, chosen.constants), bound_rows(bounds, chosen.constants))
    print(f"\nDwell time {dwell:.4g} s ({source}). {bound_sentence(bounds)}")
