"""The samples of all laws in one table, as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping

import numpy as np

from deadtime.simulation import Trajectory


def csv_of(runs: Mapping[str, Trajectory]) -> str:
    """Time, mode, and the states, inputs and mismatch of every law, full precision.

    Of laws that follow a reference also y and r. Columns are named as those of `Trajectory.to_csv`,
    behind the law's name; a run that ended early leaves its cells empty from there on.

    Examples
    --------
    >>> import deadtime as dt
    >>> problem = dt.problems.paper()
    >>> csv_of({"mean": problem.simulate("mean")}).splitlines()[0]
    'time,mode,mean: x[0],mean: x[1],mean: u[0],mean: w[0]'
    """
    longest = max(runs.values(), key=lambda run: run.time.size)
    columns: dict[str, np.ndarray] = {"time": longest.time, "mode": longest.mode}
    for law, run in runs.items():
        rows = {f"x[{i}]": row for i, row in enumerate(run.states)}
        rows |= {f"u[{i}]": row for i, row in enumerate(run.inputs)}
        if run.mismatch is not None:
            rows |= {f"w[{i}]": row for i, row in enumerate(run.mismatch)}
        if run.tracked is not None and run.reference is not None:
            rows |= {f"y[{i}]": row for i, row in enumerate(run.tracked)}
            rows |= {f"r[{i}]": row for i, row in enumerate(run.reference)}
        columns |= {f"{law}: {name}": row for name, row in rows.items()}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for i in range(longest.time.size):
        writer.writerow([row[i].item() if i < row.size else "" for row in columns.values()])
    return text.getvalue()
