"""The result of a simulation: samples, metrics, and how to hand them on as columns and as CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import index, number, python_control, read_only
from deadtime.base.errors import ArgumentError
from deadtime.base.files import replacing
from deadtime.base.frozen import Frozen
from deadtime.base.wording import one_line, subscript
from deadtime.plant import SwitchedSystem
from deadtime.plant.discretisation import TOLERANCE
from deadtime.plant.weight import Weight, costs, weight_of
from deadtime.simulation.digital_record import DigitalRecord
from deadtime.simulation.ideal.ideal_run import IdealRecord
from deadtime.simulation.initial_input import InputHistory
from deadtime.simulation.tracking import OF_STEPS, RISE, SETTLED, Followed, step_info
from deadtime.switching import SwitchingSignal
from deadtime.switching.grid import first_reads

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

    from deadtime.base.figure_files import Width


def numbered_columns(
    signals: Mapping[str, Float[np.ndarray, "signal T"] | None],
) -> dict[str, Float[np.ndarray, " T"]]:
    """A column for each row of the signals that are not None, named by letter and number.

    Examples
    --------
    >>> list(numbered_columns({"x": np.zeros((2, 3)), "w": None}))
    ['x[0]', 'x[1]']
    """
    return {
        f"{letter}[{i}]": row
        for letter, rows in signals.items()
        if rows is not None
        for i, row in enumerate(rows)
    }


def write_csv(
    path: str | PathLike[str], columns: Mapping[str, np.ndarray], names: Mapping[str, Sequence[str]]
) -> None:
    """Write columns as CSV in full precision, names of signals behind a colon: "x[0]: position".

    A signal whose name is only its letter and number keeps its column's heading.
    """
    headings = {
        f"{letter}[{i}]": f"{letter}[{i}]: {one_line(name)}"
        for letter, given in names.items()
        for i, name in enumerate(given)
        if name not in (letter, f"{letter}{subscript(i + 1)}")
    }
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    with replacing(path) as place, place.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([headings.get(name, name) for name in columns])
        writer.writerows(rows)


LATE = 11  # instants in the second half of a run, at least, to which the decay rate is fitted


def settling_time(time: Float[np.ndarray, " T"], distance: Float[np.ndarray, " T"]) -> float:
    """The time from which a distance stays within 2 % of its maximum, ∞ if never."""
    outside = np.flatnonzero(distance > SETTLED * distance.max())
    if outside.size == 0:
        return 0.0
    return float(time[outside[-1] + 1]) if outside[-1] + 1 < time.size else math.inf


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Frozen):
    r"""A simulated run (immutable). Arrays index (signal, time); values are right limits.

    Its arrays are read-only; what `to_pandas`, `to_xarray` and `to_control` give are copies.

    Attributes
    ----------
    time : (T,)
        Seconds.
    states : (n, T)
        x.
    inputs : (m, T)
        u, as applied; it acts on the plant a delay later.
    mode : (T,)
        :math:`\sigma`.
    mismatch : (m, T) or None
        :math:`w = u - K_{\sigma(t+D)} x(t + D)`, with the true plant and its true future; None for
        a law without a gain per mode. With several delays t + D is, input by input, the time at
        which the plant first reads the input sent at t; NaN where that lies beyond the run.
    diverged : bool
        :math:`|x|` left 1e100; the run ends at the last sample before that.
    message : str
        When and why the run diverged or chattered, how long it slid along a boundary, whether its
        signal was continued. Often empty.
    measured : (n, samples) or (p, samples) or None
        The x or outputs that the law received, NaN where nothing arrived; of runs with
        imperfections and of laws that measure outputs.
    commanded : (m, samples) or None
        Commands of the law, where `inputs` are those applied; of the same runs.
    estimates : (states of the law's model, samples) or None
        State estimates of a law on outputs.
    belief : (modes, T) or None
        Probability of each mode at the last sample, of a law to which the mode is not reported.
    tracked, reference : (tracked, T) or None
        The tracked outputs :math:`H C_\sigma x` and :math:`r`, of a law with a servo.
    """

    time: Float[np.ndarray, " T"]
    states: Float[np.ndarray, "n T"]
    inputs: Float[np.ndarray, "m T"]
    mode: Int[np.ndarray, " T"]
    mismatch: Float[np.ndarray, "m T"] | None
    diverged: bool
    message: str
    plant: SwitchedSystem = field(repr=False)
    signal: SwitchingSignal = field(repr=False)
    record: DigitalRecord | IdealRecord = field(repr=False)
    end: float = field(repr=False)
    measured: Float[np.ndarray, "y samples"] | None = field(default=None, repr=False)
    commanded: Float[np.ndarray, "m samples"] | None = field(default=None, repr=False)
    estimates: Float[np.ndarray, "z samples"] | None = field(default=None, repr=False)
    belief: Float[np.ndarray, "modes T"] | None = field(default=None, repr=False)
    followed: Followed | None = field(default=None, repr=False)

    @property
    def tracked(self) -> Float[np.ndarray, "tracked T"] | None:
        r""":math:`H C_\sigma x`."""
        if self.followed is None:
            return None
        return read_only(self.followed.outputs(self.states, self.mode))

    @property
    def reference(self) -> Float[np.ndarray, "tracked T"] | None:
        """The reference of the tracked outputs."""
        if self.followed is None:
            return None
        return read_only(self.followed.reference.along(self.time).T)

    @property
    def history(self) -> Float[np.ndarray, "m N"] | InputHistory:
        """The inputs in flight at the end: the `u0` of a run that goes on from here.

        Held samples, oldest first, for a digital run (meant for a horizon that is a multiple of
        the step); a function of time for an ideal one.
        """
        return self.record.history(self.end)

    def metrics(self, weight: Weight | None = None) -> dict[str, float]:
        r"""Figures of the whole run, whatever `times` are reported.

        Parameters
        ----------
        weight : Weight, optional
            Weight of the cost; the identity by default.

        Returns
        -------
        dict
            ise :math:`\int |x|^2`, energy :math:`\int |u|^2` and cost
            :math:`\int x^T Q x + u^T R u` (exact, between samples too), peak :math:`\max |x|` over
            the samples, settling_time (s, from when on :math:`|x|` stays within 2 % of the peak;
            inf if it does not), decay_rate (1/s, minus the least-squares slope of :math:`\log |x|`
            over the second half, at 11 times at least; inf if x is zero there, −inf if the run
            diverged at once), final_norm :math:`|x|` at the end. Of a law with a servo also iae
            :math:`\sum \int |\text{reference} - \text{output}|` over the tracked outputs, straight
            between samples.
        """
        record, end = self.record, self.end
        weight = weight_of(weight, self.plant)
        parts = costs(lambda one: record.integrals(end, one), weight)
        time = record.grid(end)
        norm = np.linalg.norm(record.states_at(time), axis=1)
        found = {
            **parts,
            "peak": float(norm.max()),
            "settling_time": settling_time(time, norm),
            "decay_rate": self._decay_rate(time, norm),
            "final_norm": float(norm[-1]),
        }
        if self.followed is not None:
            found["iae"] = float(self.followed.absolute_error(*self._outputs()))
        return found

    def _outputs(self) -> tuple[Float[np.ndarray, " T"], Float[np.ndarray, "tracked T"]]:
        """Sample times and tracked outputs; a horizon within a period, which is no sample, is out.

        The reference steps at samples, so that a last short period would shift its last step.
        """
        assert self.followed is not None
        time = self.record.grid(self.end)
        if time.size > 2 and np.diff(time[-2:]) < (1.0 - TOLERANCE) * time[1]:
            time = time[:-1]
        return time, self.followed.outputs(self.record.states_at(time).T, self.signal(time))

    def step_info(
        self,
        output: int = 0,
        since: float | None = None,
        until: float | None = None,
        *,
        settling: float = SETTLED,
        rise: tuple[float, float] = RISE,
    ) -> dict[str, float]:
        r"""How an output follows a step of its reference, by python-control's names.

        Parameters
        ----------
        output : int
            Index of the tracked output.
        since : float, optional
            Time of the step, seconds: the window reaches from there to the next step of this
            output's reference; by default the last of `followed.changes(end, output)`.
        until : float, optional
            An earlier end of the window, at a switch or a disturbance, seconds.
        settling, rise : float, pair of float
            Shares of the step: the settling band, and the begin and end of the rise.

        Returns
        -------
        dict
            RiseTime, SettlingTime (s, ∞ if never), Overshoot, Undershoot (% of the step), Peak,
            PeakTime, SteadyStateValue, SteadyStateError (reference minus output, at the end of the
            window) and IAE, the integral of :math:`|\text{reference} - \text{output}|`. Times are
            those of samples, counted from the step. The first four are NaN where the output is on
            the reference already, and where this output's reference does not step at `since`.

        Raises
        ------
        ArgumentError
            If the run has no reference, or there is no such output or time.

        Examples
        --------
        >>> import deadtime as dt
        >>> plant = dt.SwitchedSystem([[[0.0]]], [[[1.0]]], delay=0.3)
        >>> servo = dt.Servo(plant, C=[[1.0]])
        >>> gains = servo.place([-1.0, -2.0], step=0.1)
        >>> law = dt.SingleModePredictor(servo.plant, gains, 0, allow_unstable=True)
        >>> observer = dt.luenberger(servo.model, servo.C, [-5.0], step=0.1)
        >>> loop = dt.OutputFeedback(law, observer, servo=servo, reference=1.0)
        >>> run = dt.simulate(plant, loop, dt.SwitchingSignal.constant(0), [0.0], 10.0, 0.1)
        >>> found = run.step_info()
        >>> round(found["RiseTime"], 3), round(found["SteadyStateError"], 4)
        (0.5, -0.0001)
        """
        if self.followed is None:
            raise ArgumentError("step_info needs a law with a servo; this run tracks nothing.")
        output = index("output", output, self.followed.rows.shape[1])
        time, y = self._outputs()
        if since is not None and not 0.0 <= number("since", since) < time[-1]:
            raise ArgumentError(f"since must be in [0, {self.end:g}) s, got {since:g}.")
        stepped = since is None or self.followed.steps_at(since, self.end, output)
        where, r = self.followed.window(time, output, since, until)
        found = step_info(time[where], y[output, where], r, settling, rise)
        found |= {} if stepped else dict.fromkeys(OF_STEPS, np.array(np.nan))
        return {name: float(value) for name, value in found.items()}

    def _decay_rate(self, time: np.ndarray, norm: np.ndarray) -> float:
        """Minus the slope of log|x| over the second half, at the samples or at `LATE` instants."""
        late = time >= 0.5 * self.end
        if late.sum() < LATE:
            time = np.linspace(0.5 * self.end, self.end, LATE)
            norm, late = np.linalg.norm(self.record.states_at(time), axis=1), np.full(LATE, True)
        late &= norm > 0.0
        time, norm = time[late], norm[late]
        if self.end == 0.0 or norm.size < 2:
            return -np.inf if self.diverged else np.inf
        # Time in units of the end: squares of the shortest run's times would underflow.
        with np.errstate(over="ignore"):
            return float(-np.polyfit(time / self.end, np.log(norm), 1)[0] / np.float64(self.end))

    def plot(self, title: str | None = None, width: Width | None = None) -> Figure:
        """States, inputs and mode over time, as a matplotlib figure.

        The width is "column" (3.5 in) or "page" (7.16 in) of a journal, or inches. A run that ended
        before the first of the `times` asked for is drawn at its samples.
        """
        from deadtime.simulation.run_figure import plot_run

        run = self
        if not self.time.size:
            time = self.record.grid(self.end)
            x, u = self.record.states_at(time).T, self.record.inputs_at(time).T
            mode = self.signal(time)
            run = replace(self, time=time, states=x, inputs=u, mode=mode, mismatch=None)
        return plot_run(run, title, width=width)

    def _columns(self) -> dict[str, np.ndarray]:
        """The signals by python-control's names, the letter and a number."""
        first = numbered_columns({"x": self.states, "u": self.inputs})
        others = {"w": self.mismatch, "belief": self.belief, "y": self.tracked, "r": self.reference}
        return first | {"mode": self.mode} | numbered_columns(others)

    def to_csv(
        self,
        path: str | PathLike[str],
        states: Sequence[str] = (),
        inputs: Sequence[str] = (),
        outputs: Sequence[str] = (),
    ) -> None:
        """Write the run as CSV, one row per time, columns as in `to_pandas`.

        Parameters
        ----------
        path : path
            The file.
        states, inputs, outputs : sequence of str, optional
            Names, for columns such as "x[0]: position (m)", which `identify` reads.
        """
        names = {"x": states, "u": inputs, "y": outputs, "r": outputs}
        write_csv(path, {"time": self.time, **self._columns()}, names)

    def to_pandas(self) -> pd.DataFrame:
        """A data frame indexed by time, columns x[0], …, u[0], …, mode, w[0], …, belief[0], ….

        Of a law with a servo also the tracked outputs y[0], … and r[0], ….
        """
        import pandas as pd

        return pd.DataFrame(self._columns(), index=pd.Index(self.time, name="time"))

    def to_xarray(self) -> xr.Dataset:
        """A dataset with variables x (state, time), u (input, time), mode, w, belief, y and r."""
        import xarray as xr

        signals = {
            "x": (("state", "time"), self.states),
            "u": (("input", "time"), self.inputs),
            "mode": (("time",), self.mode),
            "w": (("input", "time"), self.mismatch),
            "belief": (("candidate", "time"), self.belief),
            "y": (("output", "time"), self.tracked),
            "r": (("output", "time"), self.reference),
        }
        variables: dict[str, Any] = {
            name: (axes, rows.copy()) for name, (axes, rows) in signals.items() if rows is not None
        }
        time = xr.Variable("time", self.time.copy(), {"units": "s"})
        attributes = {"diverged": int(self.diverged), "message": self.message}
        return xr.Dataset(variables, coords={"time": time}, attrs=attributes)

    def to_control(self) -> Any:
        """A python-control ``TimeResponseData``, the states as outputs (needs python-control)."""
        control = python_control("responses of python-control")
        labels = [f"x[{i}]" for i in range(self.states.shape[0])]
        return control.TimeResponseData(
            self.time.copy(),
            self.states.copy(),
            self.states.copy(),
            self.inputs.copy(),
            output_labels=labels,
            state_labels=labels,
            input_labels=[f"u[{i}]" for i in range(self.inputs.shape[0])],
            issiso=False,
        )

    def __repr__(self) -> str:
        state = "diverged" if self.diverged else "ended early"
        if self.time.size and not self.diverged:
            state = f"|x| = {np.linalg.norm(self.states[:, -1]):.3g}"
        return f"Trajectory(end={self.end:g} s, samples={self.time.size}, {state})"


def belief_at(
    run: Trajectory, belief: Float[np.ndarray, "samples modes"]
) -> Float[np.ndarray, "modes T"]:
    """The belief at the times of a run, held from sample to sample."""
    assert isinstance(run.record, DigitalRecord)
    step, _ = run.record.locate(run.time)
    return read_only(belief[np.minimum(step, len(belief) - 1)].T)


def trajectory_of(
    record: DigitalRecord | IdealRecord,
    plant: SwitchedSystem,
    signal: SwitchingSignal,
    gains: np.ndarray | None,
    end: float,
    times: np.ndarray | None,
    diverged: bool,
    message: str,
) -> Trajectory:
    """Sample a record on its own grid, or at the times asked for.

    `gains` are the K of the mismatch. A time within round-off before a switch counts as at it.
    """
    time = record.grid(end) if times is None else times[times <= end]
    states, inputs = read_only(record.states_at(time)), read_only(record.inputs_at(time))
    mismatch = None
    if gains is not None:
        feedback = _exact_feedback(record, plant, signal, gains, time)
        with np.errstate(over="ignore", invalid="ignore"):
            mismatch = (inputs - feedback).T
        mismatch = np.where(np.isinf(mismatch), np.inf, mismatch)
    rest = mismatch, diverged, message, plant, signal, record, end
    return Trajectory(time, states.T, inputs.T, signal(time + record.slack), *rest)


def _exact_feedback(
    record: DigitalRecord | IdealRecord,
    plant: SwitchedSystem,
    signal: SwitchingSignal,
    gains: np.ndarray,
    time: np.ndarray,
) -> np.ndarray:
    """K x (times, m), at the instants at which the inputs of these times are first read."""
    if plant.has_one_delay:
        K, ahead = gains[signal(time + plant.delay + record.slack)], record.ahead_of(time)
        with np.errstate(over="ignore", invalid="ignore"):
            feedback = np.einsum("kij,kj->ki", K, ahead)
        return np.where(np.isfinite(feedback), feedback, np.inf)
    reads = first_reads(signal, plant.delays, time, record.slack)
    feedback = np.full(reads.shape, np.nan)
    for j, read in enumerate(reads.T):
        known = np.flatnonzero(read <= record.last)
        K, x = gains[signal(read[known] + record.slack), j], record.states_at(read[known])
        feedback[known, j] = np.einsum("ki,ki->k", K, x)
    return feedback
