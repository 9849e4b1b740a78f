"""The [servo] of a problem file: outputs that follow a reference, and the gains for it."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from pydantic import Field

from deadtime.base.checks import real_array, require_shape
from deadtime.base.errors import ArgumentError
from deadtime.base.files import read_text
from deadtime.estimation import Observer, Servo
from deadtime.estimation.servo import Reference
from deadtime.imperfections import Imperfection, Limiting, Sizes
from deadtime.plant import SwitchedSystem
from deadtime.problems.toml import Shape
from deadtime.problems.toml.sections import (
    DistributionSection,
    Matrices,
    Matrix,
    Section,
    Texts,
    Vector,
    frozen,
)

MOST_BYTES = 10_000_000


class ScheduleSection(Section):
    """Values from their times on."""

    times: Annotated[Vector, Shape("(count,)", [0.0, 5.0])] = Field(
        description="When each value begins, seconds; the first holds from the start."
    )
    values: Annotated[Vector | Matrix, Shape("(count,) or (count, tracked)", [0.0, 1.0])]


class RecordedSection(Section):
    """Values from a CSV file with a column time and one for each tracked output."""

    file: str = Field(description="A path, relative to the problem file.")


class ServoSection(Section):
    """Outputs follow a reference: measured ones beside an [observer], states without.

    [gains] are then designed for the states and the sums of errors, (x, q), at the run's period.
    """

    tracked: Annotated[
        Texts | Matrix | None, Shape("names of outputs, or (tracked, p)", ["position"])
    ] = Field(
        None,
        description="Tracked outputs: names (of states, without [observer]), or rows of "
        "combinations; all outputs by default.",
    )
    reference: Annotated[
        float | Vector | ScheduleSection | RecordedSection | DistributionSection,
        Shape(
            "a number, (tracked,), { times = …, values = … }, { file = … }, { distribution = … }",
            {"times": [0.0, 5.0], "values": [0.0, 1.0]},
        ),
    ] = Field(0.0, description="A constant, steps, a CSV file, or a distribution to draw from.")
    integral: bool = Field(
        True, description="Sum the errors, so that no constant error of the model leaves an offset."
    )
    disturbance: Annotated[
        Matrix | Matrices | None, Shape("(n, k), or one for each mode", [[0.0], [1.0]])
    ] = Field(
        None,
        description="How constant disturbances act on dx/dt, which the [observer] then estimates.",
    )


@dataclass(frozen=True, eq=False)
class FileServo:
    """The servos of plants, as a [servo] describes them.

    C, (p, n) or (modes, p, n), gives the measured `outputs`; H, (tracked, p), selects those that
    follow the reference.
    """

    section: ServoSection
    C: Float[np.ndarray, ...]
    outputs: Sequence[str]
    H: Float[np.ndarray, "tracked p"]
    reference: Reference

    @classmethod
    def of(
        cls, section: ServoSection, C: Float[np.ndarray, ...], outputs: Sequence[str], folder: Path
    ) -> FileServo:
        """The servos for the outputs of a file; relative paths start at `folder`."""
        H = _tracked(section.tracked, outputs)
        names = [outputs[int(np.argmax(row))] if _is_one(row) else "" for row in H]
        return cls(section, C, outputs, H, _reference(section.reference, len(H), names, folder))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the tracked outputs."""
        return tuple(
            self.outputs[int(np.argmax(row))] if _is_one(row) else _combination(row, self.outputs)
            for row in self.H
        )

    def of_plant(self, plant: SwitchedSystem) -> Servo:
        """The servo of a plant."""
        section = self.section
        return Servo(
            plant, self.C, self.H, integral=section.integral, disturbance=section.disturbance
        )

    def require_reach(
        self,
        plant: SwitchedSystem,
        imperfections: Sequence[Imperfection],
        step: float,
        force: Float[np.ndarray, "mode n"],
    ) -> None:
        """Refuse a reference that some mode cannot hold within the input limits.

        `force` is the constant force on dx/dt in every mode.
        """
        servo = self.of_plant(plant)
        for low, high in absolute_limits(imperfections, Sizes.of(plant, step)):
            for r in self.reference.values:
                steady = servo.steady_input(r, force)
                beyond = ((steady < low) | (steady > high)).any(axis=1)
                if beyond.any():
                    mode = int(np.argmax(beyond))
                    raise ArgumentError(
                        f"reference {_text_of(r)} is out of reach: in mode {mode} it needs the "
                        f"steady input {_text_of(steady[mode])}, and the saturation allows "
                        f"{_text_of(low)} to {_text_of(high)}: change one of them."
                    )

    def of_mean(self, mean: SwitchedSystem) -> Servo:
        """The servo of the mean of extended plants, in x and d."""
        n, C = np.shape(self.C)[-1], np.asarray(self.C)
        base = SwitchedSystem(mean.A[:, :n, :n], mean.B[:, :n], mean.delays)
        k = 0 if self.section.disturbance is None else np.shape(self.section.disturbance)[-1]
        E = mean.A[:, :n, n : n + k] if k else None
        C = C if C.ndim == 2 else C.mean(axis=0)
        return Servo(base, C, self.H, integral=self.section.integral, disturbance=E)


def absolute_limits(
    imperfections: Sequence[Imperfection], sizes: Sizes
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Bounds (m,) of every saturation."""
    clips = [one.limits(sizes) for one in imperfections if isinstance(one, Limiting)]
    return [(clip.low, clip.high) for clip in clips if not clip.relative]


def _text_of(values: Float[np.ndarray, " size"]) -> str:
    """One number, or a list of them."""
    whole = [float(f"{value:.6g}") for value in values]
    return f"{whole[0]:g}" if len(whole) == 1 else str(whole)


def watching(servo: Servo, step: float) -> Observer:
    """The observer of a measured state: x̂ = y."""
    return Observer(servo.model, servo.C, np.eye(servo.base.states), step)


def _is_one(row: Float[np.ndarray, " p"]) -> bool:
    """Whether a row picks one output as it is."""
    return bool(np.count_nonzero(row) == 1 and row.max() == 1.0)


def _combination(row: Float[np.ndarray, " p"], outputs: Sequence[str]) -> str:
    parts = [f"{value:g} {name}" for value, name in zip(row, outputs, strict=True) if value]
    return " + ".join(parts) or "0"


def _tracked(given: Any, outputs: Sequence[str]) -> Float[np.ndarray, "tracked p"]:
    if given is None:
        return np.eye(len(outputs))
    if not given:
        raise ArgumentError("tracked must name an output, got none.")
    if not all(isinstance(name, str) for name in given):
        H = real_array("tracked", given, "(tracked, p)", 2)
        return require_shape("tracked", H, (len(H), len(outputs)), "(tracked, p)")
    unknown = [name for name in given if name not in outputs]
    if unknown:
        raise ArgumentError(
            f"tracked must be names of measured outputs, {', '.join(map(repr, outputs))}, got "
            f"{unknown[0]!r}."
        )
    return np.eye(len(outputs))[[list(outputs).index(name) for name in given]]


def _reference(given: Any, size: int, names: Sequence[str], folder: Path) -> Reference:
    match given:
        case ScheduleSection():
            return Reference.of((np.array(given.times), given.values), size)
        case RecordedSection():
            return Reference.of(_recorded(folder / given.file, size, names), size)
        case DistributionSection():
            return Reference.of(frozen("reference", given), size)
        case _:
            return Reference.of(given, size)


def _recorded(path: Path, size: int, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Times and values of a CSV file: the columns of the tracked names, or as many as there are."""
    try:
        rows = list(csv.reader(io.StringIO(read_text(path, MOST_BYTES), newline="")))
    except csv.Error as error:
        raise ArgumentError(f"{path} is no CSV: {error}.") from None
    header = [cell.strip() for cell in rows[0]] if rows else []
    others = [name for name in header if name != "time"]
    # Combinations of outputs have no name: their columns are in the order of the file.
    columns = list(names) if all(name in others for name in names) else others
    if "time" not in header or len(columns) != size:
        raise ArgumentError(
            f"{path} must have the columns time and one for each of the {size} tracked outputs, "
            f"got {', '.join(header) or 'nothing'}."
        )
    places, numbers = [header.index(name) for name in ("time", *columns)], []
    for line, row in enumerate(rows[1:], 2):
        if not row:
            continue
        try:
            numbers.append([float(row[place]) for place in places])
        except (ValueError, IndexError):
            raise ArgumentError(f"{path}, line {line}: every column must hold a number.") from None
    if not numbers:
        raise ArgumentError(f"{path} must have a row for each time, got a header alone.")
    table = np.array(numbers)
    return table[:, 0], table[:, 1:]
