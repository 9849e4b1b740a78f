"""Names, numbers and arrays as C writes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.base.wording import one_line
from deadtime.controller.export.forms import DTYPE, Precision
from deadtime.plant import OperatingPoint, SwitchedSystem


@dataclass(frozen=True)
class Names:
    """Names in an export (immutable); elements without a name are numbered.

    Attributes
    ----------
    title : of the law, or of the plant
    states, modes, inputs : with their units, if they have some
    outputs, tracked : of outputs and of those that follow a reference, likewise

    Examples
    --------
    >>> names = Names("my law", ("position (m)", "speed (m/s)"))
    >>> names.each("states", 2)[1], names.each("inputs", 1)
    ('speed (m/s)', [''])
    """

    title: str = ""
    states: Sequence[str] = ()
    modes: Sequence[str] = ()
    inputs: Sequence[str] = ()
    outputs: Sequence[str] = ()
    tracked: Sequence[str] = ()

    def require(self, **counts: int) -> None:
        """Refuse another number of names than there are states, modes, …"""
        for kind, wanted in counts.items():
            if (given := len(getattr(self, kind))) not in (0, wanted):
                raise ArgumentError(f"names.{kind} must be {wanted} names, got {given}.")

    def each(self, kind: str, count: int) -> Sequence[str]:
        """The names of all states, outputs, …; empty ones where they have none."""
        return getattr(self, kind) or [""] * count

    def point_in_words(self, point: OperatingPoint, plant: SwitchedSystem) -> str:
        """The operating point, by the names of states and inputs."""
        states = tuple(self.states) or tuple(f"x[{i}]" for i in range(plant.states))
        inputs = tuple(self.inputs) or tuple(f"u[{i}]" for i in range(plant.inputs))
        return point.in_words(states, inputs)

    def all_modes(self) -> str:
        """The numbers of the modes with their names, or nothing."""
        return ", ".join(f"{i}: {name}" for i, name in enumerate(self.modes))


def in_comment(text: str) -> str:
    """A text for a comment in C: one line that neither ends nor begins a comment nor splices lines.

    Examples
    --------
    >>> in_comment("ends */ begins /* what ??/")
    'ends * / begins / * what ? ?/'
    """
    return one_line(text).replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")


_LINE = 6  # numbers a line


def literal(value: float, precision: Precision) -> str:
    """The shortest decimal that reads back as the same number; an `f` on a float."""
    if precision == "float":
        text = np.format_float_scientific(np.float32(value), unique=True, trim="-")
        return _with_point(text) + "f"
    return _with_point(repr(float(value)))


def exact(value: float, precision: Precision) -> str:
    """All decimals of a number: the same real in C, in C++ and in contracts, which do not round.

    Examples
    --------
    >>> exact(2.0**70, "double"), exact(2.0**-10, "float")
    ('1180591620717411303424.0', '0.0009765625f')
    """
    return _with_point(str(Decimal(value))) + ("f" if precision == "float" else "")


def _with_point(text: str) -> str:
    return text if set(text) & set(".eE") else text + ".0"


def initializer(
    array: np.ndarray, precision: Precision, indent: int = 0, braces: str = "{}"
) -> str:
    """An array as nested braces, or in the brackets of another language."""
    (begin, end), pad = braces, " " * 4 * indent
    if array.ndim == 1:
        numbers = [literal(value, precision) for value in array.astype(DTYPE[precision])]
        lines = [
            ", ".join(numbers[start : start + _LINE]) for start in range(0, len(numbers), _LINE)
        ]
        return pad + begin + f",\n{pad} ".join(lines) + end
    inner = ",\n".join(initializer(part, precision, indent + 1, braces) for part in array)
    return f"{pad}{begin}\n{inner}\n{pad}{end}"


def brackets(array: np.ndarray) -> str:
    """The shape as C declares it."""
    return "".join(f"[{size}]" for size in array.shape)
