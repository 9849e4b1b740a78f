"""The samples of all laws in one table, as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping

import numpy as np

from deadtime.simulation import Trajectory
from deadtime.simulation.trajectory import numbered_columns


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
        signals = {"x": run.states, "u": run.inputs, "w": run.mismatch}
        rows = numbered_columns(signals | {"y": run.tracked, "r": run.reference})
        columns |= {f"{law}: {name}": row for name, row in rows.items()}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for i in range(longest.time.size):
        writer.writerow([row[i].item() if i < row.size else "" for row in columns.values()])
    return text.getvalue()
