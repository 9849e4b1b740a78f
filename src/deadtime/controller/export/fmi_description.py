"""modelDescription.xml of FMI 2.0 and 3.0, from one list of variables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple
from xml.etree import ElementTree as xml

import numpy as np

from deadtime.base.version import __version__
from deadtime.base.wording import one_line
from deadtime.controller.export.c_text import Names

if TYPE_CHECKING:
    from deadtime.controller.running import RunningLaw


class Variable(NamedTuple):
    """A scalar variable; its value reference is its place in the list: reals first, then integers,
    then Booleans."""

    name: str
    kind: Literal["Real", "Integer", "Boolean"]
    causality: Literal["independent", "input", "output", "parameter"]
    description: str
    start: float | int | bool | None = None
    follows: str | None = None  # the parameter that gives an output's initial value


_TIME = Variable("time", "Real", "independent", "time, s")


def controller_variables(controller: RunningLaw, names: Names, past: np.ndarray) -> list[Variable]:
    """The variables that a controller reads and writes; `past` (m,) is the input before the start.

    Inputs are at the operating point until something is connected. With a mode filter the belief is
    an output, and there is no mode input. With an observer outputs and references are inputs, and
    the estimate is an output.
    """
    plant, rest, observing = controller.law.plant, controller.rest, controller.observing
    inputs, p = names.each("inputs", plant.inputs), rest.given.size
    belief = controller.mode_belief is not None
    if controller.law.outputs is None:
        given = _read("x", _each("state at the sample", names.each("states", p)), rest.given)
    else:
        given = _read("y", _each("output at the sample", names.each("outputs", p)), rest.given)
    referred, reference_flag, estimated = [], [], []
    if observing is not None:
        size, r = observing.memory.sizes.n, observing.memory.sizes.r
        followed = _each("reference of a tracked output", names.each("tracked", r))
        referred = _read("reference", followed, rest.reference)
        estimated = _estimated(names, size, plant.states)
        what = "whether reference is used, or the law's own"
        reference_flag = [Variable("report_reference", "Boolean", "parameter", what, False)] * bool(
            r
        )
    status = Variable("status", "Integer", "output", "outcome of the last sample, 0: no error")
    reported = [
        _mode("mode at the sample, from 0", names),
        status,
        Variable("mode_age", "Integer", "parameter", "age of the first mode, samples", 0),
    ]
    return [
        _TIME,
        *given,
        *_read("applied", _each("input that the actuator applied", inputs), rest.u),
        *referred,
        *_written("u", _each("input, held", inputs)),
        *_at_start("u", "input before the start", past),
        *(_belief_outputs(names, plant.modes) if belief else []),
        *estimated,
        *([status] if belief else reported),
        Variable("report_applied", "Boolean", "parameter", "whether applied is used", False),
        *reference_flag,
    ]


def plant_variables(
    names: Names, start: np.ndarray, past: np.ndarray, rest_u: np.ndarray
) -> list[Variable]:
    """Variables of a plant; `start` (n,) is its state, `past` (m,) the input before it.

    Its input is `rest_u` until something is connected.
    """
    return [
        _TIME,
        *_read("u", _each("input, held over a step", names.each("inputs", past.size)), rest_u),
        *_written("x", _each("state", names.each("states", start.size))),
        *_at_start("x", "state at the start", start),
        *_at_start("u", "input before the start", past),
        _mode("mode over a step, from 0", names),
    ]


def _read(symbol: str, texts: Sequence[str], values: np.ndarray) -> list[Variable]:
    each = enumerate(zip(texts, values.tolist(), strict=True), 1)
    return [Variable(f"{symbol}[{i}]", "Real", "input", *one) for i, one in each]


def _written(symbol: str, texts: Iterable[str]) -> list[Variable]:
    return [
        Variable(f"{symbol}[{i}]", "Real", "output", text, follows=f"{symbol}0[{i}]")
        for i, text in enumerate(texts, 1)
    ]


def _belief_outputs(names: Names, modes: int) -> list[Variable]:
    called = names.modes or [str(i) for i in range(modes)]
    return [
        Variable(f"belief[{i}]", "Real", "output", f"probability of mode {one}")
        for i, one in enumerate(called, 1)
    ]


def _estimated(names: Names, size: int, states: int) -> list[Variable]:
    texts = _each("estimate of the state", names.each("states", states))
    texts += ["estimate of a disturbance"] * (size - states)
    return [Variable(f"estimate[{i}]", "Real", "output", text) for i, text in enumerate(texts, 1)]


def _at_start(symbol: str, text: str, values: np.ndarray) -> list[Variable]:
    return [
        Variable(f"{symbol}0[{i}]", "Real", "parameter", text, float(value))
        for i, value in enumerate(values, 1)
    ]


def _mode(what: str, names: Names) -> Variable:
    return Variable("mode", "Integer", "input", _with_name(what, names.all_modes()), 0)


def _each(what: str, names: Iterable[str]) -> list[str]:
    return [_with_name(what, name) for name in names]


def _with_name(what: str, name: str) -> str:
    return f"{what}: {name}" if name else what


Version = Literal["2.0", "3.0"]


class FmuDescription(NamedTuple):
    """The general attributes of an FMU: names, token, step and sources."""

    identifier: str
    title: str
    token: str
    step: float | None
    sources: Sequence[str]


_KINDS = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean"}


def description(model: FmuDescription, variables: Sequence[Variable], version: Version) -> str:
    """The text of modelDescription.xml."""
    token = {"2.0": "guid", "3.0": "instantiationToken"}[version]
    attributes = {
        "fmiVersion": version,
        "modelName": one_line(model.title),
        token: model.token,
        "generationTool": f"deadtime {__version__}",
        "variableNamingConvention": "structured",
    }
    root = xml.Element("fmiModelDescription", attributes)
    state = "FMUstate" if version == "2.0" else "FMUState"
    abilities = {
        "modelIdentifier": model.identifier,
        "canHandleVariableCommunicationStepSize": "true",
        f"canGetAndSet{state}": "true",
        f"canSerialize{state}": "true",
    }
    if version == "2.0":
        abilities["canNotUseMemoryManagementFunctions"] = "true"
    elif model.step is not None:
        abilities["fixedInternalStepSize"] = repr(model.step)
    simulation = xml.SubElement(root, "CoSimulation", abilities)
    if version == "2.0":
        files = xml.SubElement(simulation, "SourceFiles")
        for name in model.sources:
            xml.SubElement(files, "File", {"name": name})
    units = xml.SubElement(root, "UnitDefinitions")
    xml.SubElement(xml.SubElement(units, "Unit", {"name": "s"}), "BaseUnit", {"s": "1"})
    experiment = {"startTime": "0"} | ({} if model.step is None else {"stepSize": repr(model.step)})
    xml.SubElement(root, "DefaultExperiment", experiment)
    listed = xml.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        (_variable2 if version == "2.0" else _variable3)(listed, variable, reference)
    _structure(root, variables, version)
    return _text(root)


def build_description(model: FmuDescription) -> str:
    """The text of sources/buildDescription.xml, of FMI 3.0."""
    root = xml.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    build = xml.SubElement(root, "BuildConfiguration", {"modelIdentifier": model.identifier})
    files = xml.SubElement(build, "SourceFileSet", {"language": "C99"})
    for name in model.sources:
        xml.SubElement(files, "SourceFile", {"name": name})
    return _text(root)


def _text(root: xml.Element) -> str:
    xml.indent(root)
    heading = '<?xml version="1.0" encoding="UTF-8"?>'
    return f"{heading}\n{xml.tostring(root, encoding='unicode')}\n"


def _common(variable: Variable, reference: int) -> dict[str, str]:
    attributes = {
        "name": variable.name,
        "valueReference": str(reference),
        "description": one_line(variable.description),
        "causality": variable.causality,
        "variability": _variability(variable),
    }
    if variable.causality == "output":
        attributes["initial"] = "calculated"
    elif variable.causality == "parameter":
        attributes["initial"] = "exact"
    return attributes


def _variability(variable: Variable) -> str:
    """Continuous for reals except parameters: outputs of a controller jump at its samples."""
    if variable.causality == "parameter":
        return "fixed"
    return "continuous" if variable.kind == "Real" else "discrete"


def _start(variable: Variable) -> dict[str, str]:
    if variable.start is None:
        return {}
    start = variable.start
    return {"start": str(start).lower() if isinstance(start, bool) else repr(start)}


def _unit(variable: Variable) -> dict[str, str]:
    """Only of time: units of states and inputs are text, in the descriptions."""
    return {"unit": "s"} if variable.causality == "independent" else {}


def _variable2(listed: xml.Element, variable: Variable, reference: int) -> None:
    scalar = xml.SubElement(listed, "ScalarVariable", _common(variable, reference))
    xml.SubElement(scalar, variable.kind, _start(variable) | _unit(variable))


def _variable3(listed: xml.Element, variable: Variable, reference: int) -> None:
    attributes = _common(variable, reference) | _start(variable) | _unit(variable)
    xml.SubElement(listed, _KINDS[variable.kind], attributes)


def _structure(root: xml.Element, variables: Sequence[Variable], version: Version) -> None:
    """Outputs depend on no input directly: a value that is set acts in the next step."""
    structure = xml.SubElement(root, "ModelStructure")
    outputs = [i for i, variable in enumerate(variables) if variable.causality == "output"]
    names = [variable.name for variable in variables]
    first = 1 if version == "2.0" else 0  # an index, or a value reference
    key = "index" if version == "2.0" else "valueReference"
    for group in ("Output", "InitialUnknown"):
        parent = structure if version == "3.0" else xml.SubElement(structure, f"{group}s")
        for i in outputs:
            of = variables[i].follows if group == "InitialUnknown" else None
            depends = "" if of is None else str(names.index(of) + first)
            attributes = {key: str(i + first), "dependencies": depends}
            xml.SubElement(parent, group if version == "3.0" else "Unknown", attributes)
