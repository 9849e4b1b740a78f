"""Experiment: inputs to send to a plant, and how well their log will tell it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from deadtime.base.checks import brief, read_only
from deadtime.base.errors import ArgumentError
from deadtime.base.files import replacing
from deadtime.base.frozen import Frozen
from deadtime.identification.excitation.input_information import Prospect
from deadtime.identification.parameters import Layout
from deadtime.plant import OperatingPoint, SwitchedSystem

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class Experiment(Frozen):
    """Inputs within limits that tell a plant's delays and matrices well (immutable).

    Attributes
    ----------
    plant : SwitchedSystem
        What they were designed for.
    time : (T,) array
        Seconds; an input is held from its row's time to the next one's.
    inputs : (m, T) array
        To be sent, as deviations from rest; with a law, to be added to what it asks for.
    mode : (T,) array
        To be held from each row to the next.
    delay_errors : dict of (delays,) arrays
        Standard errors of the delays that are to be expected, seconds: "experiment", and beside it
        "prbs", the best maximum-length binary sequence within the same limits, and "step".
    clock : int
        For how many rows each value of that sequence is held.
    errors : (size,) array
        Standard errors of all unknowns, in the order of `names`.
    largest : (n + m,) array
        What every |state| and |input| stays below, at three standard deviations of the noise.
    added : bool
        Whether the inputs are added to a law's.
    sentences : tuple of str
        What there is to say, in words.

    Examples
    --------
    See `design_experiment`.
    """

    plant: SwitchedSystem
    time: Float[np.ndarray, " T"]
    inputs: Float[np.ndarray, "m T"]
    mode: Int[np.ndarray, " T"]
    delay_errors: Mapping[str, Float[np.ndarray, " delay"]]
    clock: int
    errors: Float[np.ndarray, " size"]
    largest: Float[np.ndarray, " y"]
    added: bool
    sentences: tuple[str, ...]
    _layout: Layout = field(repr=False)

    @classmethod
    def of(
        cls,
        plant: SwitchedSystem,
        step: float,
        prospect: Prospect,
        r: Float[np.ndarray, "T m"],
        peers: Mapping[str, Float[np.ndarray, "T m"]],
        clock: int,
        averaged: bool,
    ) -> Experiment:
        """What there is to hand over of inputs r, and of others beside them.

        averaged : whether modes have a noise of their own each, and its mean was counted with
        """
        layout, chain = prospect.layout, prospect.chain
        every = {name: prospect.errors(one)[layout.at_delays] for name, one in peers.items()}
        errors = prospect.errors(r)
        told = {"experiment": errors[layout.at_delays], **every}
        told = {name: read_only(one) for name, one in told.items()}
        largest = prospect.reach(r).max(axis=0)
        said = _sentences(plant, step, layout, told, clock, largest)
        if chain.V.any():
            noise = ", ".join(f"{v:.3g}" for v in np.sqrt(chain.V))
            said += (f"Sensors are taken to be noisy, with deviations of {noise}.",)
        if averaged:
            said += (
                "Noise of the plant is taken to be the same in all modes, the mean of theirs over "
                "the rows, as identify finds one for all where sensors are noisy.",
            )
        time = step * np.arange(len(r))
        closed = not chain.open
        return cls(plant, time, r.T, chain.mode, told, clock, errors, largest, closed, said, layout)

    @property
    def names(self) -> tuple[str, ...]:
        """The unknowns, as an `Identification` of the log will name them."""
        return tuple(self._layout.names())

    def standard_error(self, name: str) -> float:
        """The standard error of an unknown that is to be expected, by its name in `names`."""
        if name not in self.names:
            known = ", ".join(self.names)
            raise ArgumentError(f"name must be one of {known}, got {brief(name)}.")
        return float(self.errors[self.names.index(name)])

    @property
    def message(self) -> str:
        """The sentences, as one text."""
        return " ".join(self.sentences)

    def sent(self, operating_point: OperatingPoint | None) -> Float[np.ndarray, "m T"]:
        """`inputs` as the actuators get them, u₀ + u; what is added to a law's stays as it is."""
        if operating_point is None or self.added:
            return self.inputs
        return operating_point.u[:, None] + self.inputs

    def to_pandas(self, operating_point: OperatingPoint | None = None) -> pd.DataFrame:
        """A table with columns t, u1, … (add_u1, … where a law's are added to) and mode.

        With an operating point u1, … are u₀ + u.
        """
        import pandas as pd

        head, sent = "add_u" if self.added else "u", self.sent(operating_point)
        columns = {"t": self.time} | {f"{head}{j + 1}": u for j, u in enumerate(sent)}
        return pd.DataFrame({**columns, "mode": self.mode})

    def to_csv(
        self, path: str | PathLike[str], operating_point: OperatingPoint | None = None
    ) -> None:
        """Write that table as CSV: a row per period, to be replayed.

        Raises
        ------
        ArgumentError
            If the file cannot be written.
        """
        table = self.to_pandas(operating_point)
        table["t"] = [f"{t:.12g}" for t in self.time]
        with replacing(path) as place:
            table.to_csv(place, index=False, float_format="%.12g")


def _sentences(
    plant: SwitchedSystem,
    step: float,
    layout: Layout,
    told: Mapping[str, np.ndarray],
    clock: int,
    largest: np.ndarray,
) -> tuple[str, ...]:
    """What to expect, beside what is usual; and where the promise is weaker."""
    names = layout.names()[layout.at_delays]
    held = "" if clock == 1 else f", each value held for {clock} periods"
    said = []
    for place, name in enumerate(names):
        own, prbs, edge = (1e3 * float(told[key][place]) for key in ("experiment", "prbs", "step"))
        said.append(
            f"Standard error of {name} to be expected: {own:.3g} ms; of the best binary sequence "
            f"(PRBS{held}) {_milliseconds(prbs)}, of a step {_milliseconds(edge)}."
        )
    D = plant.delays if layout.per_mode else plant.delays[0]
    off = np.abs(D - step * np.rint(D / step)).ravel()
    near = [n for n, o, e in zip(names, off, told["experiment"], strict=True) if o < 2.0 * e]
    if near:
        are, its = ("are", "their intervals") if len(near) > 1 else ("is", "its interval")
        said.append(
            f"{', '.join(near)} {are} within two standard errors of a whole number of periods, "
            f"where the likelihood has a kink: {its} may be longer or shorter than promised."
        )
    n = plant.states
    states, inputs = (", ".join(f"{v:.3g}" for v in part) for part in np.split(largest, [n]))
    said.append(
        f"At three standard deviations of the noise |x| stays below {states}, |u| below {inputs}."
    )
    return tuple(said)


def _milliseconds(value: float) -> str:
    return f"{value:.3g} ms" if np.isfinite(value) else "infinite: it does not tell it"
