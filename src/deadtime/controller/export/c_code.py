"""`export_c`: a controller as self-contained C99."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deadtime.base.checks import count, number
from deadtime.base.errors import ArgumentError
from deadtime.base.files import Staging, unwritable
from deadtime.base.version import __version__
from deadtime.controller.export import belief_code, observer_code, prediction_code, rest_code
from deadtime.controller.export.bounds import largest, require_exportable
from deadtime.controller.export.c_text import (
    Names,
    brackets,
    exact,
    in_comment,
    initializer,
    literal,
)
from deadtime.controller.export.compiler import SelfCheck, require_own, self_check
from deadtime.controller.export.forms import (
    BYTES,
    Form,
    Precision,
    TableExtra,
    form_of,
    ram_bytes,
    require_budget,
    rom_bytes,
)
from deadtime.controller.export.law_record import LawRecord
from deadtime.controller.export.observer_code import ObserverForm
from deadtime.controller.export.prediction_code import PredictionForm

if TYPE_CHECKING:
    import numpy as np
    from jinja2 import Environment

    from deadtime.controller.running import RunningLaw

_ACCURACY = {"double": 1e-13, "float": 1e-7}
_TOLERANCE = {"double": 1e-12, "float": 2e-5}
_OF_A_BANK = 1e-9  # a jump of y makes residuals, and the round-off of densities, large
_FILES = {
    "controller.h": "{}.h",
    "controller.c": "{}.c",
    "tables.h": "{}_tables.h",
    "main.c": "main.c",
    "check.c": "{}_check.c",
    "eva.c": "{}_eva.c",
    "Makefile": "Makefile",
}


@dataclass(frozen=True)
class Exported:
    """The files that `export_c` wrote, their sizes and the self-check (immutable).

    Attributes
    ----------
    folder : Path
    files : names in it
    form : "dense", "low rank" or "factorised", with its size
    rom, ram : bytes of constants, and of one controller (about)
    error : of a table of low rank, relative to the sum of the moduli of a row's taps
    check : the result of compiling it and running its vectors
    """

    folder: Path
    files: tuple[str, ...]
    form: str
    rom: int
    ram: int
    error: float
    check: SelfCheck

    def __str__(self) -> str:
        return (
            f"{self.folder}: {', '.join(self.files)}; {self.form}; "
            f"tables (ROM) {self.rom} bytes, state (RAM) {self.ram} bytes; {self.check.message}"
        )


def export_c(
    controller: RunningLaw,
    folder: str | Path,
    *,
    precision: Precision = "double",
    accuracy: float | None = None,
    rom_budget: int | None = None,
    name: str = "controller",
    names: Names | None = None,
    prediction: bool = False,
    staging: Staging | None = None,
) -> Exported:
    """See `Controller.export_c`; with `staging` the files appear together with its other files."""
    names = names or Names()
    texts, form = c_sources(controller, precision, accuracy, rom_budget, name, names, prediction)
    folder = Path(folder)
    require_own(folder, texts)
    with Staging() if staging is None else nullcontext(staging) as staged:
        place = staged.folder(folder)
        try:
            for file, text in texts.items():
                (place / file).write_text(text, encoding="utf-8", newline="\n")
        except OSError as error:
            raise unwritable("folder", folder, error) from None
        check = self_check(place, name)
    check = check._replace(message=check.message.replace(str(place), str(folder)))
    return Exported(
        folder,
        tuple(texts),
        description(form),
        *_room(controller, form, precision, prediction),
        form.error,
        check,
    )


def c_sources(
    controller: RunningLaw,
    precision: Precision,
    accuracy: float | None,
    rom_budget: int | None,
    name: str,
    names: Names,
    prediction: bool = False,
) -> tuple[dict[str, str], Form]:
    """The text of every file, and the form that the table took."""
    from deadtime.controller.export.vectors import vectors

    require_exportable(controller, precision, name)
    plant, (outputs, tracked) = controller.law.plant, _measured(controller)
    names.require(states=plant.states, modes=plant.modes, inputs=plant.inputs)
    names.require(outputs=outputs, tracked=tracked)
    accuracy = _ACCURACY[precision] if accuracy is None else number("accuracy", accuracy)
    if not 0.0 <= accuracy < 1.0:
        raise ArgumentError(f"accuracy must be at least 0 and below 1, got {accuracy:g}.")
    budget = None if rom_budget is None else count("rom_budget", rom_budget)
    # These tables cannot be compressed: the law's table gets the rest of the budget.
    beside = _beside(controller, precision, prediction)
    left = None if budget is None else budget - beside.rom
    form = form_of(controller.table, accuracy, precision, left)
    require_budget(controller.table, form, precision, budget, beside)
    made = vectors(controller)
    values = (
        _values(controller, form, precision, name, prediction)
        | _words(controller, names)
        | rest_code.values(controller, precision)
        | {
            "scale": literal(made.scale, "double"),
            "tolerance": literal(_tolerance(controller, precision) + form.error, "double"),
            "line": made.line + 80,
            "amplitude": literal(made.amplitude, "double"),
            "mode_age": made.mode_age,
            "visited": made.rows,
        }
    )
    pages = environment("c")
    texts = {
        file.format(name): pages.get_template(f"{template}.j2").render(values)
        for template, file in _FILES.items()
    }
    return texts | {f"{name}_vectors.csv": made.csv}, form


def _tolerance(controller: RunningLaw, precision: Precision) -> float:
    """Allowed difference of the C, relative to the largest sum of moduli of terms."""
    return _OF_A_BANK if belief_code.outputs_of(controller.mode_belief) else _TOLERANCE[precision]


def environment(folder: str) -> Environment:
    """The templates of a folder, for C: nothing is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("deadtime.controller.export", f"templates/{folder}"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    made.filters["two"] = lambda power: literal(2.0**power, "double")
    made.filters["exact"] = lambda value: exact(value, "double")
    return made


def description(form: Form) -> str:
    """A form in a few words."""
    if form.kind == "factorised":
        order = form.sizes["order"]
        return f"factorised, order {order}: computing time per call does not depend on the delay"
    if form.kind == "low rank":
        return f"low rank {form.sizes['rank']}: off by {form.error:.0e} of the sum of |taps|"
    return "dense: computing time per call grows in proportion to the delay"


def _values(
    controller: RunningLaw, form: Form, precision: Precision, name: str, prediction: bool
) -> dict[str, Any]:
    """The values that fill the templates."""
    table, plant, prefix = controller.table, controller.law.plant, name.upper()
    arrays, sizes, limits, belief, observer, ahead = LawRecord.of(
        controller, form, precision, prediction
    )
    tables = [_table(key, *array, precision) for key, array in arrays.items()]
    rom, ram = _room(controller, form, precision, prediction)
    beside = [values for values in (belief, observer) if values is not None]
    # The last digit is not 0: cleared memory is no state of this law.
    content = repr((tables, controller.step, table.ages, __version__, *beside))
    magic = hashlib.sha256(content.encode()).hexdigest()[:7] + "d"
    return {
        **{key: exact(value, precision) for key, value in limits.items()},
        **sizes,
        "decimal": f"{limits['bound']:.0e}",
        "version": __version__,
        "p": name,
        "P": prefix,
        "kind": form.kind,
        "form": description(form)[:1].upper() + description(form)[1:] + ".",
        "real": precision,
        "largest": literal(largest(precision), precision),
        "step": literal(controller.step, "double"),
        "delay": literal(plant.longest_delay, "double"),
        "longest": "" if plant.has_one_delay else "longest ",
        "length": ("{0}_PAST" if form.windows else "{0}_TAPS * {0}_INPUTS").format(prefix),
        "count": "count" if form.windows else f"{prefix}_LENGTH",
        "rom": rom,
        "ram": ram,
        "unroll": 2 * form.state + 10 + (ram if beside else 0),
        "tables": tables,
        "belief": belief,
        "observer": observer,
        "prediction": ahead,
        **given_of(controller),
        "magic": magic,
    }


def given_of(controller: RunningLaw) -> dict[str, Any]:
    """The argument of `update`: x, or y with an observer or filters of outputs; tracked outputs."""
    tracked = _measured(controller)[1]
    if controller.law.outputs is None:
        return {"given": "x", "size": "STATES", "tracked": tracked}
    return {"given": "y", "size": "OUTPUTS", "tracked": tracked}


def _table(name: str, array: np.ndarray, comment: str, precision: Precision) -> dict[str, str]:
    """One table for the template."""
    text = initializer(array, precision)
    return {"name": name, "comment": comment, "shape": brackets(array), "text": text}


def _room(
    controller: RunningLaw, form: Form, precision: Precision, prediction: bool
) -> tuple[int, int]:
    """Bytes of constants, and of one controller."""
    beside = _beside(controller, precision, prediction)
    rom = rom_bytes(controller.table, form, precision) + beside.rom
    return rom, ram_bytes(controller.table, form, precision) + beside.ram


def _beside(controller: RunningLaw, precision: Precision, prediction: bool) -> TableExtra:
    """The names and bytes of all tables beside the law's."""
    parts, integers, ram = {}, 0, 0
    if controller.mode_belief is not None:
        parts["the mode filter"] = belief_code.arrays(controller.mode_belief)
        ram = belief_code.ram_bytes(controller.mode_belief)
    if controller.observing is not None:
        form = ObserverForm.of(controller.observing)
        parts["the observer"] = observer_code.arrays(form)
        integers, ram = observer_code.integer_bytes(form), observer_code.ram_bytes(form, precision)
    if prediction:
        ahead = PredictionForm.of(controller)
        parts["the prediction"] = prediction_code.arrays(ahead)
        integers += 4 * ahead.of_input.size
    if point := rest_code.arrays(controller, prediction):
        parts["the operating point"] = point
    numbers = sum(array.size for arrays in parts.values() for array, _ in arrays.values())
    single = BYTES["float"] * numbers + integers if controller.mode_belief is None else None
    return TableExtra(" and ".join(parts), BYTES[precision] * numbers + integers, ram, single)


def _measured(controller: RunningLaw) -> tuple[int, int]:
    """How many outputs the law receives, and how many references it follows."""
    tracked = 0 if controller.observing is None else controller.observing.memory.sizes.r
    return (0 if controller.law.outputs is None else controller.measured), tracked


def _words(controller: RunningLaw, names: Names) -> dict[str, Any]:
    """The entries of the header's comment."""
    import numpy as np

    law, limits = names.title or controller.law.label, "none"
    low, high = controller.limits
    if np.isfinite(low).any() or np.isfinite(high).any():
        limits = f"{low.tolist()} to {high.tolist()}"
    return {
        "point": rest_code.in_words(controller, names),
        "title": in_comment(f'Controller of the law "{law}"'),
        "limits": limits,
        "state_names": in_comment(
            _element_names("z" if controller.observing else "x", names.states)
        ),
        "input_names": in_comment(_element_names("u", names.inputs)),
        "output_names": in_comment(_element_names("y", names.outputs)),
        "reference_names": in_comment(_element_names("r", names.tracked)),
        "mode_names": in_comment(names.all_modes()),
    }


def _element_names(letter: str, names: Sequence[str]) -> str:
    """The elements of an array with their names, or nothing."""
    return ", ".join(f"{letter}[{i}]: {one}" for i, one in enumerate(names))
