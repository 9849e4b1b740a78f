"""A Python script that makes what a page shows, without the page: plain numbers, public names."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from inspect import Parameter, signature
from typing import Any

import numpy as np

import deadtime
from deadtime import imperfections
from deadtime.base.version import __version__
from deadtime.base.wording import file_name, one_line
from deadtime.estimation import Servo
from deadtime.estimation.servo import Reference
from deadtime.plant import SwitchedSystem
from deadtime.problems import Problem
from deadtime.switching.models.sojourns import Fixed

# How a script's file is called after the problem's name: whatever that is, no `import` finds a file
# with a hyphen, which Python would take instead of a library of the same name.
SCRIPT = "-script.py"

_LINE = 88

_HEAD = '''"""{title}

Written by the explorer of deadtime {version}.
"""

{imports}
import deadtime as dt
from deadtime.reports import plot_laws

'''
_TAIL = """
runs = {{
    name: dt.simulate(
        plant,
        law,
        signal,
{arguments}
    )
    for name, law in laws.items()
}}
for name, run in runs.items():
    print(name, run.metrics({weight})["cost"], "diverged" if run.diverged else "")
plot_laws(
    runs,
    states={states},
    modes={modes},
    inputs={inputs},
{tracked}{colours}).savefig({file})
"""


def script_of(problem: Problem, laws: Sequence[str] = ()) -> str:
    """The script: it builds the same plant, laws and signal, runs them and draws the same figure.

    `laws` are all on offer, which share the colours.

    Examples
    --------
    >>> import deadtime as dt
    >>> text = script_of(dt.problems.paper())
    >>> [line for line in text.splitlines() if line.startswith("laws[")][0]
    'laws["averaged"] = dt.AveragedPredictor(plant=plant, gains=gains, weights=[0.5, 0.5])'
    """
    writer = _Writer()
    body = "".join(_definitions(problem, writer))
    arguments = {
        "x0": problem.x0,
        "horizon": problem.horizon,
        "step": problem.step,
        "u0": np.broadcast_to(np.asarray(problem.u0, dtype=float), (problem.plant.inputs,)),
    }
    if problem.imperfections:
        arguments |= {"imperfections": list(problem.imperfections), "predict": problem.predict}
    if problem.imperfections or any(law.draws for law in problem.laws.values()):
        arguments["seed"] = problem.seed
    lines = [f"{name}={writer.code(value)}," for name, value in arguments.items()]
    tail = _TAIL.format(
        arguments=_indent(lines, 8),
        weight="" if problem.weight is None else writer.code(problem.weight),
        states=writer.code(list(problem.states)),
        modes=writer.code(list(problem.modes)),
        inputs=writer.code(list(problem.inputs)),
        tracked=f"    tracked={writer.code(list(problem.tracked))},\n" if problem.tracked else "",
        colours=f"    laws={writer.code(list(laws))},\n" if laws else "",
        file=_quote(f"{file_name(problem.name) or 'problem'}.png"),
    )
    title = one_line(problem.title).replace("\\", " ").replace('"', "'")
    imports = "\n".join([*sorted(writer.imports), ""])
    return _HEAD.format(title=title, version=__version__, imports=imports) + body + tail


def _definitions(problem: Problem, writer: _Writer) -> Iterator[str]:
    """The plant, the model of the laws, the gains, the signal and the laws."""
    laws = problem.laws.values()
    yield writer.define("plant", problem.plant)
    if problem.model is not None:
        yield writer.define("model", problem.model)
    yield writer.define("gains", problem.gains)
    for model in (getattr(law, "model", None) for law in laws):
        if model is not None:
            yield writer.define("switching", model)
            break
    yield writer.define("signal", problem.signal)
    yield "laws = {}\n"
    for name, law in problem.laws.items():
        yield f"laws[{_quote(name)}] = {writer.code(law)}\n"


class _Writer:
    """Writes values as the code that makes them, by their names where they have one."""

    def __init__(self) -> None:
        self.imports: set[str] = set()
        self._names: dict[str, str] = {}

    def define(self, name: str, value: Any) -> str:
        """The line that gives a value its name."""
        code = self.code(value)
        if code in self._names.values():
            return ""
        self._names[code] = name
        return f"{name} = {code}\n"

    def code(self, value: Any) -> str:
        """The expression that makes a value."""
        code = self._expression(value)
        return self._names.get(code, code)

    def _expression(self, value: Any) -> str:
        if hasattr(value, "dist") and hasattr(value, "kwds"):
            return self._distribution(value)
        if isinstance(value, np.ndarray):
            return self._expression(value.tolist())
        if isinstance(value, tuple) and len(value) > 1:
            return f"({', '.join(self.code(one) for one in value)})"
        if isinstance(value, (tuple, list)):
            return f"[{', '.join(self.code(one) for one in value)}]"
        if isinstance(value, float) and np.isinf(value):
            return 'float("inf")' if value > 0 else 'float("-inf")'
        if isinstance(value, str):
            return _quote(value)
        if isinstance(value, Fixed):
            return repr(value.length)
        if isinstance(value, Reference) and value.distribution is not None:
            return self.code(value.distribution)
        if isinstance(value, Reference) and value.schedule is not None:
            return self._expression((value.schedule.times, value.schedule.values))
        if type(value).__module__.startswith("deadtime."):
            return self._call(value)
        return repr(value)

    def _distribution(self, value: Any) -> str:
        self.imports.add("from scipy import stats")
        given = [self.code(one) for one in value.args]
        given += [f"{name}={self.code(one)}" for name, one in value.kwds.items()]
        return f"stats.{value.dist.name}({', '.join(given)})"

    def _call(self, value: Any) -> str:
        """A call of the class with what it was made of, defaults left out."""
        kind = type(value)
        call = self._callable(kind)
        arguments = [
            f"{name}={self.code(given)}"
            for name, one in signature(kind).parameters.items()
            if not _is_default(given := _given(value, name, one.default), one.default)
        ]
        code = f"{call}({', '.join(arguments)})"
        if len(code) <= _LINE - 10:
            return code
        lines = "".join(f"{line},\n" for line in arguments)
        return f"{call}(\n{_indent(lines.splitlines(), 4)}\n)"

    def _callable(self, kind: type) -> str:
        """A class by its public name, or else by its own, imported."""
        for home, place in (("dt", deadtime), ("dt.imperfections", imperfections)):
            if getattr(place, kind.__name__, None) is kind:
                return f"{home}.{kind.__name__}"
        self.imports.add(f"from {kind.__module__} import {kind.__name__}")
        return kind.__name__


def _indent(lines: list[str], columns: int) -> str:
    """Lines moved to the right, those inside them too."""
    space = " " * columns
    return "\n".join(space + line.replace("\n", "\n" + space) for line in lines)


def _given(value: Any, name: str, default: Any) -> Any:
    if name == "delay" and isinstance(value, SwitchedSystem):
        return value.delay_data
    if isinstance(value, Servo):
        return _given_servo(value, name)
    return getattr(value, name, default)


def _given_servo(servo: Servo, name: str) -> Any:
    """An argument of a servo, whose `plant` and `C` have more states than it was given."""
    if name == "plant":
        return servo.base
    if name == "C":
        return servo.C[:, :, : servo.base.states]
    if name == "disturbance" and not servo.disturbance.size:
        return None
    return getattr(servo, name)


def _is_default(value: Any, default: Any) -> bool:
    if default is Parameter.empty or isinstance(value, np.ndarray):
        return False
    return value is None or value == default


def _quote(text: str) -> str:
    """As Python writes it; characters that do not print, or turn the text around, as escapes."""
    plain = one_line(text) == text
    return json.dumps(text, ensure_ascii=False) if plain else ascii(text)
