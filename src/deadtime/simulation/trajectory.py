"""The result of a simulation: samples, metrics, and how to hand them on."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from deadtime.simulation.record import DigitalRecord

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """A simulated run (immutable). Arrays index (signal, time); values are right limits.

    Attributes
    ----------
    time : (T,)
        Seconds.
    states : (n, T)
        x.
    inputs : (m, T)
        u as the law computed it; the plant sees it a delay later.
    mode : (T,)
        σ.
    mismatch : (m, T) or None
        w = u − K_σ(t+D) x(t + D), with the true plant and its true future; None for a law
        without a gain per mode.
    diverged : bool
        |x| left 1e100; the run ends at the last sample before that.
    message : str
        What is worth knowing: when the run diverged, that its signal was continued. Often empty.
    """

    time: Float[np.ndarray, " T"]
    states: Float[np.ndarray, "n T"]
    inputs: Float[np.ndarray, "m T"]
    mode: Int[np.ndarray, " T"]
    mismatch: Float[np.ndarray, "m T"] | None
    diverged: bool
    message: str
    record: DigitalRecord = field(repr=False)
    end: float = field(repr=False)

    @property
    def history(self) -> Float[np.ndarray, "m N"]:
        """The inputs still in the pipe at the end, oldest first.

        They are the `u0` of a run that goes on from here; meant for runs whose horizon is a
        multiple of the step.
        """
        record = self.record
        last = record.past + record.samples - 1
        return record.inputs[last - record.past : last].T.copy()

    def metrics(self) -> dict[str, float]:
        """Figures of the whole run, whatever `times` were asked for.

        Returns
        -------
        dict
            ise ∫|x|² and energy ∫|u|² (exact, between samples too), cost = ise + energy, peak
            max|x| over the samples, settling_time (s, from when on |x| stays within 2 % of the
            peak; inf if it does not), decay_rate (1/s, minus the least-squares slope of log|x|
            over the second half; inf if x is zero there, −inf if the run diverged at once),
            final_norm |x| at the end.
        """
        record, end = self.record, self.end
        ise, energy = record.integrals(end)
        time = _grid(record, end)
        norm = np.linalg.norm(record.states_at(time[-1:]), axis=1)
        norm = np.concatenate((np.linalg.norm(record.states[: time.size - 1], axis=1), norm))
        peak = float(norm.max())
        outside = np.flatnonzero(norm > 0.02 * peak)
        settled = outside.size == 0 or outside[-1] + 1 < time.size
        settling = (0.0 if outside.size == 0 else time[outside[-1] + 1]) if settled else np.inf
        late = (time >= 0.5 * end) & (norm > 0.0)
        if late.sum() > 1:
            decay = -np.polyfit(time[late], np.log(norm[late]), 1)[0]
        else:
            decay = -np.inf if self.diverged else np.inf
        return {
            "ise": ise,
            "energy": energy,
            "cost": ise + energy,
            "peak": peak,
            "settling_time": float(settling),
            "decay_rate": float(decay),
            "final_norm": float(norm[-1]),
        }

    def plot(self, title: str | None = None) -> Figure:
        """States, inputs and mode over time, as a matplotlib figure."""
        from deadtime.plotting import plot_run

        return plot_run(self, title)

    def _columns(self) -> dict[str, np.ndarray]:
        """The signals by python-control's names."""
        columns = {f"x[{i}]": row for i, row in enumerate(self.states)}
        columns |= {f"u[{i}]": row for i, row in enumerate(self.inputs)}
        columns["mode"] = self.mode
        if self.mismatch is not None:
            columns |= {f"w[{i}]": row for i, row in enumerate(self.mismatch)}
        return columns

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write the run as CSV, one row per time, columns as in `to_pandas`."""
        columns = {"time": self.time, **self._columns()}
        rows = zip(*(column.tolist() for column in columns.values()), strict=True)
        with open(path, "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(rows)

    def to_pandas(self) -> pd.DataFrame:
        """A data frame indexed by time, columns x[0], …, u[0], …, mode, w[0], …."""
        import pandas as pd

        return pd.DataFrame(self._columns(), index=pd.Index(self.time, name="time"))

    def to_xarray(self) -> xr.Dataset:
        """A dataset with variables x (state, time), u (input, time), mode, and w."""
        import xarray as xr

        variables: dict[str, Any] = {
            "x": (("state", "time"), self.states),
            "u": (("input", "time"), self.inputs),
            "mode": (("time",), self.mode),
        }
        if self.mismatch is not None:
            variables["w"] = (("input", "time"), self.mismatch)
        time = xr.Variable("time", self.time, {"units": "s"})
        attributes = {"diverged": int(self.diverged), "message": self.message}
        return xr.Dataset(variables, coords={"time": time}, attrs=attributes)

    def to_control(self) -> Any:
        """A python-control ``TimeResponseData``, the states as outputs (needs python-control)."""
        import control

        labels = [f"x[{i}]" for i in range(self.states.shape[0])]
        return control.TimeResponseData(
            self.time,
            self.states,
            self.states,
            self.inputs,
            output_labels=labels,
            state_labels=labels,
            input_labels=[f"u[{i}]" for i in range(self.inputs.shape[0])],
            issiso=False,
        )

    def __repr__(self) -> str:
        state = "diverged" if self.diverged else f"|x| = {np.linalg.norm(self.states[:, -1]):.3g}"
        return f"Trajectory(end={self.end:g} s, samples={self.time.size}, {state})"


def _grid(record: DigitalRecord, end: float) -> np.ndarray:
    """The samples of a run, and its end when that is no sample."""
    time = np.arange(record.samples) * record.window.step
    return time if end - time[-1] <= 1e-9 * record.window.step else np.append(time, end)


def trajectory_of(
    record: DigitalRecord,
    end: float,
    signal_modes: Any,
    gains: np.ndarray | None,
    times: np.ndarray | None,
    diverged: bool,
    message: str,
) -> Trajectory:
    """Lay a record out on its own samples, or on the times asked for.

    `signal_modes` maps times to modes; `gains` are the K of the mismatch.
    """
    lead = record.window.delay
    time = _grid(record, end) if times is None else times
    if time.size == record.samples and times is None:
        states, inputs = record.states[: time.size], record.inputs[record.past :]
        ahead = record.at_phase[record.window.count - 1 :]
    else:
        states, inputs = record.states_at(time), record.inputs_at(time)
        ahead = record.states_at(time + lead)
    mismatch = None
    if gains is not None:
        K = gains[signal_modes(time + lead)]
        with np.errstate(over="ignore", invalid="ignore"):
            mismatch = (inputs - np.einsum("kij,kj->ki", K, ahead)).T
        if diverged:
            mismatch = np.where(np.isfinite(mismatch), mismatch, np.inf)
    return Trajectory(
        time, states.T, inputs.T, signal_modes(time), mismatch, diverged, message, record, end
    )
