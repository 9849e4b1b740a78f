"""Parameters and laws that a sweep knows by name.

A parameter writes its value into a problem file, here nested dictionaries and lists as TOML has
them. Entries without a parameter are reached by their paths: ``plant.delay``, ``run.x0.1``,
``law.averaged.low_pass``, ``imperfection.noise.std``. Families of sojourn times are comparable: all
are at least τ_d, all have the mean 2 τ_d.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deadtime.base.errors import ArgumentError
from deadtime.feedback import Law
from deadtime.plant import SwitchedSystem
from deadtime.problems.imperfection_registry import SWEPT, Swept
from deadtime.problems.law_registry import LAWS, LEVELS, LawSetting, NamedLaw

TAIL = 2.5  # the Lomax distribution's shape: finite variance, infinite third moment

# Name: (description, section of a problem file for τ_d), in the order of maps.
FAMILIES: Mapping[str, tuple[str, Callable[[float], Any]]] = {
    "exponential": (
        "τ_d plus an exponential time of mean τ_d",
        lambda time: {"distribution": "expon", "loc": time, "scale": time},
    ),
    "uniform": (
        "uniform between τ_d and 3 τ_d",
        lambda time: {"distribution": "uniform", "loc": time, "scale": 2.0 * time},
    ),
    "heavy-tailed": (
        f"τ_d plus a Lomax (Pareto II) time of mean τ_d and shape {TAIL:g}, whose variance is "
        "finite, 5 times that of the exponential, and whose third moment is not",
        lambda time: {
            "distribution": "lomax",
            "c": TAIL,
            "loc": time,
            "scale": (TAIL - 1.0) * time,
        },
    ),
    "fixed": ("always 2 τ_d, so that with two modes the future is known", lambda time: 2.0 * time),
}


def sojourn_section(family: str, dwell_time: float) -> Any:
    """The sojourn times of a family at a dwell time, as in [switching] of a problem file.

    Examples
    --------
    >>> sojourn_section("uniform", 0.4)
    {'distribution': 'uniform', 'loc': 0.4, 'scale': 0.8}
    >>> sojourn_section("fixed", 0.4)
    0.8
    """
    return FAMILIES[family][1](dwell_time)


ORACLE, AWARE = "oracle", ", dwell-aware"
COARSE = 20  # sampling periods per delay at which minimax laws are sought
INPUT_WEIGHT = 1e-3  # of ∫|u|² beside ∫|x|² in the optimal law's cost


@dataclass(frozen=True)
class Kind:
    """A law of the registry, for one mode if there is a law per mode."""

    known: NamedLaw
    mode: int | None = None

    @property
    def knows(self) -> str:
        """One of `LEVELS`."""
        return self.known.named.knows

    def make(self, setting: LawSetting, dwell_time: float | None = None) -> Law:
        """The law for one cell; τ_d for dwell-aware laws."""
        if self.known.takes_dwell_time and dwell_time is None:
            raise ArgumentError("a dwell-aware law needs τ_d: give grid.dwell_time.")
        return self.known.build(setting, self.mode, dwell_time)


# Signals of a study are drawn: no rule decides the mode. Laws that know less come first.
KINDS: Mapping[str, Kind] = {
    known.named.name: Kind(known)
    for known in sorted(LAWS.values(), key=lambda known: LEVELS.index(known.named.knows))
    if "rule" not in known.entry.needs and not known.per_mode
}
DEFAULT = tuple(name for name, kind in KINDS.items() if kind.known.named.in_studies)


def kinds_of(modes: int) -> dict[str, Kind]:
    """The laws by name for a plant of `modes`, single-mode laws included.

    Examples
    --------
    >>> [name for name in kinds_of(2) if name.endswith("only")]
    ['mode 0 only', 'mode 1 only']
    """
    own = {
        known.named.name.format(mode=mode): Kind(known, mode)
        for known in LAWS.values()
        if known.per_mode
        for mode in range(modes)
    }
    return {**KINDS, **own}


def within(laws: Sequence[str], knows: str) -> list[str]:
    """The named laws that know at most one of `LEVELS`, in their order.

    Examples
    --------
    >>> within(("averaged", "expected", "mode 0 only"), "the dwell time")
    ['averaged', 'mode 0 only']
    """
    most = LEVELS.index(knows)
    return [law for law in laws if LEVELS.index(knowledge_of(law)) <= most]


def knowledge_of(law: str) -> str:
    """A named law's knowledge of the switching, one of `LEVELS`."""
    return KINDS[law].knows if law in KINDS else "nothing"


Draft = dict[str, Any]
Write = Callable[[Draft, Any], None]


@dataclass(frozen=True)
class Axis:
    """A parameter: its name in files and data, its label and unit, and the function to write it."""

    name: str
    label: str
    unit: str
    write: Write

    def say(self, value: object) -> str:
        """The value with its name, for titles.

        Examples
        --------
        >>> AXES["delay"].say(0.5), AXES["sojourn"].say("uniform")
        ('delay 0.5 s', 'uniform sojourns')
        """
        if isinstance(value, str):
            return f"{value} {self.label}" if self.name in AXES else f"{self.label} {value}"
        if isinstance(value, float):
            value = f"{value:g}"
        return f"{self.label} {value} {self.unit}".rstrip()


def write_path(draft: Draft, path: str, value: Any) -> None:
    """Write a value at a dotted path; items of lists are named by number, name or kind.

    Examples
    --------
    >>> draft = {"law": [{"kind": "mean"}, {"kind": "averaged", "name": "mine"}]}
    >>> write_path(draft, "law.mine.dwell_time", 0.2)
    >>> write_path(draft, "run.step", 0.01)
    >>> draft["law"][1]["dwell_time"], draft["run"]
    (0.2, {'step': 0.01})
    """
    *way, last = path.split(".")
    place: Any = draft
    for depth, part in enumerate(way):
        if isinstance(place, list):
            place = place[_item(place, part, ".".join(way[: depth + 1]))]
        else:
            place = place.setdefault(part, {})
        if not isinstance(place, (dict, list)):
            raise ArgumentError(f"{path} leads nowhere: {'.'.join(way[: depth + 1])} is a value.")
    if isinstance(place, list):
        place[_item(place, last, path)] = value
    else:
        place[last] = value


def _item(items: list, part: str, path: str) -> int:
    """The index of the item that a part of a path names."""
    if part.isdigit() and int(part) < len(items):
        return int(part)
    tables = [(i, item) for i, item in enumerate(items) if isinstance(item, dict)]
    named = [i for i, item in tables if item.get("name") == part]
    plain = [i for i, item in tables if item.get("kind") == part and "name" not in item]
    found = named or plain or [i for i, item in tables if item.get("kind") == part]
    if len(found) == 1:
        return found[0]
    known = [
        str(item.get("name") or item.get("kind") if isinstance(item, dict) else i)
        for i, item in enumerate(items)
    ]
    problem = "is not there" if not found else f"stands for {len(found)} of them"
    raise ArgumentError(f"{path}: {part!r} {problem}: it must be one of {', '.join(known)}.")


def at(path: str) -> Write:
    """Write to a path."""
    return lambda draft, value: write_path(draft, path, value)


def _distance(draft: Draft, alpha: float) -> None:
    """The modes are moved α times as far from mode 0."""
    plant = draft["plant"]
    moved = SwitchedSystem(plant["A"], plant["B"], plant["delay"]).apart(alpha)
    plant |= {"A": moved.A.tolist(), "B": moved.B.tolist()}


def _delay(draft: Draft, value: float) -> None:
    """The longest delay is `value` seconds, the others in proportion."""
    delays = np.asarray(draft["plant"]["delay"], dtype=float)
    draft["plant"]["delay"] = (delays * (value / delays.max())).tolist() if delays.ndim else value


def _delay_of(number: str) -> Write:
    """The delay of an input in all modes, for every form of delays in the file."""

    def write(draft: Draft, value: float) -> None:
        plant = draft["plant"]
        if not isinstance(plant["delay"], list):
            plant["delay"] = [plant["delay"]] * len(plant["B"][0][0])
        rows = [f"{i}." for i, row in enumerate(plant["delay"]) if isinstance(row, list)]
        for row in rows or [""]:
            write_path(draft, f"plant.delay.{row}{number}", value)

    return write


def _delay_error(draft: Draft, error: float) -> None:
    """The true delays are (1 + e) times those that laws assume."""
    delays = (1.0 + error) * np.asarray(draft["plant"]["delay"])
    draft.setdefault("truth", {})["delay"] = delays.tolist()


def _gain_error(draft: Draft, error: float) -> None:
    """The true B is (1 + e) times the B that laws assume."""
    B = np.array(draft["plant"]["B"], dtype=float)
    draft.setdefault("truth", {})["B"] = ((1.0 + error) * B).tolist()


def _start(draft: Draft, factor: float) -> None:
    draft["run"]["x0"] = [factor * float(x) for x in draft["run"]["x0"]]


def _speed(draft: Draft, factor: float) -> None:
    """Poles are moved away from 0 by a factor."""
    poles = draft["gains"].get("poles")
    if poles is None:
        raise ArgumentError("speed moves poles, and the gains are not placed: give poles.")

    def scale(given: Any) -> Any:
        if isinstance(given, list):
            return [scale(one) for one in given]
        return str(factor * complex(given)) if isinstance(given, str) else factor * given

    draft["gains"]["poles"] = scale(poles)


def _imperfect(swept: Swept) -> Write:
    """Add an imperfection; none for the value 0."""

    def write(draft: Draft, value: float) -> None:
        if value:
            draft["imperfection"] = [*draft.get("imperfection", []), swept.section(value)]

    return write


def _dwell_time(draft: Draft, dwell_time: float) -> None:
    """τ_d of the signals, and of the file's laws that have one."""
    for law in draft.get("law", []):
        if law.get("dwell_time") is not None:
            law["dwell_time"] = dwell_time
    draft["switching"] = {
        "kind": "semi-markov",
        "sojourn": sojourn_section(draft.pop("sojourn", "exponential"), dwell_time),
    }


def no_write(draft: Draft, value: Any) -> None:
    """Write nothing, for an axis outside of problem files."""


def _by_name(*axes: Axis) -> dict[str, Axis]:
    """The axes by their names; an error if two imperfections share a name."""
    named: dict[str, Axis] = {}
    for axis in axes:
        if axis.name in named:
            raise ArgumentError(f"the name of the axis {axis.name!r} is taken: choose another.")
        named[axis.name] = axis
    return named


# In the order in which they are written: axes that read the plant come after those that change it.
AXES: Mapping[str, Axis] = _by_name(
    Axis("distance", "mode distance α", "", _distance),
    Axis("delay", "delay", "s", _delay),
    Axis("speed", "closed-loop speed", "", _speed),
    Axis("step", "sampling period", "s", at("run.step")),
    Axis("horizon", "horizon", "s", at("run.horizon")),
    Axis("start", "size of x(0)", "", _start),
    Axis("delay_error", "delay error", "", _delay_error),
    Axis("gain_error", "gain error", "", _gain_error),
    Axis("sojourn", "sojourns", "", at("sojourn")),
    Axis("dwell_time", "dwell time", "s", _dwell_time),
    *(
        Axis(name, swept.axis.label, swept.axis.unit, _imperfect(swept))
        for name, swept in SWEPT.items()
    ),
    Axis("seed", "seed", "", no_write),
)


# Paths of the problem file that an axis overwrites.
OVERWRITES: Mapping[str, tuple[str, ...]] = {
    "delay": ("plant.delay",),
    "step": ("run.step",),
    "horizon": ("run.horizon",),
    "delay_error": ("truth.delay",),
    "gain_error": ("truth.B",),
    "dwell_time": ("switching", "law.*.dwell_time"),
}


def path_of(name: str) -> str:
    """The path of an axis in a problem file.

    Examples
    --------
    >>> path_of("run.x0.1"), path_of("delay.1")
    ('run.x0.1', 'plant.delay.1')
    """
    return f"plant.{name}" if name.startswith("delay.") else name


def axis_of(name: str) -> Axis:
    """A named parameter, or one at a dotted path; `delay.1` is the delay of input 1 in all modes.

    Examples
    --------
    >>> axis_of("noise").label, axis_of("run.x0.1").label, axis_of("delay.1").unit
    ('measurement noise', 'run.x0.1', 's')
    """
    if name.startswith("delay."):
        return Axis(name, f"delay of input {name[6:]}", "s", _delay_of(name[6:]))
    return AXES[name] if name in AXES else Axis(name, name, "", at(name))
