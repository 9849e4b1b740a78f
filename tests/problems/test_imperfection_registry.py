"""The registry of imperfections: an entry that is not whole is refused by its name, and every
public imperfection has one."""

from dataclasses import dataclass
from types import ModuleType
from typing import ClassVar, Literal

import pytest

import deadtime as dt
from deadtime.imperfections import ActuatorImperfection
from deadtime.problems.imperfection_registry import (
    ENTRIES,
    SWEPT,
    ImperfectionAxis,
    ImperfectionSection,
    Slider,
    build_imperfection,
    collect,
    require_all,
)
from deadtime.scenarios.sweeps.axes import AXES, Axis as SweepAxis, _by_name


@dataclass(frozen=True)
class Backlash(ActuatorImperfection):
    width: float

    def actuator(self, sizes):
        return lambda asked, before: asked


def axis(name="backlash", key="width"):
    return ImperfectionAxis(
        name=name, label="backlash", unit="u", description="", keys=lambda v: {key: v}
    )


def entry(name="BacklashSection", /, **own):
    """An entry that is whole, but for what is given; None leaves a part out."""
    parts = {"__doc__": "A gap.", "made": Backlash, "kind": Literal["backlash"]}
    parts = {"fields": {"width": float}, "axis": axis(), **parts, **own}
    hints = {"made": ClassVar, "axis": ClassVar, "slider": ClassVar, **parts.pop("fields")}
    hints |= {"kind": kind} if (kind := parts.pop("kind")) else {}
    body = {key: value for key, value in parts.items() if value is not None}
    body |= {"__annotations__": hints, "__module__": "mine"}
    return type(name, (ImperfectionSection,), body)


def module(*entries):
    made = ModuleType("mine")
    vars(made).update({f"entry_{i}": one for i, one in enumerate(entries)})
    return made


def test_an_entry_that_is_whole_is_taken():
    made = entry(slider=Slider("Gap", "width", 1.0, 100))
    assert collect([module(made)]) == (made,)
    assert build_imperfection(made(kind="backlash", width=0.1)) == Backlash(0.1)


@pytest.mark.parametrize(
    ("lacking", "message"),
    [
        ({"kind": None}, "lacks its kind: write kind"),
        ({"__doc__": None}, "lacks a docstring: write a line"),
        ({"made": None}, "lacks made: give made = the class of the imperfection"),
        (
            {"fields": {"gap": float}},
            r"has the keys \['gap'\], Backlash takes \['width'\]: make them the same",
        ),
        ({"axis": axis(key="gap")}, "sets gap by its axis, which is no key of the section"),
        ({"slider": Slider("", "gap", 1.0, 9)}, "has a slider of 'gap', which its axis does not"),
        (
            {"axis": None, "slider": Slider("", "width", 1.0, 9)},
            "has a slider of 'width', which its axis does not set",
        ),
    ],
)
def test_an_entry_that_lacks_something_is_refused_by_its_name(lacking, message):
    with pytest.raises(
        dt.ArgumentError, match=rf"^imperfection entry MineSection in mine {message}"
    ):
        collect([module(entry("MineSection", **lacking))])


@dataclass(frozen=True)
class Hysteresis(Backlash):
    """The same under another name."""


@pytest.mark.parametrize(
    ("taking", "message"),
    [
        ({}, "takes the kind 'backlash', which BacklashSection has: choose another"),
        ({"kind": Literal["gap"]}, "takes the name 'Backlash', which BacklashSection has"),
        (
            {"kind": Literal["gap"], "made": Hysteresis},
            "takes the name 'backlash', which BacklashSection has",
        ),
    ],
)
def test_an_entry_that_takes_what_another_has_is_refused_by_its_name(taking, message):
    with pytest.raises(
        dt.ArgumentError, match=f"^imperfection entry MineSection in mine {message}"
    ):
        collect([module(entry(), entry("MineSection", **taking))])


def test_a_file_without_an_entry_is_refused():
    with pytest.raises(dt.ArgumentError, match="mine holds no entry of imperfections: write a sub"):
        collect([module()])


def test_a_public_imperfection_without_an_entry_is_refused():
    with pytest.raises(dt.ArgumentError, match=r"^imperfection Jitter has no entry: add one to"):
        require_all(one for one in ENTRIES if one.made is not dt.imperfections.Jitter)


def test_an_axis_that_takes_the_name_of_another_is_refused():
    made = SweepAxis("delay", "", "", lambda draft, value: None)
    with pytest.raises(dt.ArgumentError, match="the name of the axis 'delay' is taken"):
        _by_name(AXES["delay"], made)


@pytest.mark.parametrize("name", SWEPT)
def test_an_axis_writes_a_section_that_makes_its_imperfection(name):
    made = next(one for one in ENTRIES if one.axis is not None and one.axis.name == name)
    draft = {}
    AXES[name].write(draft, 1)
    (section,) = draft["imperfection"]
    assert isinstance(build_imperfection(made(**section)), made.made)
    AXES[name].write(draft, 0)
    assert draft["imperfection"] == [section]
