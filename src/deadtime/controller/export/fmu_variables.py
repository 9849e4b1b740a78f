"""The variables of the two kinds of FMU, in the order of their value references."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from deadtime.controller.export.fmi_description import Variable
from deadtime.controller.export.names import Names
from deadtime.controller.export.observer_code import ObserverForm
from deadtime.controller.rest_values import RestValues
from deadtime.plant import SwitchedSystem

_TIME = Variable("time", "Real", "independent", "time, s")


def controller_variables(
    plant: SwitchedSystem,
    names: Names,
    past: np.ndarray,
    rest: RestValues,
    belief: bool = False,
    observer: ObserverForm | None = None,
    measures_outputs: bool = False,
) -> list[Variable]:
    """What a controller of a plant reads and writes; `past` (m,) is the input before the start.

    What it reads is at `rest` until something is connected.

    With a `belief` it is not told the mode: it tells how likely each mode is. With an `observer` it
    is told outputs and what is tracked, and tells the estimate.
    """
    n, m = plant.states, plant.inputs
    p = rest.given.size
    given = _read("y", _each("output at the sample", names.output, p), rest.given)
    if observer is None and not measures_outputs:
        given = _read("x", _each("state at the sample", names.state, n), rest.given)
    referred, told_r, estimated = [], [], []
    if observer is not None:
        size, _, _, r = observer.sizes
        followed = _each("what a tracked output is to follow", names.followed, r)
        referred = _read("reference", followed, rest.reference)
        estimated = _estimated(names, size, plant.states)
        what = "whether reference is read, or the law's own followed"
        told_r = [Variable("report_reference", "Boolean", "parameter", what, False)] * bool(r)
    status = Variable(
        "status", "Integer", "output", "what became of the last sample, 0: all is well"
    )
    told = [
        _mode("mode at the sample, from 0", names),
        status,
        Variable("mode_age", "Integer", "parameter", "age of the first mode, samples", 0),
    ]
    return [
        _TIME,
        *given,
        *_read("applied", _each("what the actuator had", names.input, m), rest.u),
        *referred,
        *_written("u", _each("input, held", names.input, m)),
        *_at_start("u", "input before the start", past),
        *(_believed(names, plant.modes) if belief else []),
        *estimated,
        *([status] if belief else told),
        Variable("report_applied", "Boolean", "parameter", "whether applied is read", False),
        *told_r,
    ]


def plant_variables(
    names: Names, start: np.ndarray, past: np.ndarray, rest_u: np.ndarray
) -> list[Variable]:
    """Variables of a plant; `start` (n,) is its state, `past` (m,) the input before it.

    Its input is `rest_u` until something is connected.
    """
    return [
        _TIME,
        *_read("u", _each("input, held over a step", names.input, past.size), rest_u),
        *_written("x", _each("state", names.state, start.size)),
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


def _believed(names: Names, modes: int) -> list[Variable]:
    called = names.modes or [str(i) for i in range(modes)]
    return [
        Variable(f"belief[{i}]", "Real", "output", f"probability of mode {one}")
        for i, one in enumerate(called, 1)
    ]


def _estimated(names: Names, size: int, states: int) -> list[Variable]:
    texts = [_with_name("estimate of the state", names.state(i)) for i in range(states)]
    texts += ["estimate of a disturbance"] * (size - states)
    return [Variable(f"estimate[{i}]", "Real", "output", text) for i, text in enumerate(texts, 1)]


def _at_start(symbol: str, text: str, values: np.ndarray) -> list[Variable]:
    return [
        Variable(f"{symbol}0[{i}]", "Real", "parameter", text, float(value))
        for i, value in enumerate(values, 1)
    ]


def _mode(what: str, names: Names) -> Variable:
    return Variable("mode", "Integer", "input", _with_name(what, names.all_modes()), 0)


def _each(what: str, name_of: Callable[[int], str], size: int) -> list[str]:
    return [_with_name(what, name_of(i)) for i in range(size)]


def _with_name(what: str, name: str) -> str:
    return f"{what}: {name}" if name else what
