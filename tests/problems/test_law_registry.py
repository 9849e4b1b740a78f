"""The registry of laws: one entry makes a law known everywhere, and an entry that is not whole is
refused by its name."""

import tomllib
from types import ModuleType
from typing import ClassVar, Literal

import numpy as np
import pytest

import deadtime as dt
from deadtime.app.documents import open_named
from deadtime.app.first_view import laws_on_offer
from deadtime.problems.file.build import build_problem
from deadtime.problems.file.schema import ProblemFile
from deadtime.problems.law_registry import (
    ENTRIES,
    LAWS,
    LawSection,
    LawSetting,
    Named,
    build_law,
    collect,
    the_law,
)
from deadtime.problems.templates import template
from deadtime.scenarios.sweeps.axes import DEFAULT, KINDS

PAPER = dt.problems.paper()
GAIN = dt.place(PAPER.plant.mean(), [-1.0, -2.0])[0]
MODEL = dt.Markov([[0.0, 1.0], [2.0, 0.0]])
SETTING = LawSetting(
    plant=PAPER.plant,
    gains=PAPER.gains,
    mean_gain=lambda _: GAIN,
    period=0.05,
    model=MODEL,
    mode_filter=lambda plant: dt.ModeFilter(plant, MODEL, 0.05),
)


class ZeroLaw(LawSection):
    """An entry that is whole."""

    names: ClassVar = (Named(name="zero", knows="nothing"),)

    kind: Literal["zero"]

    def law(self, setting):
        return dt.DelayedStateFeedback(setting.plant, 0.0 * setting.gains, allow_unstable=True)


def entry(name="ZeroLaw", /, **own):
    """An entry like `ZeroLaw`, but for what is given; None leaves a part out."""
    parts = {
        "__doc__": "A law.",
        "names": ZeroLaw.names,
        "law": ZeroLaw.law,
        "kind": Literal["zero"],
    }
    parts |= own
    kind, fields = parts.pop("kind"), parts.pop("fields", {})
    body = {key: value for key, value in parts.items() if value is not None}
    hints = {"names": ClassVar, "needs": ClassVar, **({"kind": kind} if kind else {}), **fields}
    return type(name, (LawSection,), {**body, "__annotations__": hints, "__module__": "mine"})


def module(*entries):
    made = ModuleType("mine")
    vars(made).update({f"entry_{i}": one for i, one in enumerate(entries)})
    return made


def names(*given):
    return tuple(Named(**{"knows": "nothing", **one}) for one in given)


def test_an_entry_that_is_whole_is_taken():
    made = entry()
    assert collect([module(made)]) == (made,)
    law = build_law(made(kind="zero"), SETTING)
    assert np.array_equal(law.gains, 0.0 * PAPER.gains)


@pytest.mark.parametrize(
    ("lacking", "message"),
    [
        ({"kind": None}, r'lacks its kind: write kind: Literal\["…"\]'),
        ({"kind": str}, "lacks its kind"),
        ({"kind": Literal["a", "b"]}, "lacks its kind"),
        ({"__doc__": None}, "lacks a docstring: write a line"),
        ({"law": None}, r"lacks law\(self, setting\): define it"),
        ({"names": None}, "lacks names: give names"),
        ({"names": ()}, "lacks names: give names"),
        ({"needs": ("luck",)}, "needs 'luck': it must be one of model, mode_filter, rule, signal"),
        ({"names": names({"name": "z"}, {"name": "z"})}, "has a name twice"),
        (
            {"names": names({"name": "z", "knows": "all"})},
            "'z' knows 'all': it must be one of nothing, the dwell time",
        ),
        (
            {"names": names({"name": "z", "knows": "the dwell time"})},
            "'z' sets dwell_time, which is no key of the section",
        ),
        ({"names": names({"name": "z {mode}"})}, "'z {mode}' sets mode, which is no key"),
        ({"names": names({"name": "z", "keys": {"a": 1}})}, "'z' sets a, which is no key"),
        ({"fields": {"size": float}}, "'zero' does not say size: give it in keys"),
    ],
)
def test_an_entry_that_lacks_something_is_refused_by_its_name(lacking, message):
    with pytest.raises(dt.ArgumentError, match=rf"^law entry MineLaw in mine {message}"):
        collect([module(entry("MineLaw", **lacking))])


@pytest.mark.parametrize(
    ("taking", "message"),
    [
        ({}, "MineLaw in mine takes the kind 'zero', which ZeroLaw has: choose another"),
        ({"kind": Literal["nil"]}, "MineLaw in mine takes the name 'zero', which ZeroLaw has"),
    ],
)
def test_an_entry_that_takes_what_another_has_is_refused_by_its_name(taking, message):
    with pytest.raises(dt.ArgumentError, match=rf"^law entry {message}"):
        collect([module(entry(), entry("MineLaw", **taking))])


def test_two_entries_of_one_class_name_are_refused():
    other = entry(kind=Literal["nil"], names=names({"name": "nil"}))
    with pytest.raises(dt.ArgumentError, match=r"ZeroLaw in mine takes the class name of that in"):
        collect([module(entry(), other)])


def test_a_file_without_an_entry_is_refused():
    with pytest.raises(dt.ArgumentError, match=r"^mine holds no entry of laws: write a subclass"):
        collect([module()])


@pytest.mark.parametrize("name", [name for name, known in LAWS.items() if known.usual])
def test_the_first_name_of_an_entry_is_the_label_of_its_law(name):
    known, setting = LAWS[name], SETTING
    if "rule" in known.entry.needs:
        setting = LawSetting(
            PAPER.plant, PAPER.gains, setting.mean_gain, 0.05, rule=dt.HalfSpace([1.0, 0.0])
        )
    for mode in known.modes(2):
        assert known.build(setting, mode).label == name.format(mode=mode)


@pytest.mark.parametrize("entry", ENTRIES)
def test_what_an_entry_needs_is_asked_for_before_it_builds(entry):
    known = next(known for known in LAWS.values() if known.entry is entry)
    for need in entry.needs:
        rule = dt.HalfSpace([1.0, 0.0]) if need == "signal" else None
        bare = LawSetting(PAPER.plant, PAPER.gains, SETTING.mean_gain, 0.05, rule=rule)
        with pytest.raises(dt.ArgumentError, match=rf"kind = .{known.kind}. needs a "):
            known.build(bare)


def test_laws_of_files_studies_and_pages_come_in_their_order():
    file = ProblemFile.model_validate({**tomllib.loads(template("paper")), "law": []})
    singles = ["mode 0 only", "mode 1 only"]
    laws = list(build_problem(file, open_named("paper").source).laws)
    assert laws == ["averaged", *singles, "mean", "oracle", "delay ignored"]
    assert list(laws_on_offer(open_named("paper"))[0]) == [
        *laws,
        *("expected", "optimal", "averaged, dwell-aware", "mean, dwell-aware"),
    ]
    aware = ["averaged, dwell-aware", "mean, dwell-aware"]
    assert list(DEFAULT) == ["averaged", "mean", *aware, "expected", "oracle"]
    minimax = ["averaged, minimax", "averaged, one-gain minimax"]
    start = ["averaged", "mean", "delay ignored", *minimax]
    assert list(KINDS) == [*start, *aware, "expected", "optimal", "belief", "oracle"]


def test_laws_in_sentences():
    assert the_law("optimal") == "the optimal law"
    assert the_law("averaged, one-gain minimax") == "the one-gain minimax averaged law"
    assert the_law("delay ignored") == "the law “delay ignored”"
